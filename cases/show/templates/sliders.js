// Sliders: the closed forms of both averaged theories for other parameters, drawn beside the answers of the run.
Object.assign(report, (() => {
  const {model} = data;
  if (data.missing) html(touch, "p", data.missing, {class: "soft"});
  if (!model) return {};
  const factors = asRun(model), slid = plots.filter(p => p.plot.series?.some(s => s.form)), inputs = [];
  const raised = unit => unit.replace(/\^([-.\d]+)/g, (_, power) => [...power].map(c => "⁻·⁰¹²³⁴⁵⁶⁷⁸⁹"["-.0123456789".indexOf(c)]).join(""));
  let forms = null; // of the factors as they are
  for (const {plot} of slid) {
    const own = plot.series.filter(s => s.form);
    plot.before = on => {
      if (own.some(on)) forms ??= closedForms(model, factors);
      for (const s of own) {
        s.y = on(s) && !(s.form === "modal" && forms.resonant) ? plot.x.map(forms(plot.of)[s.form]) : [];
        s.error = s.y.map(p => 1e-10 * p);
      }
    };
  }
  html(touch, "p", "Sliders: closed forms of both averaged theories for other parameters, computed here; what was simulated or solved stays as it was run.", {class: "soft"});
  const box = html(touch, "div", "", {id: "sliders"});
  const refused = html(touch, "p", "", {class: "bad", "aria-live": "polite"});
  const slider = (key, k) => {
    const {name, value, unit} = model[key][k], label = html(box, "label", ""), text = html(label, "span", "");
    const most = key === "B" ? 2 : 1;
    const input = html(label, "input", "", {type: "range", min: -most, max: most, step: 0.01, value: 0, "data-key": key, "data-number": k});
    const words = () => { text.textContent = `${name} = ${word(+(value * factors[key][k]).toPrecision(4))}${unit ? " " + raised(unit) : ""}`; };
    input.addEventListener("input", () => {
      factors[key][k] = 10 ** input.value;
      forms = null;
      words();
      for (const p of slid) {
        for (const s of p.plot.series) if (s.form) p.reveal(s.name);
        p.draw();
      }
      refused.textContent = forms?.resonant ? `Modal averaging does not apply to these numbers: internal resonance, it would neglect a correlation of ${forms.neglected.toPrecision(2)} of two modes, at most ${model.most} is allowed.` : "";
    });
    inputs.push(input);
    words();
  };
  for (const key of Object.keys(factors)) model[key].forEach((one, k) => { if (one.value) slider(key, k); });
  html(box, "button", "as run", {type: "button"}).addEventListener("click", () => {
    for (const input of inputs) { input.value = 0; input.dispatchEvent(new Event("input")); }
  });
  return {factors, closedForms: changed => closedForms(model, {...asRun(model), ...changed})};
})());
