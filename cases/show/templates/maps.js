// Maps: a panel for each field on a grid; NaN is left empty. A cell reaches halfway to the next.
function maps(plot, view, on) {
  const items = plot.fields, [width, height] = [plot.x.length, plot.y.length];
  const logOf = key => plot[`${key}log`], f = key => logOf(key) ? Math.log : v => v, inverse = key => logOf(key) ? Math.exp : v => v;
  const edges = (key, list) => { // of all cells of a list
    const u = list.map(f(key)), half = [(u[1] - u[0]) / 2, (u.at(-1) - u.at(-2)) / 2];
    return [inverse(key)(u[0] - half[0]), inverse(key)(u.at(-1) + half[1])];
  };
  for (const s of items) { s.x ??= plot.x; s.y ??= plot.y; }
  const rgb = c => [1, 3, 5].map(k => parseInt(c.slice(k, k + 2), 16)), colours = data.palette.map(rgb);

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
    plot.stops.forEach((walls, k) => {
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
