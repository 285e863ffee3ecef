// A plot of a page that can be touched: its buttons, zoom, cursor and keys. Without scripts a page shows the files of
// drawn pictures beside it.
function livePlot(plot) {
  const host = document.createElement("figure"), view = {x: null, y: null, cursor: null};
  Object.assign(host, {className: "live", id: `live_${plot.id}`});
  const drawn = document.getElementById(plot.still[0]);
  drawn.parentNode.insertBefore(host, drawn);
  for (const id of plot.still) document.getElementById(id)?.classList.add("still");
  if (plot.title) html(host, "h3", plot.title);
  const every = plot.fields || plot.series;
  const off = {curve: new Set(plot.off), name: new Set(every.filter(s => !s.shown).map(s => s.name))};
  for (const s of every) if (s.shown) off.name.delete(s.name);
  const on = s => !off.name.has(s.name) && !off.curve.has(s.curve);
  const kind = (plot.fields ? maps : curves)(plot, view, on, off), {items, panels} = kind;
  const bar = html(host, "div", "", {class: "bar"});
  const button = (words, action, pressed) => {
    const node = html(bar, "button", words, {type: "button"});
    if (pressed !== undefined) node.setAttribute("aria-pressed", pressed);
    node.addEventListener("click", () => { action(node); draw(); });
    return node;
  };
  const press = (node, on) => node.setAttribute("aria-pressed", on);
  const zoom = (factor, panel = panels.find(p => p.frame)) => {
    for (const key of kind.zoomed) {
      const {low, high, f, inverse} = panel.frame[key.toUpperCase()], [a, b] = [f(low), f(high)];
      const middle = view.cursor ? f(view.cursor[key]) : (a + b) / 2;
      view[key] = [middle - (middle - a) * factor, middle + (b - middle) * factor].map(inverse);
    }
  };
  const whole = () => { view.x = view.y = null; };
  const scale = panel => { for (const p of plot.fields ? panels : [panel]) p.log = !p.log; };
  button("+", () => zoom(0.5)).setAttribute("aria-label", "zoom in");
  button("−", () => zoom(2)).setAttribute("aria-label", "zoom out");
  button("whole", whole);
  if (panels.length === 1 || plot.fields) button("lin/log", () => scale(panels[0]));
  const buttons = {}, many = new Set(items.map(s => s.curve)).size > 1;
  for (const key of ["curve", "name"]) {
    const values = [...new Set(items.map(s => s[key]))].filter(v => v && (key === "name" || items.some(s => s.curve !== items[0].curve)));
    for (const value of values) {
      const one = items.find(s => s[key] === value);
      const node = buttons[value] = button(value, node => {
        if (!off[key].delete(value)) off[key].add(value);
        press(node, !off[key].has(value));
      }, !off[key].has(value));
      if (plot.fields) continue;
      const swatch = svg(node, "svg", {width: 26, height: 10, "aria-hidden": "true"}), stroke = key === "curve" || !many ? one.colour : "currentColor";
      node.prepend(swatch);
      const pointed = items.find(s => s[key] === value && s.marks);
      if (pointed) svg(swatch, "path", {d: `M13,5${pointed.marks}`, fill: "none", stroke});
      if (key === "curve" || one.dash !== undefined) svg(swatch, "line", {x1: 1, y1: 5, x2: 25, y2: 5, stroke, "stroke-width": 2, "stroke-dasharray": key === "name" && one.dash || "none"});
    }
  }
  const pair = html(host, "div", "", {class: "pair"}), keys = "arrows move, + and − zoom, 0 shows all, l changes the scale";
  panels.forEach((panel, number) => Object.assign(panel, {
    number, canvas: svg(pair, "svg", {tabindex: 0, role: "application", "aria-label": `${panel.item?.name || plot.ylabel} over ${plot.xlabel}; ${keys}`}),
  }));
  if (plot.border) html(host, "p", `Dotted: ${plot.border}.`, {class: "soft"});
  const readout = html(host, "div", "", {class: "readout", "aria-live": "polite"});
  const caption = drawn.querySelector("figcaption");
  if (caption && !host.previousElementSibling?.classList.contains("live")) html(host, "figcaption", caption.textContent);
  const seen = () => panels.filter(p => !p.item || on(p.item));

  function draw() {
    plot.before?.(on);
    for (const panel of panels) panel.canvas.classList.toggle("off", !seen().includes(panel));
    for (const panel of seen()) panel.width = Math.max(panel.canvas.clientWidth, 280);
    seen().forEach(kind.draw);
    tell();
  }

  function tell() {
    readout.replaceChildren();
    for (const panel of seen()) {
      panel.cursor.replaceChildren();
      if (view.cursor) kind.mark(panel);
    }
    if (!view.cursor) return;
    html(readout, "strong", kind.place());
    for (const v of kind.values()) {
      const where = !v.own ? "" : v.y === undefined ? `, at ${show(+v.x.toPrecision(4))}` : `, at (${show(+v.x.toPrecision(4))}, ${show(+v.y.toPrecision(4))})`;
      html(readout, "div", `${v.curve ? v.curve + ", " : ""}${v.name}${where}${kind.tell(v)}`);
    }
  }

  const at = (panel, event) => {
    const {canvas, frame: {X, Y, left, right, top, bottom}} = panel, box = canvas.getBoundingClientRect(), size = canvas.viewBox.baseVal.width / box.width;
    const inside = (v, low, high) => Math.min(Math.max(v, low), high);
    return [X.back(inside((event.clientX - box.left) * size, left, right)), Y.back(inside((event.clientY - box.top) * size, top, bottom))];
  };
  let from = null;
  for (const panel of panels) {
    const {canvas} = panel, point = event => { view.cursor = kind.snap(at(panel, event), panel.frame); tell(); };
    canvas.addEventListener("pointerdown", event => { if (event.pointerType === "mouse") from = at(panel, event); else point(event); });
    canvas.addEventListener("pointermove", point);
    canvas.addEventListener("pointerup", event => {
      const to = at(panel, event), start = from;
      from = null;
      const far = kind.zoomed.map((key, k) => { const A = panel.frame[key.toUpperCase()]; return start && Math.abs(A.f(to[k]) - A.f(start[k])) > 0.02 * (A.f(A.high) - A.f(A.low)); });
      if (!far.every(Boolean)) return;
      kind.zoomed.forEach((key, k) => { view[key] = [Math.min(start[k], to[k]), Math.max(start[k], to[k])]; });
      draw();
    });
    canvas.addEventListener("dblclick", () => { whole(); draw(); });
    canvas.addEventListener("keydown", event => {
      const by = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1]}[event.key], size = event.shiftKey ? 10 : 1;
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (by && !(plot.x && plot.series && by[1])) view.cursor = kind.step(size * by[0], by[1] && (plot.fields ? size : 1) * by[1], panel.frame);
      else if (event.key === "+" || event.key === "-") zoom(event.key === "+" ? 0.5 : 2, panel);
      else if (event.key === "0") whole();
      else if (event.key === "l") scale(panel);
      else if (event.key === "Escape") view.cursor = null;
      else return;
      event.preventDefault();
      if (by) tell(); else draw();
    });
  }
  const reveal = name => { off.name.delete(name); press(buttons[name], true); };
  return {plot, host, view, draw, reveal, buttons, panels, values: () => kind.values()};
}

const touch = document.getElementById("touch");
touch.hidden = false;
if (data.plots.length) html(touch, "p", "Point, touch or use the arrow keys for values; drag or use + and − to zoom; l changes between linear and logarithmic scale.", {class: "soft"});
const plots = data.plots.map(livePlot);
plots.forEach(p => p.draw());
addEventListener("resize", () => plots.forEach(p => p.draw()));
const report = {plots};
