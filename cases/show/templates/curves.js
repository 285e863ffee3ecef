// Curves: a cursor along x where they share it (plot.x), else one at the nearest point.
function curves(plot, view, on, off) {
  const items = plot.series;
  for (const s of items) s.x ??= plot.x;
  const given = items.filter(s => !s.form), highest = ends(given.flatMap(s => s.y))[1];
  const everywhere = ends([...plot.x || [], ...given.flatMap(s => s.x)]);
  const whole = log => {
    const seen = plot.cut && !log ? plot.x.filter((_, i) => given.some(s => s.x === plot.x && s.y[i] > plot.cut * highest)) : [];
    if (seen.length) return [plot.x[Math.max(plot.x.indexOf(seen[0]) - 1, 0)], seen.at(-1)];
    const [a, b] = everywhere, pad = given.some(s => s.marks && s.x === plot.x) || !plot.x ? 0.04 : 0; // a marker is seen whole
    return plot.xlog ? [a / (b / a) ** pad, b * (b / a) ** pad] : [a && a - pad * (b - a), b + pad * (b - a)];
  };
  const point = (s, i) => ({curve: s.curve, name: s.name, x: s.x[i], p: s.y[i], error: s.error?.[i], note: s.notes?.[i], own: plot.x && s.x[i] !== view.cursor.x});

  function height(panel, shown, [a, b]) {
    const inside = s => [...s.y.keys()].filter(i => s.y[i] !== null && s.x[i] >= a && s.x[i] <= b && (!panel.log || s.y[i] > 0));
    const reach = (s, i) => (panel.log ? [0, 1] : [0, 1, -1]).map(sign => s.y[i] + sign * (s.bars && s.error?.[i] || 0) * (s.bars || 0));
    const seen = shown.flatMap(s => inside(s).flatMap(i => reach(s, i)));
    let [low, high] = seen.length ? ends(seen) : [1e-3, 1].map(v => v * (highest > 0 ? highest : 1));
    if (plot.limits && panel.log) return plot.limits;
    if (plot.cut) high = Math.max(high, 1e-6 * highest);
    const pad = 0.06 * (high - (plot.zero ? 0 : low)) || Math.abs(high) || 1;
    if (panel.log) return plot.lowest ? [plot.lowest * high, 2 * high] : [low / 1.5, high * 1.5];
    return [plot.zero ? 0 : low - pad, high + pad];
  }

  function draw(panel) {
    const shown = items.filter(on), range = view.x || whole(panel.log);
    const inside = frame(panel, plot, range, plot.xlog, height(panel, shown, range), panel.log), {X, Y, left, right, top, bottom} = panel.frame;
    const at = (x, y) => `${X.to(x).toFixed(2)},${Y.to(y).toFixed(2)}`;
    for (const ends of plot.shaded) {
      const [from, to] = [ends[0] === null ? left : X.to(ends[0]), ends[1] === null ? right : X.to(ends[1])];
      if (to > from) svg(inside, "rect", {x: from, y: top, width: to - from, height: bottom - top, class: "wall"});
    }
    for (const wall of plot.stops) svg(inside, "line", {x1: X.to(wall), x2: X.to(wall), y1: top, y2: bottom, class: "edge"});
    for (const {y, words, fill} of plot.levels) {
      const place = Y.to(y);
      if (fill && place < bottom) svg(inside, "rect", {x: left, y: place, width: right - left, height: bottom - place, class: "wall"});
      else svg(inside, "line", {x1: left, x2: right, y1: place, y2: place, class: "edge"});
      svg(inside, "text", {x: right - 4, y: fill ? place + 12 : place - 4, "text-anchor": "end"}, words);
    }
    for (const s of [...shown].sort((a, b) => Boolean(b.marks) - Boolean(a.marks))) { // lines above points
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
