// The pictures of the page to be touched; without this script, and on paper, the drawn ones are there.
"use strict";
const report = (() => {
  const data = JSON.parse(document.getElementById("data").textContent), {model} = data;
  const NS = "http://www.w3.org/2000/svg", factors = {...AS_RUN};
  const svg = (parent, tag, attributes, text) => {
    const node = parent.appendChild(document.createElementNS(NS, tag));
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (text !== undefined) node.textContent = text;
    return node;
  };
  const html = (parent, tag, words, attributes = {}) => {
    const node = parent.appendChild(document.createElement(tag));
    node.textContent = words;
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    return node;
  };
  const show = v => v === 0 ? "0" : Math.abs(v) >= 1e-3 && Math.abs(v) < 1e5 ? String(+v.toPrecision(7)) : v.toExponential(4);
  const few = v => v.toExponential(1).replace("e+0", "").replace("e-0", "e-");

  function ticks(low, high, count) {
    const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 2.5, 5, 10].find(s => s * power >= raw);
    const list = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high * (1 + 1e-12) + 1e-12 * step; k++) list.push(+(k * step).toPrecision(12));
    return list;
  }

  function livePlot(plot) {
    const drawn = document.getElementById(`density_${plot.of}`);
    const host = document.createElement("figure");
    host.className = "live";
    host.id = `live_${plot.of}`;
    drawn.parentNode.insertBefore(host, drawn);
    for (const id of [drawn.id, `${drawn.id}_log`]) document.getElementById(id)?.classList.add("still");
    const known = model && closedForms(model, AS_RUN)(plot.of) || {};
    const lines = [["energy", "energy averaging by the sliders", "7 3"], ["modal", "modal averaging by the sliders", "2 3"]].filter(([key]) => known[key]);
    const series = [...plot.series];
    const sliders = lines.map(([key, name, dash]) => ({key, name, dash, curve: "", colour: "currentColor", shown: false}));
    series.push(...sliders);
    const view = {range: null, cursor: null};
    const bar = html(host, "div", "", {class: "bar"});
    const button = (words, action, pressed) => {
      const node = html(bar, "button", words, {type: "button"});
      if (pressed !== undefined) node.setAttribute("aria-pressed", pressed);
      node.addEventListener("click", () => { action(node); draw(); });
      return node;
    };
    const press = (node, on) => node.setAttribute("aria-pressed", on);
    const span = panel => view.range || (panel.log ? [plot.x[0], plot.x.at(-1)] : visible());
    const zoom = (factor, panel = panels[0]) => {
      const [a, b] = span(panel), middle = view.cursor ?? (a + b) / 2;
      view.range = [middle - (middle - a) * factor, middle + (b - middle) * factor];
    };
    button("+", () => zoom(0.5)).setAttribute("aria-label", "zoom in");
    button("−", () => zoom(2)).setAttribute("aria-label", "zoom out");
    button("whole", () => { view.range = null; });
    const off = {curve: new Set(), name: new Set(series.filter(s => !s.shown).map(s => s.name))};
    for (const s of plot.series) if (s.shown) off.name.delete(s.name);
    const buttons = {};
    for (const kind of ["curve", "name"]) {
      const values = [...new Set(series.map(s => s[kind]))].filter(v => v && (kind === "name" || plot.series.some(s => s.curve !== plot.series[0].curve)));
      for (const value of values) {
        const one = series.find(s => s[kind] === value);
        const node = buttons[value] = button(value, node => {
          if (!off[kind].delete(value)) off[kind].add(value);
          press(node, !off[kind].has(value));
        }, !off[kind].has(value));
        const sampled = series.find(s => s[kind] === value && s.mark);
        const swatch = svg(node, "svg", {width: 26, height: 10, "aria-hidden": "true"});
        node.prepend(swatch);
        const colour = kind === "curve" || new Set(plot.series.map(s => s.curve)).size === 1 ? one.colour : "currentColor";
        if (sampled) svg(swatch, "path", {d: `M13,5${sampled.mark}`, fill: "none", stroke: colour});
        if (kind === "curve" || !sampled) svg(swatch, "line", {x1: 1, y1: 5, x2: 25, y2: 5, stroke: colour, "stroke-width": 2, "stroke-dasharray": kind === "name" && one.dash || "none"});
      }
    }
    const top = Math.max(...plot.series.flatMap(s => s.p));
    const visible = () => {
      const seen = plot.x.filter((x, i) => plot.series.some(s => (s.x ? 0 : s.p[i]) > 1e-3 * top));
      return seen.length ? [plot.x[Math.max(plot.x.indexOf(seen[0]) - 1, 0)], seen.at(-1)] : [plot.x[0], plot.x.at(-1)];
    };
    const pair = html(host, "div", "", {class: "pair"});
    const panels = [false, true].map(log => ({
      log, canvas: svg(pair, "svg", {tabindex: 0, role: "application", "aria-label": `${plot.ylabel} over ${plot.xlabel}; arrows move, + and − zoom, 0 shows all, l changes the scale`}),
    }));
    const readout = html(host, "div", "", {class: "readout", "aria-live": "polite"});
    html(host, "figcaption", drawn.querySelector("figcaption").textContent);
    const on = s => !off.name.has(s.name) && !off.curve.has(s.curve);
    

    function draw() {
      const forms = sliders.some(on) ? closedForms(model, factors)(plot.of) : null;
      for (const s of sliders) s.p = forms && forms[s.key] && on(s) ? plot.x.map(forms[s.key]) : [];
      for (const panel of panels) panel.width = Math.max(panel.canvas.clientWidth, 280);
      panels.forEach(drawPanel);
      tell();
    }

    function drawPanel(panel) {
      const {canvas, log} = panel, shown = series.filter(on), [a, b] = span(panel);
      const {width} = panel, height = Math.min(360, 0.66 * width + 40);
      const box = {left: 58, right: width - 10, top: 10, bottom: height - 42};
      canvas.replaceChildren();
      canvas.setAttribute("viewBox", `0 0 ${width} ${height}`);
      const high = 1.06 * Math.max(...shown.flatMap(s => s.p.filter((_, i) => { const x = (s.x || plot.x)[i]; return x >= a && x <= b; })), 1e-6 * top);
      const low = log ? 1e-6 * high : 0;
      const X = x => box.left + (x - a) / (b - a) * (box.right - box.left);
      const part = log ? p => Math.log(Math.max(p, 1e-2 * low) / low) / Math.log(high / low) : p => p / high;
      const Y = p => box.bottom - part(p) * (box.bottom - box.top);
      panel.frame = {box, a, b};
      const clip = svg(svg(canvas, "clipPath", {id: `clip_${plot.of}_${panels.indexOf(panel)}`}), "rect", {x: box.left, y: box.top, width: box.right - box.left, height: box.bottom - box.top});
      const inside = svg(canvas, "g", {"clip-path": `url(#clip_${plot.of}_${panels.indexOf(panel)})`});
      for (const wall of plot.walls) {
        const x = X(wall), [from, to] = wall < 0 || (wall === 0 && plot.walls.length > 1) ? [box.left, x] : [x, box.right];
        const single = plot.walls.filter(w => w * wall > 0).length === 1;
        if (single && to > from) svg(inside, "rect", {x: from, y: box.top, width: to - from, height: box.bottom - box.top, class: "wall"});
        svg(inside, "line", {x1: x, x2: x, y1: box.top, y2: box.bottom, class: "edge"});
      }
      for (const s of shown) {
        if (!s.x) {
          const path = s.p.map((p, i) => `${i ? "L" : "M"}${X(plot.x[i]).toFixed(2)},${Y(p).toFixed(2)}`).join("");
          svg(inside, "path", {d: path, class: "curve", stroke: s.colour, "stroke-dasharray": s.dash || "none"});
          continue;
        }
        const band = side => s.x.map((x, i) => `${X(x).toFixed(2)},${Y(s.p[i] + side * 2 * s.error[i]).toFixed(2)}`);
        svg(inside, "polygon", {points: [...band(1), ...band(-1).reverse()].join(" "), fill: s.colour, class: "band"});
        const bars = s.x.map((x, i) => `M${X(x).toFixed(2)},${Y(s.p[i] + 2 * s.error[i]).toFixed(2)}V${Y(s.p[i] - 2 * s.error[i]).toFixed(2)}`);
        const rings = s.x.map((x, i) => `M${X(x).toFixed(2)},${Y(s.p[i]).toFixed(2)}${s.mark}`);
        svg(inside, "path", {d: bars.concat(rings).join(""), fill: "none", stroke: s.colour});
      }
      svg(canvas, "path", {d: `M${box.left},${box.top}V${box.bottom}H${box.right}`, class: "axis"});
      for (const x of ticks(a, b, width < 500 ? 4 : 8)) svg(canvas, "text", {x: X(x), y: box.bottom + 16, "text-anchor": "middle"}, String(x).replace("-", "−"));
      const marks = log ? Array.from({length: 7}, (_, k) => 10 ** (Math.floor(Math.log10(high)) - k)).filter(p => p >= low) : ticks(0, high, 5);
      for (const p of marks) svg(canvas, "text", {x: box.left - 6, y: Y(p) + 4, "text-anchor": "end"}, log ? p.toExponential(0).replace("e+0", "e0") : String(p));
      svg(canvas, "text", {x: (box.left + box.right) / 2, y: height - 6, "text-anchor": "middle"}, plot.xlabel);
      svg(canvas, "text", {transform: `translate(12 ${(box.top + box.bottom) / 2}) rotate(-90)`, "text-anchor": "middle"}, plot.ylabel);
      if (view.cursor !== null) {
        const x = X(plot.x[nearest(plot.x, view.cursor)]);
        svg(inside, "line", {x1: x, x2: x, y1: box.top, y2: box.bottom, class: "cursor"});
      }
    }

    function nearest(list, x) {
      let best = 0;
      list.forEach((v, i) => { if (Math.abs(v - x) < Math.abs(list[best] - x)) best = i; });
      return best;
    }

    function values() { // of every route of the curves that are on, at the cursor
      const i = nearest(plot.x, view.cursor);
      return series.filter(s => s.p.length && !off.curve.has(s.curve)).map(s => {
        const j = s.x ? nearest(s.x, view.cursor) : i;
        return {curve: s.curve, name: s.name, x: (s.x || plot.x)[j], p: s.p[j], error: s.error ? s.error[j] : undefined, bin: Boolean(s.x)};
      });
    }

    function tell() {
      readout.replaceChildren();
      if (view.cursor === null) return;
      html(readout, "strong", `${plot.xlabel} = ${show(plot.x[nearest(plot.x, view.cursor)])}`);
      for (const v of values()) {
        const where = v.bin ? `, bin at ${show(+v.x.toPrecision(4))}` : "";
        html(readout, "div", `${v.curve ? v.curve + ", " : ""}${v.name}${where}: ${show(v.p)}${v.error === undefined ? "" : v.error === null ? ", error not known" : ` ± ${few(v.error)}`}`);
      }
    }

    const at = (panel, event) => {
      const {canvas} = panel, rectangle = canvas.getBoundingClientRect(), scale = canvas.viewBox.baseVal.width / rectangle.width;
      const {box, a, b} = panel.frame, x = (event.clientX - rectangle.left) * scale;
      return a + (b - a) * Math.min(Math.max((x - box.left) / (box.right - box.left), 0), 1);
    };
    let from = null;
    for (const panel of panels) {
      const {canvas} = panel;
      canvas.addEventListener("pointerdown", event => { if (event.pointerType === "mouse") from = at(panel, event); });
      canvas.addEventListener("pointermove", event => { view.cursor = at(panel, event); draw(); });
      canvas.addEventListener("pointerup", event => {
        const to = at(panel, event);
        if (from !== null && Math.abs(to - from) > 0.01 * (panel.frame.b - panel.frame.a)) view.range = [Math.min(from, to), Math.max(from, to)];
        from = null;
        draw();
      });
      canvas.addEventListener("dblclick", () => { view.range = null; draw(); });
      canvas.addEventListener("keydown", event => {
        const step = (event.shiftKey ? 10 : 1) * {ArrowLeft: -1, ArrowRight: 1}[event.key];
        if (step) {
          const [a, b] = span(panel), i = nearest(plot.x, view.cursor ?? (a + b) / 2);
          view.cursor = plot.x[Math.min(Math.max(i + step, 0), plot.x.length - 1)];
        } else if (event.key === "+" || event.key === "-") zoom(event.key === "+" ? 0.5 : 2, panel);
        else if (event.key === "0") view.range = null;
        else if (event.key === "l") panel.log = !panel.log;
        else if (event.key === "Escape") view.cursor = null;
        else return;
        event.preventDefault();
        draw();
      });
    }
    const reveal = () => { for (const s of sliders) { off.name.delete(s.name); press(buttons[s.name], true); } };
    draw();
    return {of: plot.of, host, view, draw, values, reveal, buttons, panels, supported: lines.length > 0};
  }

  const state = document.getElementById("sliders");
  html(state, "p", "Point, touch or use the arrow keys for values; drag or use + and − to zoom; l changes between linear and logarithmic scale. Bars: two standard errors.", {class: "soft"});
  state.hidden = false;
  const plots = data.plots.map(livePlot);
  if (model && plots.some(p => p.supported)) {
    const words = {B: "contact stiffness B", delta: "clearance δ", c: "damping c", D: "noise intensity D"};
    html(state, "p", "Closed forms of both averaged theories for other parameters, computed here; the simulated points stay those of the run.", {class: "soft"});
    const value = key => {
      const own = [...new Set(model.stops.map(s => s[key]))];
      return own.length === 1 && own[0] !== undefined ? ` = ${show(+(own[0] * factors[key]).toPrecision(4))}` : ` × ${show(+factors[key].toPrecision(4))}`;
    };
    for (const key of Object.keys(AS_RUN)) {
      const label = html(state, "label", ""), text = html(label, "span", words[key] + value(key));
      const most = key === "B" ? 2 : 1;
      const input = html(label, "input", "", {type: "range", min: -most, max: most, step: 0.01, value: 0, "data-key": key});
      input.addEventListener("input", () => {
        factors[key] = 10 ** input.value;
        text.textContent = words[key] + value(key);
        for (const p of plots) if (p.supported) { p.reveal(); p.draw(); }
      });
    }
  }
  addEventListener("resize", () => plots.forEach(p => p.draw()));
  return {data, plots, factors, closedForms: changed => closedForms(model, {...AS_RUN, ...changed})};
})();
