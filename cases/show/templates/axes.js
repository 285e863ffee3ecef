// Elements, numbers in words, and axes of the plots of a page.
"use strict";
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
    const stride = Math.ceil((last - first + 1) / count), each = stride > 1 || last - first > 3 || 3 * (last - first + 1) > 2 * count ? [1] : [1, 2, 5];
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
