// Text over the 3-D view: numbers of views, axes with units; and the legend.
function paintLabels(canvas, viewer, background) {
  const ratio = viewer.ratio, context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, canvas.width, canvas.height);
  if (background) context.drawImage(background, 0, 0, canvas.width / ratio, canvas.height / ratio);
  context.font = '11px system-ui, "Noto Sans", "DejaVu Sans", sans-serif';
  context.textBaseline = "middle";
  if (viewer.shown.axes) paintAxes(context, viewer);
  if (viewer.shown.views) paintViews(context, viewer);
  paintMarked(context, viewer);
}

function paintMarked(context, { orbit, colors, marked }) {
  const places = marked.map((voxel) => orbit.project(voxel.at)).filter((place) => place);
  context.lineWidth = 2;
  context.strokeStyle = context.fillStyle = colors.ink;
  if (places.length === 2) {
    context.beginPath();
    places.forEach(([x, y], n) => (n ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.stroke();
  }
  for (const [x, y] of places) {
    context.beginPath();
    context.arc(x, y, 4.5, 0, 2 * Math.PI);
    context.fillStyle = colors.paper;
    context.fill();
    context.stroke();
  }
}

function paintViews(context, viewer) {
  const { orbit, colors } = viewer;
  const places = steps.map((step, n) => ({ step, n, at: step.pose && orbit.project(eyeOf(step)) })).filter((p) => p.at);
  places.sort((a, b) => (a.n === viewer.step) - (b.n === viewer.step) || b.at[2] - a.at[2]);
  context.textAlign = "center";
  for (const { step, n, at } of places) {
    const chosen = n === viewer.step;
    context.beginPath();
    context.arc(at[0], at[1], chosen ? 11 : 8.5, 0, 2 * Math.PI);
    context.fillStyle = chosen ? colors.accent : step.taken ? colors.view : colors.rejected;
    context.fill();
    context.lineWidth = 1.5;
    context.strokeStyle = colors["view-text"];
    context.stroke();
    context.fillStyle = colors["view-text"];
    context.fillText(String(step.view), at[0], at[1] + 0.5);
  }
}

function paintAxes(context, viewer) {
  const { orbit, colors } = viewer, [low, high] = manifest.bounds;
  const size = Math.max(high[0] - low[0], high[1] - low[1]);
  const nearer = [0, 1].map((i) => (orbit.eye[i] >= 0.5 * (low[i] + high[i]) ? high[i] : low[i]));
  const farther = [0, 1].map((i) => (nearer[i] === high[i] ? low[i] : high[i]));
  const wanted = (i) => Math.max(2, Math.round((8 * (high[i] - low[i])) / size));
  const middle = orbit.project(orbit.middle) || [0, 0];
  const edges = [
    { name: "x", at: (v) => [v, nearer[1], low[2]], ticks: roundTicks(low[0], high[0], wanted(0)), end: high[0] },
    { name: "y", at: (v) => [nearer[0], v, low[2]], ticks: roundTicks(low[1], high[1], wanted(1)), end: high[1] },
  ];
  if (Math.abs(orbit.elevation) < 1.2) {
    const corners = [[nearer[0], farther[1]], [farther[0], nearer[1]]];
    const place = (corner) => (orbit.project([...corner, low[2]]) || [1e9])[0];
    const corner = corners.sort((a, b) => place(a) - place(b))[0];
    edges.push({ name: "z", at: (v) => [...corner, v], ticks: roundTicks(low[2], high[2], 3), end: high[2], left: true });
  }
  context.fillStyle = colors.soft;
  const taken = ["hint", "legend"].map(byId).map((e) => [e.offsetLeft, e.offsetTop, e.offsetLeft + e.offsetWidth, e.offsetTop + e.offsetHeight]);
  for (const edge of edges) {  // the names first: a tick that has no room beside them is left out
    const center = 0.5 * (edge.ticks[0] + edge.ticks.at(-1));
    if (edge.left) paintBeside(context, orbit, edge, edge.end, `${edge.name} [m]`, 30, middle, taken);
    else paintBeside(context, orbit, edge, center, `${edge.name} [m]`, 32, middle, taken);
  }
  for (const edge of edges) for (const tick of edge.ticks) paintBeside(context, orbit, edge, tick, number(tick), 12, middle, taken);
}

// A text so far away from a place of an edge [px], within the picture, unless its room is taken.
function paintBeside(context, orbit, edge, value, label, away, middle, taken) {
  const p = orbit.project(edge.at(value));
  if (!p) return;
  const side = edge.left ? [-1, 0] : unit([p[0] - middle[0], Math.max(p[1] - middle[1], 30), 0]);
  const width = context.measureText(label).width, margin = 5;
  const share = side[0] > 0.35 ? 0 : side[0] < -0.35 ? 1 : 0.5;
  const within = (v, size) => Math.max(margin, Math.min(v, size - margin));
  const left = within(p[0] + away * side[0] - share * width, context.canvas.clientWidth - width);
  const y = within(p[1] + away * side[1], context.canvas.clientHeight - 5);
  const box = [left - margin, y - 5 - margin, left + width + margin, y + 5 + margin];
  if (taken.some((b) => box[0] < b[2] && b[0] < box[2] && box[1] < b[3] && b[1] < box[3])) return;
  taken.push([left, y - 5, left + width, y + 5]);
  context.textAlign = "left";
  context.fillText(label, left, y);
}

function paintLegend(viewer) {
  const box = byId("legend");
  box.replaceChildren(mapScale(viewer));
  const range = viewer.shown.candidates && ratingRange(viewer.candidates);
  if (range) {
    const ticks = roundTicks(range[0], range[1], 4).map((v) => [(v - range[0]) / (range[1] - range[0]), number(v)]);
    box.append(scaleElement("rating", manifest.colorMaps.rating, ticks, viewer));
  }
}

function mapScale(viewer) {
  const { mode } = viewer, [low, high] = viewer.range(mode);
  const place = (v) => (v - low) / (high - low);
  let ticks, title;
  if (mode === "height") {
    title = "height [m]";
    ticks = roundTicks(low, high, 5).map((v) => [place(v), number(v)]);
  } else if (mode === "sigma") {
    title = "sigma";
    const [a, b] = manifest.sigma.scale.map(Math.log);
    const values = [1, 2, 5].flatMap((f) => [-4, -3, -2, -1].map((e) => f * 10 ** e)).sort((x, y) => x - y);
    ticks = values.map((v) => [place((Math.log(v) - a) / (b - a)), quantity(v, "m", 2)]);
  } else {
    title = "probability";
    const [a, b] = manifest.logOdds;
    ticks = [0.5, 0.9, 0.99, 0.999].map((p) => [place((Math.log(p / (1 - p)) - a) / (b - a)), String(p)]);
  }
  return scaleElement(title, manifest.colorMaps[mode], ticks, viewer);
}

function scaleElement(title, name, ticks, viewer) {
  const element = document.createElement("div"), table = viewer.arrays[`map_${name}`];
  const stops = [...Array(17).keys()].map((i) => `rgb(${table.subarray(3 * Math.round((255 * i) / 16), 3 * Math.round((255 * i) / 16) + 3).join(",")})`);
  element.className = "scale";
  element.style.background = `linear-gradient(to top, ${stops.join(",")})`;
  const heading = document.createElement("b");
  heading.textContent = title;
  element.append(heading);
  for (const [share, text] of ticks) {
    if (share < -0.005 || share > 1.005) continue;
    const tick = document.createElement("span");
    tick.textContent = text;
    tick.style.top = `${100 * (1 - share)}%`;
    element.append(tick);
  }
  return element;
}
