// Puts the page together. What needs no WebGL is connected first.
let viewer = null;
let loaded = null;

function choose(n, scroll = false) {
  for (const marked of document.querySelectorAll("[data-step]")) {
    marked.classList.toggle("selected", Number(marked.dataset.step) === n);
  }
  byId("step").value = String(n);
  byId("step-text").textContent = `${n + 1} of ${steps.length}`;
  showStep(n, loaded);
  if (viewer) viewer.select(n);
  if (scroll) byId("map").scrollIntoView({ behavior: "smooth" });
}

function connectMarks() {
  for (const marked of document.querySelectorAll("[data-step]")) {
    const act = () => choose(Number(marked.dataset.step), true);
    marked.addEventListener("click", act);
    marked.addEventListener("keydown", (event) => { if (event.key === "Enter") act(); });
  }
}

function connectCharts() {
  const svg = (name, attributes) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    return made;
  };
  for (const chart of document.querySelectorAll("svg.chart")) {
    const points = JSON.parse(chart.dataset.points);
    const mark = svg("circle", { class: "mark", r: 4.5, visibility: "hidden" });
    const text = svg("text", { class: "mark-text", y: 30 });
    chart.append(mark, text);
    chart.addEventListener("pointermove", (event) => {
      const x = new DOMPoint(event.clientX, event.clientY).matrixTransform(chart.getScreenCTM().inverse()).x;
      const [cx, cy, label] = points.reduce((a, b) => (Math.abs(b[0] - x) < Math.abs(a[0] - x) ? b : a));
      for (const [key, value] of Object.entries({ cx, cy, visibility: "visible" })) mark.setAttribute(key, value);
      text.setAttribute("x", 366);
      text.setAttribute("text-anchor", "end");
      text.setAttribute("y", 16);
      text.textContent = label;
    });
    chart.addEventListener("pointerleave", () => { mark.setAttribute("visibility", "hidden"); text.textContent = ""; });
  }
}

function connectTheme() {
  const root = document.documentElement, button = byId("theme");
  const dark = () => (root.dataset.theme || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark";
  const show = () => { button.textContent = dark() ? "light" : "dark"; if (viewer) viewer.recolor(); };
  button.hidden = false;
  button.addEventListener("click", () => { root.dataset.theme = dark() ? "light" : "dark"; show(); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", show);
  let theme;
  window.addEventListener("beforeprint", () => {
    theme = root.dataset.theme;
    root.dataset.theme = "light";
    if (viewer) viewer.freeze();
  });
  window.addEventListener("afterprint", () => {
    if (theme) root.dataset.theme = theme;
    else delete root.dataset.theme;
    if (viewer) { viewer.frozen = false; viewer.resize(); }
    show();
  });
  show();
}

function connectPointer() {
  const tip = byId("tip");
  const hover = (x, y) => {
    const found = viewer.pick(x, y);
    viewer.scene.classList.toggle("pointing", found !== null);
    tip.hidden = found === null;
    if (!found) return;
    tip.textContent = tipText(found);
    tip.style.left = `${Math.min(x + 14, Math.max(viewer.orbit.width - tip.offsetWidth - 8, 0))}px`;
    tip.style.top = `${Math.min(y + 14, viewer.orbit.height - tip.offsetHeight - 8)}px`;
  };
  const click = (x, y) => {
    const found = viewer.pick(x, y);
    if (!found) return;
    if (found.candidate) showCandidate(found.candidate);
    else choose(found.step);
  };
  listenToPointer(viewer.scene, viewer.orbit, hover, click, (x, y) => viewer.center(x, y));
}

async function start() {
  document.body.classList.toggle("no-run", steps.length === 0);
  document.body.classList.toggle("no-path", !(manifest.paths || []).length);
  connectMarks();
  connectCharts();
  try {
    loaded = await readArrays();
    viewer = new Viewer(loaded);
    byId("notice").hidden = true;
    byId("hint").hidden = false;
    byId("panel").hidden = false;
    connectPanel(viewer, choose);
    connectPointer();
  } catch (error) {
    viewer = null;
    byId("notice").textContent = `No 3-D view here (${error.message}). The pictures below show the map without.`;
  }
  connectTheme();
  if (steps.length) choose(Math.max(0, steps.findIndex((step) => step.pose)));
  document.documentElement.dataset.ready = viewer ? "3d" : "2d";
}
start();
