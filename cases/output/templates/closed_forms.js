// Closed forms of a chain with one contact mass, damping constant: energy averaging (11), (29), (30)
// with u = exp(-alpha H), modal averaging (34), (36) without its contacts. Plain functions of numbers.
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

// Factors of the contact stiffness B, the clearance, the damping c and the noise D, all 1 as run.
const AS_RUN = {B: 1, delta: 1, c: 1, D: 1};

function closedForms(model, factors) {
  const {n, a} = model, alpha = model.alpha * factors.c / factors.D, heat = factors.D / factors.c;
  const sides = [1, -1].map(sign => {
    const stops = model.stops.filter(s => s.sign === sign).map(
      s => ({B: s.B * factors.B, delta: s.delta * factors.delta, e: s.e}));
    const V = x => stops.reduce((sum, s) =>
      sum + (x > s.delta ? s.B / (s.e + 1) * (x - s.delta) ** (s.e + 1) : 0), 0.5 * a * x * x);
    const force = x => stops.reduce((sum, s) =>
      sum + (x > s.delta ? s.B * (x - s.delta) ** s.e : 0), a * x);
    const end = H => { // V is convex: Newton's iterates descend to the turning point
      let x = Math.sqrt(2 * H / a);
      for (let k = 0; k < 100; k++) {
        const step = (V(x) - H) / force(x);
        if (!(Math.abs(step) > 4e-16 * x)) break;
        x -= step;
      }
      return x;
    };
    const over = (f, end, panels) => {
      const nodes = [0, ...stops.map(s => s.delta).filter(d => d > 0 && d < end).sort((p, q) => p - q), end];
      return nodes.slice(1).reduce((sum, b, k) => sum + integral(f, nodes[k], b, panels), 0);
    };
    return {V, end, over};
  });
  const Z = sides.reduce((sum, s) => sum + s.over(q => Math.exp(-alpha * s.V(q)), s.end(60 / alpha), 8), 0);
  let gamma = Math.sqrt(Math.PI); // of n - 1/2
  for (let k = 1; k < n; k++) gamma *= k - 0.5;
  const normal = (x, variance) => Math.exp(-0.5 * x * x / variance) / Math.sqrt(2 * Math.PI * variance);
  const energy = {
    q: q => Math.exp(-alpha * sides[q < 0 ? 1 : 0].V(Math.abs(q))) / Z,
    H: H => H <= 0 ? 0 : alpha ** (n - 0.5) / gamma / Z * Math.exp(-alpha * H) * sides.reduce((sum, s) =>
      sum + s.over(q => Math.max(H - s.V(q), 0) ** (n - 1.5), s.end(H), 1), 0),
  };
  const total = H => {
    const [x, y] = model.theta.map(t => t * heat);
    if (H < 0) return 0;
    if (n === 1) return Math.exp(-H / x) / x;
    const z = H * (1 / y - 1 / x); // exp(-H/x) (1 - exp(-z)) / (x - y), also where x = y
    return Math.exp(-H / x) * H / (x * y) * (Math.abs(z) < 1e-14 ? 1 : -Math.expm1(-z) / z);
  };
  return of => { // the densities of an observable by both theories
    const one = model.of[of];
    if (!one) return null;
    if (one.kind === "H") return {energy: energy.H, modal: model.theta.length === n && n <= 2 ? total : null};
    return {
      energy: one.kind === "q" ? energy.q : p => normal(p, one.mass / alpha),
      modal: one.variance ? x => normal(x, one.variance * heat) : null,
    };
  };
}
