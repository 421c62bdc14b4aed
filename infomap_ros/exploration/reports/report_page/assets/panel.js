// Controls beside the 3-D view, and the details of what is chosen.
function element(name, text, className) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  if (className) made.className = className;
  return made;
}

function valuesTable(caption, values, format = number) {
  const table = element("table"), body = element("tbody");
  table.append(element("caption", caption), body);
  for (const [name, value] of Object.entries(values)) {
    const row = element("tr");
    row.append(element("td", `${words(name)} ${(manifest.units || {})[name] || ""}`), element("td", format(value), "number"));
    body.append(row);
  }
  return table;
}

const point = (p) => p.map((v) => v.toFixed(2).replace("-", "−")).join("  ");

function showStep(n, arrays) {
  const step = steps[n], parts = [];
  parts.push(element("h3", step.pose ? `View ${step.view}` : `Decision ${n + 1}`));
  parts.push(element("p", `${step.outcome}, decided at ${duration(step.time)}${step.strategy ? ` by ${words(step.strategy)}` : ""}`, step.taken ? "good" : step.outcome.startsWith("planned") ? "warn" : "bad"));
  if (step.reason) parts.push(element("p", step.reason));
  if (Object.keys(step.terms).length) parts.push(valuesTable("Terms of its rating", { ...step.terms, rating: step.rating }));
  const facts = {};
  if (step.pose) facts["camera x y z [m]"] = point(eyeOf(step));
  if (step.base) facts["base x y [m]"] = point(step.base.slice(0, 2));
  if (step.base) facts["base yaw"] = `${Math.round((step.base[2] * 180) / Math.PI)}°`.replace("-", "−");
  const starts = arrays && arrays.candidate_starts;
  const shown = starts ? starts[n + 1] - starts[n] : 0;
  facts.candidates = shown === step.considered ? String(shown) : `${step.considered}, ${shown} of them shown`;
  parts.push(valuesTable("Where", facts, String));
  if (Object.keys(step.seconds).length) parts.push(valuesTable("Computing time", step.seconds, (s) => quantity(s, "s")));
  byId("details").replaceChildren(...parts);
  byId("through").disabled = !step.pose;
}

// Where the marked voxels are, and how far from each other.
function showMarked(marked) {
  if (!marked.length) return byId("marked").replaceChildren(element("p", "Click the map: coordinates. Click again: how far."));
  const values = {};
  if (marked.length === 2) {
    const [dx, dy, dz] = add(marked[1].at, marked[0].at, -1);
    values["straight distance"] = quantity(Math.hypot(dx, dy, dz), "m");
    values["level distance"] = quantity(Math.hypot(dx, dy), "m");
    values["height difference"] = quantity(dz, "m");
  }
  marked.forEach(({ at, sigma, probability: p }, n) => {
    const name = marked.length > 1 ? ["first ", "second "][n] : "";
    values[`${name}x y z [m]`] = point(at);
    values[`${name}sigma, probability`] = `${quantity(sigma, "m", 2)}, ${number(p, 4)}`;
  });
  byId("marked").replaceChildren(valuesTable(`Measured on voxels of ${quantity(manifest.voxel, "m", 2)}`, values, String));
}

function showCandidate(candidate) {
  const state = candidate.rejection ? `rejected: ${candidate.rejection}` : "possible";
  const terms = Object.fromEntries(Object.entries(candidate.terms).filter(([, value]) => Number.isFinite(value)));
  byId("details").replaceChildren(
    element("h3", `Candidate ${candidate.number} of decision ${candidate.decision + 1}`),
    element("p", state, candidate.rejection ? "bad" : "good"),
    valuesTable("Terms of its rating", { ...terms, rating: candidate.rating }),
    valuesTable("Where", { "camera x y z [m]": point(candidate.position) }, String),
  );
}

function tipText(found) {
  if (found.candidate) {
    const { rejection, rating, number: n } = found.candidate;
    return rejection ? `candidate ${n}, rejected: ${rejection}` : `candidate ${n}, rating ${number(rating)}`;
  }
  const step = steps[found.step];
  const terms = Object.entries(step.terms).map(([name, value]) => `${words(name)} ${number(value)} ${(manifest.units || {})[name] || ""}`.trim());
  return [`view ${step.view}, rating ${number(step.rating)}`, ...terms].join(" · ");
}

function connectPanel(viewer, choose) {
  for (const input of document.querySelectorAll('input[name="color"]')) {
    input.addEventListener("change", () => { viewer.mode = input.value; paintLegend(viewer); viewer.redraw(); });
  }
  for (const input of byId("layers").querySelectorAll("input")) {
    input.addEventListener("change", () => { viewer.shown[input.name] = input.checked; paintLegend(viewer); viewer.redraw(); });
  }
  for (const button of byId("cameras").querySelectorAll("button")) {
    button.addEventListener("click", () => viewer.orbit[button.dataset.camera]());
  }
  connectCuts(viewer);
  showMarked([]);
  document.addEventListener("keydown", (event) => { if (event.key === "Escape") viewer.unmark(); });
  if (steps.length) connectSteps(viewer, choose);
}

function connectCuts(viewer) {
  const cut = byId("cut"), least = byId("least");
  const low = manifest.bounds[0][2], high = manifest.bounds[1][2];
  const showCut = () => {
    byId("cut-text").textContent = viewer.cut < Infinity ? `${viewer.cut.toFixed(2)} m` : "nothing";
    paintLegend(viewer);
    viewer.redraw();
  };
  if (viewer.cut < Infinity) cut.value = String(Math.round((200 * (viewer.cut - low)) / (high - low)));
  cut.addEventListener("input", () => {
    viewer.cut = cut.value === cut.max ? Infinity : low + (cut.value / 200) * (high - low);
    showCut();
  });
  const showLeast = () => {
    const [a, b] = manifest.logOdds;
    byId("least-text").textContent = number(probability(a + viewer.least * (b - a)), viewer.least > 0.5 ? 4 : 2);
    viewer.redraw();
  };
  least.value = String(Math.round(100 * viewer.least));
  least.addEventListener("input", () => { viewer.least = least.value / 100; showLeast(); });
  showCut();
  showLeast();
}

function connectSteps(viewer, choose) {
  const slider = byId("step"), play = byId("play");
  let timer = null;
  const stop = () => { clearInterval(timer); timer = null; play.textContent = "play"; };
  slider.max = String(steps.length - 1);
  slider.addEventListener("input", () => { stop(); choose(Number(slider.value)); });
  byId("before").addEventListener("click", () => { stop(); choose(Math.max(0, viewer.step - 1)); });
  byId("after").addEventListener("click", () => { stop(); choose(Math.min(steps.length - 1, viewer.step + 1)); });
  play.addEventListener("click", () => {
    if (timer) return stop();
    if (viewer.step >= steps.length - 1) choose(0);
    play.textContent = "stop";
    timer = setInterval(() => (viewer.step + 1 < steps.length ? choose(viewer.step + 1) : stop()), 900);
  });
  byId("through").addEventListener("click", () => {
    const step = steps[viewer.step];
    if (step.pose) viewer.orbit.from(eyeOf(step), aheadOf(step));
  });
}
