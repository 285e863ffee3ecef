// Closed forms of a chain with one contact mass, damping constant: energy averaging (11), (29), (30)
// with u = exp(-alpha H), modal averaging (34), (36) without its
// contacts. Plain functions of numbers.
const GAUSS = (n => { // Gauss-Legendre nodes and weights on [0, 1]
  const rule = [];
  for (let i = 0; i < n; i++) {
    let x = Math.cos(Math.PI * (i + 0.75) / (n + 0.5)), d = 1;
    for (let k = 0; k < 20; k++) {
      let p = 1, before = 0;
      for (let j = 0; j < n; j++) [p, before] = [((2 * j + 1) * x * p - j * before) / (j + 1), p];
      d = n * (x * p - before) / (x * x - 1);
      x -= p / d;
    }
    rule.push([0.5 * (1 + x), 1 / ((1 - x * x) * d * d)]);
  }
  return rule;
})(24);

// The integral of f between a and b; nodes crowd at both ends, where f may go like a root.
function integral(f, a, b, panels) {
  let sum = 0;
  for (let k = 0; k < panels; k++) {
    for (const [x, w] of GAUSS) {
      const t = (k + x) / panels;
      sum += w / panels * 6 * t * (1 - t) * f(a + (b - a) * t * t * (3 - 2 * t));
    }
  }
  return (b - a) * sum;
}

// Factors of stiffness B and clearance of each contact, of damping c and noise D, all 1 as run.
const asRun = model => Object.fromEntries(["B", "delta", "c", "D"].map(key => [key, model[key].map(() => 1)]));

function closedForms(model, factors) {
  const {n, a} = model, sum = (list, f) => list.reduce((total, one, k) => total + f(one, k), 0);
  const weighted = (key, of) => sum(model[key], (one, k) => one.value * factors[key][k] * of(one));
  const alpha = weighted("c", one => one.rate) / weighted("D", one => one.rate);
  const {frequency: omega, most} = model, entry = (i, j) => one => one.vector ? one.vector[i] * one.vector[j] : one.matrix[i][j];
  const modal = key => omega.map((_, i) => omega.map((_, j) => weighted(key, entry(i, j)))), damping = modal("c"), noise = modal("D");
  const theta = omega.map((_, i) => noise[i][i] / damping[i][i]);
  let neglected = 0; // the largest correlation of two modes that averaging neglects
  omega.forEach((w, i) => omega.forEach((v, j) => {
    if (j <= i) return;
    const source = Math.abs(2 * noise[i][j] - damping[i][j] * theta[j] - damping[j][i] * theta[i]), [c, d] = [damping[i][i], damping[j][j]];
    const gap = Math.abs(w - v) * (w + v), weight = c * v * v + d * w * w;
    const largest = Math.max(Math.max(w, v) * gap, w * v * (c + d), weight) / (gap ** 2 + (c + d) * weight);
    neglected = Math.max(neglected, source / Math.sqrt(theta[i] * theta[j]) * largest);
  }));
  const sides = [1, -1].map(sign => {
    const stops = model.stops.filter(s => s.sign === sign).map(
      s => ({B: s.B * factors.B[s.contact], delta: s.delta * factors.delta[s.contact], e: s.e}));
    const V = x => sum(stops, s => x > s.delta ? s.B / (s.e + 1) * (x - s.delta) ** (s.e + 1) : 0) + 0.5 * a * x * x;
    const force = x => sum(stops, s => x > s.delta ? s.B * (x - s.delta) ** s.e : 0) + a * x;
    const end = H => { // V is convex: Newton's iterates descend to the turning point
      let x = Math.sqrt(2 * H / a);
      for (let k = 0; k < 100; k++) {
        const step = (V(x) - H) / force(x);
        if (!(Math.abs(step) > 4e-16 * x)) break;
        x -= step;
      }
      return x;
    };
    const over = (f, end, panels, more = []) => {
      const inner = [...stops.map(s => s.delta), ...more].filter(d => d > 0 && d < end).sort((p, q) => p - q);
      const nodes = [0, ...inner, end];
      return sum(nodes.slice(1), (b, k) => b > nodes[k] ? integral(f, nodes[k], b, panels) : 0);
    };
    return {sign, V, end, over};
  });
  const U = q => sides[q < 0 ? 1 : 0].V(Math.abs(q));
  const Z = sum(sides, s => s.over(q => Math.exp(-alpha * s.V(q)), s.end(60 / alpha), 8));
  let gamma = Math.sqrt(Math.PI); // of n - 1/2
  for (let k = 1; k < n; k++) gamma *= k - 0.5;
  const normal = (x, variance) => Math.exp(-0.5 * x * x / variance) / Math.sqrt(2 * Math.PI * variance);

  // A mass that touches nothing is Gaussian about w q of the one that does: integrated over q.
  const beside = ({w, precision}) => q => {
    const variance = 1 / (alpha * precision), ends = [-9, -5, -2, 0, 2, 5, 9].map(k => (q + k * Math.sqrt(variance)) / w);
    return sum(sides, s => s.over(x => normal(q - w * s.sign * x, variance) * Math.exp(-alpha * s.V(x)),
      s.end(60 / alpha), 2, ends.map(x => s.sign * x))) / Z;
  };

  const energyOf = H => H <= 0 ? 0 : alpha ** (n - 0.5) / gamma / Z * Math.exp(-alpha * H) * sum(sides, s =>
    s.over(q => Math.max(H - s.V(q), 0) ** (n - 1.5), s.end(H), 1));

  // The sum of independent exponential energies: exp of a matrix with these rates, all terms positive.
  const total = H => {
    const rates = theta.map(t => 1 / t), most = Math.max(...rates), halvings = Math.max(0, Math.ceil(Math.log2(most * H)) + 1);
    const h = H / 2 ** halvings, rows = [...rates.keys()];
    if (H < 0) return 0;
    const times = (A, B) => A.map((row, i) => rows.map(j => { let v = 0; for (let k = i; k <= j; k++) v += row[k] * B[k][j]; return v; }));
    const A = rows.map(i => rows.map(j => j === i ? (most - rates[i]) * h : j === i + 1 ? rates[i] * h : 0));
    let E = rows.map(i => rows.map(j => i === j ? 1 : 0)), term = E;
    for (let k = 1; k < n + 18; k++) {
      term = times(term, A).map(row => row.map(v => v / k));
      E = E.map((row, i) => row.map((v, j) => v + term[i][j]));
    }
    E = E.map(row => row.map(v => v * Math.exp(-most * h)));
    for (let k = 0; k < halvings; k++) E = times(E, E);
    return E[0][n - 1] * rates[n - 1];
  };

  const forms = of => { // the densities of an observable by both theories
    const one = model.of[of];
    if (!one) return null;
    const variance = one.weights && sum(one.weights, (w, i) => w * theta[i]);
    const both = {
      H: {energy: energyOf, modal: total},
      Hi: {modal: H => H < 0 ? 0 : Math.exp(-H / theta[one.mode]) / theta[one.mode]},
      q: {energy: one.beside ? beside(one.beside) : q => Math.exp(-alpha * U(q)) / Z, modal: x => normal(x, variance)},
      p: {energy: p => normal(p, one.mass / alpha), modal: x => normal(x, variance)},
    }[one.kind];
    return Object.fromEntries(one.forms.map(theory => [theory, both[theory]]));
  };
  return Object.assign(forms, {neglected, resonant: neglected > most});
}
