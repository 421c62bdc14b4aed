// Puts the page together. What needs no WebGL is connected first.
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
    if (!found) viewer.mark(x, y);
    else if (found.candidate) showCandidate(found.candidate);
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
  if (steps.length) choose(steps.length - 1);
  document.documentElement.dataset.ready = viewer ? "3d" : "2d";
}
start();
