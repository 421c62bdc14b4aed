// What is drawn over the map: axes, paths, views as frusta, candidates.
const toRgb = (text) => {
  const hex = text.trim().replace("#", "");
  return [0, 2, 4].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);
};

function themeColors() {
  const style = getComputedStyle(document.documentElement);
  const names = ["stage", "ink", "soft", "line", "base", "camera", "view", "view-text", "rejected", "accent", "paper"];
  return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

function axisItems(bounds, colors) {
  const [low, high] = bounds, tint = [...toRgb(colors.soft), 0.35], items = [];
  const size = Math.max(high[0] - low[0], high[1] - low[1]);
  const ticks = [0, 1].map((i) => roundTicks(low[i], high[i], Math.max(2, Math.round((8 * (high[i] - low[i])) / size))));
  for (const x of ticks[0]) items.push({ a: [x, low[1], low[2]], b: [x, high[1], low[2]], tint, width: 1 });
  for (const y of ticks[1]) items.push({ a: [low[0], y, low[2]], b: [high[0], y, low[2]], tint, width: 1 });
  for (const x of [low[0], high[0]]) items.push({ a: [x, low[1], low[2]], b: [x, high[1], low[2]], tint, width: 1.5 });
  for (const y of [low[1], high[1]]) items.push({ a: [low[0], y, low[2]], b: [high[0], y, low[2]], tint, width: 1.5 });
  for (const x of [low[0], high[0]]) {
    for (const y of [low[1], high[1]]) items.push({ a: [x, y, low[2]], b: [x, y, high[2]], tint, width: 1 });
  }
  return items;
}

// Up to the decision `until`.
function pathItems(arrays, who, colors, until) {
  const items = [], tint = [...toRgb(colors[who]), 1];
  const point = (i) => [...arrays.path_points.subarray(3 * i, 3 * i + 3)];
  const end = until < steps.length ? steps[until].time : Infinity;
  (manifest.paths || []).forEach((path, n) => {
    if (path.who !== who || path.time > end) return;
    for (let i = arrays.path_starts[n]; i + 1 < arrays.path_starts[n + 1]; i++) {
      items.push({ a: point(i), b: point(i + 1), tint, width: who === "base" ? 3.5 : 2.5 });
    }
  });
  return items;
}

const eyeOf = (step) => [step.pose[3], step.pose[7], step.pose[11]];
const aheadOf = (step) => [step.pose[2], step.pose[6], step.pose[10]];

function frustumItems(step, length, tint, width) {
  const rays = manifest.camera || [[-0.5, -0.4, 1], [0.5, -0.4, 1], [0.5, 0.4, 1], [-0.5, 0.4, 1]];
  const eye = eyeOf(step), items = [];
  const corners = rays.map((ray) => transform(step.pose, ray.map((v) => v * length)));
  corners.forEach((corner, i) => {
    items.push({ a: eye, b: corner, tint, width });
    items.push({ a: corner, b: corners[(i + 1) % 4], tint, width });
  });
  return items;
}

function viewItems(selected, size, colors) {
  return steps.flatMap((step, n) => {
    if (!step.pose) return [];
    const chosen = n === selected;
    const name = chosen ? "accent" : step.taken ? "view" : "rejected";
    return frustumItems(step, chosen ? 2.5 * size : size, [...toRgb(colors[name]), chosen ? 1 : 0.8], chosen ? 2.5 : 1.4);
  });
}

// The candidates of a decision, those that were possible last, so that they lie on top.
function candidatesOf(arrays, n) {
  if (!arrays.candidate_starts || n + 1 >= arrays.candidate_starts.length) return [];
  const listed = [];
  for (let i = arrays.candidate_starts[n]; i < arrays.candidate_starts[n + 1]; i++) {
    const width = manifest.terms.length;
    listed.push({
      decision: n, number: i - arrays.candidate_starts[n] + 1,
      position: [...arrays.candidate_positions.subarray(3 * i, 3 * i + 3)],
      direction: [...arrays.candidate_directions.subarray(3 * i, 3 * i + 3)].map((v) => v / 127),
      rating: arrays.candidate_ratings[i], rejection: manifest.rejections[arrays.candidate_rejections[i]],
      terms: Object.fromEntries(manifest.terms.map((name, t) => [name, arrays.candidate_terms[i * width + t]])),
    });
  }
  return listed.sort((a, b) => !a.rejection - !b.rejection || a.rating - b.rating);
}

function ratingRange(candidates) {
  const ratings = candidates.filter((c) => !c.rejection && Number.isFinite(c.rating)).map((c) => c.rating);
  if (!ratings.length) return null;
  const low = Math.min(...ratings), high = Math.max(...ratings);
  return [low, high > low ? high : low + 1];
}

function candidateItems(candidates, size, colors, table) {
  const range = ratingRange(candidates), gray = toRgb(colors.rejected);
  const marks = [], stubs = [];
  for (const candidate of candidates) {
    const rated = range && !candidate.rejection && Number.isFinite(candidate.rating);
    const share = rated ? (candidate.rating - range[0]) / (range[1] - range[0]) : 0;
    const index = 3 * Math.round(255 * Math.max(0, Math.min(1, share)));
    const tint = rated ? [...[...table.subarray(index, index + 3)].map((v) => v / 255), 1] : [...gray, 0.55];
    marks.push({ a: candidate.position, tint, width: rated ? 10 : 6 });
    const end = add(candidate.position, candidate.direction, 0.45 * size);
    stubs.push({ a: candidate.position, b: end, tint: [...tint.slice(0, 3), 0.8 * tint[3]], width: rated ? 2 : 1 });
  }
  return { marks, stubs };
}
