// What every page has: charts that tell their values, and a button for light and dark.
const byId = (id) => document.getElementById(id);
let viewer = null;

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
