// Plots of a page to be touched: curves and maps. Without this script, and on paper, the drawn pictures are there.
"use strict";
const report = (() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const NS = "http://www.w3.org/2000/svg";
  const add = (parent, node, attributes, text) => {
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (text !== undefined) node.textContent = text;
    return parent.appendChild(node);
  };
  const svg = (parent, tag, attributes, text) => add(parent, document.createElementNS(NS, tag), attributes, text);
  const html = (parent, tag, words, attributes = {}) => add(parent, document.createElement(tag), attributes, words);
  const minus = text => text.replaceAll("-", "−");
  const show = v => minus(v === 0 || Math.abs(v) >= 1e-3 && Math.abs(v) < 1e5 ? String(+v.toPrecision(7)) : v.toExponential(4));
  const few = v => minus(v.toExponential(1).replace("e+0", "").replace("e-0", "e-"));
  const plusMinus = v => v === undefined ? "" : v === null ? ", error not known" : ` ± ${few(v)}`;
  const ends = list => list.reduce(([a, b], v) => v === null || Number.isNaN(v) ? [a, b] : [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
  const word = v => minus(v && (Math.abs(v) >= 1e5 || Math.abs(v) < 1e-3) ? v.toExponential().replace("e+", "e") : String(v));

  function ticks(low, high, log, count) {
    const list = [];
    if (!(high > low && Number.isFinite(high - low) && (low > 0 || !log))) return list;
    if (log && high / low > 15) {
      const first = Math.ceil(Math.log10(low) - 1e-9), last = Math.floor(Math.log10(high) + 1e-9);
      const stride = Math.ceil((last - first + 1) / count), each = stride > 1 || last - first > 3 ? [1] : [1, 2, 5];
      for (let k = first - 1; k <= last; k++) if ((k - first) % stride === 0) for (const m of each) list.push(+`${m}e${k}`);
      return list.filter(v => v >= low * (1 - 1e-9) && v <= high * (1 + 1e-9));
    }
    const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 2.5, 5, 10].find(s => s * power >= raw);
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high * (1 + 1e-12) + 1e-12 * step; k++) list.push(+(k * step).toPrecision(12));
    return list;
  }

  // From numbers between low and high to pixels between from and to, and back.
  function axis([low, high], log, from, to) {
    const f = log ? v => Math.log10(Math.max(v, low * 1e-3)) : v => v, inverse = log ? t => 10 ** t : t => t, a = f(low), b = f(high);
    return {
      low, high, log, f, inverse, to: v => from + (f(v) - a) / (b - a) * (to - from),
      back: pixel => inverse(a + (pixel - from) / (to - from) * (b - a)), ticks: count => ticks(low, high, log, count),
    };
  }

  // Number of the entry of an ascending list that is nearest to v on a scale f.
  function nearest(list, v, f = x => x) {
    let best = 0;
    list.forEach((x, i) => { if (Math.abs(f(x) - f(v)) < Math.abs(f(list[best]) - f(v))) best = i; });
    return best;
  }
  const within = (k, list) => Math.min(Math.max(k, 0), list.length - 1);

  // Axes with numbers and words around the box of a panel; returned is the group inside, which is clipped.
  function frame(panel, plot, x, log, y, ylog, {right = 16, name = ""} = {}) {
    const {canvas, width} = panel, height = Math.min(360, 0.66 * width + 40), top = name ? 24 : 10, bottom = height - 42;
    canvas.replaceChildren();
    canvas.setAttribute("viewBox", `0 0 ${width} ${height}`);
    const Y = axis(y, ylog, bottom, top), marks = Y.ticks(6), left = 26 + 7 * Math.max(3, ...marks.map(v => word(v).length));
    const X = axis(x, log, left, width - right), id = `clip_${plot.id}_${panel.number}`;
    svg(svg(canvas, "clipPath", {id}), "rect", {x: left, y: top, width: width - right - left, height: bottom - top});
    const inside = svg(canvas, "g", {"clip-path": `url(#${id})`});
    svg(canvas, "path", {d: `M${left},${top}V${bottom}H${width - right}`, class: "axis"});
    for (const v of X.ticks(width < 500 ? 4 : 8)) svg(canvas, "text", {x: X.to(v), y: bottom + 16, "text-anchor": "middle"}, word(v));
    for (const v of marks) svg(canvas, "text", {x: left - 6, y: Y.to(v) + 4, "text-anchor": "end"}, word(v));
    svg(canvas, "text", {x: (left + width - right) / 2, y: height - 6, "text-anchor": "middle"}, plot.xlabel);
    svg(canvas, "text", {transform: `translate(12 ${(top + bottom) / 2}) rotate(-90)`, "text-anchor": "middle"}, plot.ylabel);
    if (name) svg(canvas, "text", {x: left, y: 14}, name);
    panel.frame = {X, Y, left, right: width - right, top, bottom};
    panel.cursor = svg(canvas, "g", {"clip-path": `url(#${id})`});
    return inside;
  }

  // Curves: a cursor along x where they share it (plot.x), else one at the nearest point.
  function curves(plot, view, on, off) {
    const items = plot.series;
    for (const s of items) s.x ??= plot.x;
    const given = items.filter(s => !s.form), highest = ends(given.flatMap(s => s.y))[1];
    const everywhere = ends([...plot.x || [], ...given.flatMap(s => s.x)]);
    const whole = log => {
      const seen = plot.cut && !log ? plot.x.filter((_, i) => given.some(s => s.x === plot.x && s.y[i] > plot.cut * highest)) : [];
      if (seen.length) return [plot.x[Math.max(plot.x.indexOf(seen[0]) - 1, 0)], seen.at(-1)];
      const [a, b] = everywhere, pad = plot.x ? 0 : 0.04;
      return plot.xlog ? [a / (b / a) ** pad, b * (b / a) ** pad] : [a - pad * (b - a), b + pad * (b - a)];
    };
    const point = (s, i) => ({curve: s.curve, name: s.name, x: s.x[i], p: s.y[i], error: s.error?.[i], note: s.notes?.[i], own: plot.x && s.x[i] !== view.cursor.x});

    function height(panel, shown, [a, b]) {
      const seen = shown.flatMap(s => s.y.filter((v, i) => v !== null && s.x[i] >= a && s.x[i] <= b && (!panel.log || v > 0)));
      let [low, high] = seen.length ? ends(seen) : [1e-3, 1].map(v => v * (highest > 0 ? highest : 1));
      if (plot.yends && panel.log) return plot.yends;
      if (plot.cut) high = Math.max(high, 1e-6 * highest);
      const pad = 0.06 * (high - (plot.zero ? 0 : low)) || Math.abs(high) || 1;
      if (panel.log) return plot.lowest ? [plot.lowest * 1.06 * high, 1.06 * high] : [low / 1.5, high * 1.5];
      return [plot.zero ? 0 : low - pad, high + pad];
    }

    function draw(panel) {
      const shown = items.filter(on), range = view.x || whole(panel.log);
      const inside = frame(panel, plot, range, plot.xlog, height(panel, shown, range), panel.log), {X, Y, left, right, top, bottom} = panel.frame;
      const at = (x, y) => `${X.to(x).toFixed(2)},${Y.to(y).toFixed(2)}`, walls = plot.walls || [];
      for (const wall of walls) {
        const x = X.to(wall), [from, to] = wall < 0 || (wall === 0 && walls.length > 1) ? [left, x] : [x, right];
        if (walls.filter(w => w * wall > 0).length === 1 && to > from) svg(inside, "rect", {x: from, y: top, width: to - from, height: bottom - top, class: "wall"});
        svg(inside, "line", {x1: x, x2: x, y1: top, y2: bottom, class: "edge"});
      }
      for (const {y, words, fill} of plot.levels || []) {
        const place = Y.to(y);
        if (fill && place < bottom) svg(inside, "rect", {x: left, y: place, width: right - left, height: bottom - place, class: "wall"});
        else svg(inside, "line", {x1: left, x2: right, y1: place, y2: place, class: "edge"});
        svg(inside, "text", {x: right - 4, y: fill ? place + 12 : place - 4, "text-anchor": "end"}, words);
      }
      for (const s of shown) {
        const seen = [...s.x.keys()].filter(i => s.y[i] !== null && s.y[i] !== undefined), run = list => list.map((p, k) => (k ? "L" : "M") + p).join("");
        const side = (i, sign) => at(s.x[i], s.y[i] + sign * s.bars * (s.error[i] ?? 0)), other = seen.slice().reverse();
        if (s.band) svg(inside, "polygon", {points: [...seen.map(i => side(i, 1)), ...other.map(i => side(i, -1))].join(" "), fill: s.colour, class: "band"});
        if (s.dash !== undefined) svg(inside, "path", {d: run(seen.map(i => at(s.x[i], s.y[i]))), class: "curve", stroke: s.colour, "stroke-dasharray": s.dash || "none"});
        if (s.guide) svg(inside, "path", {d: run(s.guide[0].map((x, i) => at(x, s.guide[1][i]))), class: "curve guide", stroke: s.colour, "stroke-dasharray": "5 3"});
        if (!s.marks) continue;
        const bars = s.bars && s.error ? seen.map(i => `M${side(i, 1)}L${side(i, -1)}`) : [];
        const rings = seen.map(i => `M${at(s.x[i], s.y[i])}${s.marks}`);
        svg(inside, "path", {d: bars.concat(rings).join(""), fill: "none", stroke: s.colour, class: "marks"});
      }
    }

    const points = () => items.filter(on).flatMap(s => s.x.map((x, i) => ({s, i, x, y: s.y[i]}))).filter(p => p.y !== null);
    return {
      items, draw, zoomed: ["x"],
      panels: plot.scales.map(log => ({log})),
      snap([x, y], {X, Y}) {
        if (plot.x) return {x: plot.x[nearest(plot.x, x, X.f)]};
        const far = p => Math.hypot(X.to(p.x) - X.to(x), Y.to(p.y) - Y.to(y));
        return points().reduce((best, p) => !best || far(p) < far(best) ? p : best, null);
      },
      step(by, up, {X}) {
        if (plot.x) return {x: plot.x[within(nearest(plot.x, view.cursor?.x ?? X.inverse((X.f(X.low) + X.f(X.high)) / 2), X.f) + by, plot.x)]};
        const all = points(), lines = items.filter(on), own = view.cursor?.s ?? lines[0];
        if (!all.length) return null;
        const line = lines[within(Math.max(lines.indexOf(own), 0) - up, lines)], order = all.filter(p => p.s === line).sort((p, q) => p.x - q.x);
        const now = view.cursor ? nearest(order.map(p => p.x), view.cursor.x, X.f) : -by;
        return order[within(now + by, order)];
      },
      mark({cursor, frame: {X, Y, top, bottom}}) {
        const {x, y} = view.cursor;
        if (plot.x) svg(cursor, "line", {x1: X.to(x), x2: X.to(x), y1: top, y2: bottom, class: "cursor"});
        else svg(cursor, "circle", {cx: X.to(x), cy: Y.to(y), r: 6, class: "cursor"});
      },
      values() { // of every route of the curves that are on, at the cursor
        const {x, s, i} = view.cursor;
        if (!plot.x) return [point(s, i)];
        const near = v => s => { const k = nearest(s.x, v), step = Math.abs((s.x.at(-1) - s.x[0]) / (s.x.length - 1)); return s.y.length && s.y[k] !== null && (s.x === plot.x || Math.abs(s.x[k] - v) <= step) ? [point(s, k)] : []; };
        return items.filter(s => !off.curve.has(s.curve)).flatMap(near(x));
      },
      place: () => `${plot.xlabel} = ${show(view.cursor.x)}`,
      tell: v => `: ${plot.x ? "" : `${plot.ylabel} = `}${show(v.p)}${plusMinus(v.error)}${v.note ? `; ${v.note}` : ""}`,
    };
  }

  // Maps: a panel for each field on a grid; NaN is left empty. A cell reaches halfway to the next.
  function maps(plot, view, on) {
    const items = plot.fields, [width, height] = [plot.x.length, plot.y.length];
    const logOf = key => plot[`${key}log`], f = key => logOf(key) ? Math.log : v => v, inverse = key => logOf(key) ? Math.exp : v => v;
    const edges = (key, list) => { // of all cells of a list
      const u = list.map(f(key)), half = [(u[1] - u[0]) / 2, (u.at(-1) - u.at(-2)) / 2];
      return [inverse(key)(u[0] - half[0]), inverse(key)(u.at(-1) + half[1])];
    };
    for (const s of items) { s.x ??= plot.x; s.y ??= plot.y; }
    const colours = data.palette.map(c => [1, 3, 5].map(k => parseInt(c.slice(k, k + 2), 16)));
    const rgb = c => [1, 3, 5].map(k => parseInt(c.slice(k, k + 2), 16));

    // The fractional number in a list that belongs to v: whole numbers are entries.
    function number(key, list, v) {
      const u = f(key)(v), at = k => f(key)(list[k]);
      let i = 0, j = list.length - 1;
      while (j - i > 1) { const k = (i + j) >> 1; if (at(k) <= u) i = k; else j = k; }
      return i + (u - at(i)) / (at(j) - at(i));
    }

    function picture(s, {X, Y, left, right, top, bottom}, colour) {
      const canvas = document.createElement("canvas"), [w, h] = [Math.round(right - left), Math.round(bottom - top)];
      Object.assign(canvas, {width: w, height: h});
      const context = canvas.getContext("2d"), image = context.createImageData(w, h), ny = s.y.length;
      const columns = Array.from({length: w}, (_, k) => number("x", s.x, X.back(left + k + 0.5))), last = [s.x.length - 1, ny - 1];
      for (let r = 0; r < h; r++) {
        const v = number("y", s.y, Y.back(top + r + 0.5));
        if (v < -0.5 || v > last[1] + 0.5) continue;
        for (let k = 0; k < w; k++) {
          const u = columns[k];
          if (u < -0.5 || u > last[0] + 0.5) continue;
          let z;
          if (s.smooth) {
            const a = Math.min(Math.max(u, 0), last[0] - 1e-9), b = Math.min(Math.max(v, 0), last[1] - 1e-9), i = Math.floor(a), j = Math.floor(b), k = i * ny + j;
            z = (1 - a + i) * ((1 - b + j) * s.z[k] + (b - j) * s.z[k + 1]) + (a - i) * ((1 - b + j) * s.z[k + ny] + (b - j) * s.z[k + ny + 1]);
          } else z = s.z[within(Math.round(u), s.x) * ny + within(Math.round(v), s.y)];
          const c = z === null ? null : colour(z);
          if (c) image.data.set([...c, 255], 4 * (r * w + k));
        }
      }
      context.putImageData(image, 0, 0);
      return canvas.toDataURL();
    }

    function draw(panel) {
      const s = panel.item, ranges = ["x", "y"].map(key => view[key] || edges(key, plot[key]));
      const inside = frame(panel, plot, ranges[0], plot.xlog, ranges[1], plot.ylog, {right: 74, name: s.name});
      const {X, Y, left, right, top, bottom} = panel.frame, log = panel.log && s.floor > 0;
      const C = s.names ? null : axis([log ? s.floor : s.low, s.high], log, bottom, top);
      const colour = s.names ? z => rgb(s.colours[z]) : z => z < C.low && log && plot.cut ? null : colours[Math.round(Math.min(Math.max((bottom - C.to(z)) / (bottom - top), 0), 1) * (colours.length - 1))];
      svg(inside, "image", {href: picture(s, panel.frame, colour), x: left, y: top, width: right - left, height: bottom - top, preserveAspectRatio: "none"});
      (plot.walls || []).forEach((walls, k) => {
        for (const wall of walls) svg(inside, "line", k ? {x1: left, x2: right, y1: Y.to(wall), y2: Y.to(wall), class: "stop"} : {x1: X.to(wall), x2: X.to(wall), y1: top, y2: bottom, class: "stop"});
      });
      if (plot.split) svg(inside, "path", {d: border(X, Y), class: "stop"});
      if (s.names) return s.names.forEach((words, k) => {
        const x = left + 6, y = top + 8 + 18 * k;
        svg(panel.canvas, "rect", {x, y: y - 4, width: 18 + 7.2 * words.length, height: 18, class: "plate"});
        svg(panel.canvas, "rect", {x: x + 4, y, width: 10, height: 10}).style.fill = s.colours[k]; // as in the image, on a dark page too
        svg(panel.canvas, "text", {x: x + 18, y: y + 9}, words);
      });
      colours.forEach((c, k) => svg(panel.canvas, "rect", {x: right + 10, width: 12, y: bottom - (k + 1) * (bottom - top) / colours.length, height: (bottom - top) / colours.length + 0.5, fill: data.palette[k]}));
      for (const v of C.ticks(5)) svg(panel.canvas, "text", {x: right + 26, y: C.to(v) + 4}, word(v));
    }

    function border(X, Y) { // between cells on both sides of a level
      const middle = (key, list, k) => inverse(key)((f(key)(list[k]) + f(key)(list[k + 1])) / 2), path = [], {split} = plot;
      const end = (key, list, k) => k < 0 ? edges(key, list)[0] : k > list.length - 2 ? edges(key, list)[1] : middle(key, list, k);
      for (let i = 0; i < width; i++) for (let j = 0; j < height; j++) {
        const [x0, x1, y0, y1] = [X.to(end("x", plot.x, i - 1)), X.to(end("x", plot.x, i)), Y.to(end("y", plot.y, j - 1)), Y.to(end("y", plot.y, j))];
        if (i + 1 < width && split[i * height + j] !== split[(i + 1) * height + j]) path.push(`M${x1},${y0}V${y1}`);
        if (j + 1 < height && split[i * height + j] !== split[i * height + j + 1]) path.push(`M${x0},${y1}H${x1}`);
      }
      return path.join("");
    }

    return {
      items, draw, zoomed: ["x", "y"],
      panels: items.map(item => ({item, log: item.log})),
      snap: ([x, y]) => ({x: plot.x[nearest(plot.x, x, f("x"))], y: plot.y[nearest(plot.y, y, f("y"))]}),
      step: (by, up) => {
        const place = (key, k) => plot[key][within((view.cursor ? plot[key].indexOf(view.cursor[key]) : plot[key].length >> 1) + k, plot[key])];
        return {x: place("x", by), y: place("y", up)};
      },
      mark({cursor, frame: {X, Y, left, right, top, bottom}}) {
        const [x, y] = [X.to(view.cursor.x), Y.to(view.cursor.y)];
        svg(cursor, "path", {d: `M${x},${top}V${bottom}M${left},${y}H${right}`, class: "cross"});
      },
      values: () => items.filter(s => on(s) || !s.shown).map(s => {
        const {x, y} = view.cursor, [i, j] = [nearest(s.x, x, f("x")), nearest(s.y, y, f("y"))], k = i * s.y.length + j;
        return {curve: "", name: s.name, x: s.x[i], y: s.y[j], p: s.z[k], error: s.error?.[k], words: s.names?.[s.z[k]], own: s.x !== plot.x};
      }).filter(v => v.p !== null),
      place: () => `${plot.xlabel} = ${show(view.cursor.x)}, ${plot.ylabel} = ${show(view.cursor.y)}`,
      tell: v => `: ${v.words ?? show(v.p)}${plusMinus(v.error)}`,
    };
  }

  function livePlot(plot) {
    const host = document.createElement("figure"), view = {x: null, y: null, cursor: null};
    Object.assign(host, {className: "live", id: `live_${plot.id}`});
    const drawn = document.getElementById(plot.still[0]);
    drawn.parentNode.insertBefore(host, drawn);
    for (const id of plot.still) document.getElementById(id)?.classList.add("still");
    if (plot.title) html(host, "h3", plot.title);
    const every = plot.fields || plot.series;
    const off = {curve: new Set(), name: new Set(every.filter(s => !s.shown).map(s => s.name))};
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
  return {data, plots, html, show};
})();
