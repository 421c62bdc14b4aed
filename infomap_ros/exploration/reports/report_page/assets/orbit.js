// The viewer's camera: turns about a point, z of the map up.
const VIEW_ANGLE = 0.7; // vertical [rad]

class Orbit {
  constructor(bounds, onChange) {
    this.onChange = onChange;
    this.bounds = bounds;
    this.middle = bounds[0].map((low, i) => 0.5 * (low + bounds[1][i]));
    this.radius = Math.max(0.5 * Math.hypot(...bounds[0].map((low, i) => bounds[1][i] - low)), 0.1);
    this.width = this.height = 1;
    this.home();
  }

  home() { this.place(-2.2, 0.62); this.untouched = true; }
  top() { this.place(-Math.PI / 2, Math.PI / 2 - 1e-3); }
  side() { this.place(-Math.PI / 2, 0.12); }

  place(azimuth, elevation) {
    Object.assign(this, { azimuth, elevation, target: [...this.middle], untouched: false });
    this.distance = 4 * this.radius;
    for (let i = 0; i < 3; i++) this.fit();
    this.onChange();
  }

  // Let the box fill the picture, but for a rim.
  fit() {
    this.update(this.width, this.height);
    const places = [0, 1, 2, 3, 4, 5, 6, 7].map((i) => this.project(this.bounds[0].map((low, k) => ((i >> k) & 1 ? this.bounds[1][k] : low))));
    const [x, y] = [0, 1].map((k) => [Math.min(...places.map((p) => p[k])), Math.max(...places.map((p) => p[k]))]);
    this.move(0.5 * (this.width - x[0] - x[1]), 0.5 * (this.height - y[0] - y[1]));
    this.distance *= Math.max((x[1] - x[0]) / this.width, (y[1] - y[0]) / this.height) / 0.88;
  }

  // See from a point along a direction, as a camera there does.
  from(eye, direction) {
    const ahead = unit(direction);
    this.distance = 0.12 * this.radius;
    this.untouched = false;
    this.target = add(eye, ahead, this.distance);
    this.azimuth = Math.atan2(-ahead[1], -ahead[0]);
    this.elevation = Math.asin(Math.max(-1, Math.min(1, -ahead[2])));
    this.onChange();
  }

  turn(dx, dy) {
    this.untouched = false;
    this.azimuth -= dx * 0.006;
    const limit = Math.PI / 2 - 1e-3;
    this.elevation = Math.max(-limit, Math.min(limit, this.elevation + dy * 0.006));
    this.onChange();
  }

  move(dx, dy) {
    const { right, up } = this.axes();
    const scale = (2 * this.distance * Math.tan(VIEW_ANGLE / 2)) / this.height;
    this.target = add(add(this.target, right, -dx * scale), up, dy * scale);
    this.onChange();
  }

  zoom(factor) {
    this.untouched = false;
    this.distance = Math.max(0.01 * this.radius, Math.min(20 * this.radius, this.distance * factor));
    this.onChange();
  }

  axes() {
    const ce = Math.cos(this.elevation), se = Math.sin(this.elevation);
    const ca = Math.cos(this.azimuth), sa = Math.sin(this.azimuth);
    return { back: [ce * ca, ce * sa, se], right: [-sa, ca, 0], up: [-se * ca, -se * sa, ce] };
  }

  update(width, height) {
    Object.assign(this, { width, height });
    const { back, right, up } = this.axes();
    this.eye = add(this.target, back, this.distance);
    const near = Math.max(0.02 * this.distance, 0.001 * this.radius);
    const reach = this.distance + Math.hypot(...add(this.target, this.middle, -1)) + 6 * this.radius;
    this.matrix = multiply(perspective(VIEW_ANGLE, width / height, near, reach), lookAlong(this.eye, right, up, back));
  }

  // Place on the screen [px] and depth; null behind the eye.
  project(p) {
    const m = this.matrix;
    const w = m[3] * p[0] + m[7] * p[1] + m[11] * p[2] + m[15];
    if (w <= 0) return null;
    const x = (m[0] * p[0] + m[4] * p[1] + m[8] * p[2] + m[12]) / w;
    const y = (m[1] * p[0] + m[5] * p[1] + m[9] * p[2] + m[13]) / w;
    return [(0.5 + 0.5 * x) * this.width, (0.5 - 0.5 * y) * this.height, w];
  }
}

function listenToPointer(canvas, orbit, onHover, onClick, onCenter) {
  const pointers = new Map();
  let moved = 0;
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return { x: 0.5 * (a[0] + b[0]), y: 0.5 * (a[1] + b[1]), d: Math.hypot(a[0] - b[0], a[1] - b[1]) || 1 };
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    moved = pointers.size > 1 ? 99 : 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return onHover(event.offsetX, event.offsetY);
    const dx = event.offsetX - before[0], dy = event.offsetY - before[1];
    moved += Math.abs(dx) + Math.abs(dy);
    const old = pointers.size === 2 ? spread() : null;
    pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    if (old) {
      const now = spread();
      orbit.move(now.x - old.x, now.y - old.y);
      orbit.zoom(old.d / now.d);
    } else if (event.buttons & 2 || event.shiftKey || event.buttons & 4) orbit.move(dx, dy);
    else orbit.turn(dx, dy);
  });
  const release = (event) => {
    const wasDown = pointers.delete(event.pointerId);
    if (wasDown && event.type === "pointerup" && moved < 5) onClick(event.offsetX, event.offsetY);
  };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("pointerleave", () => onHover(-1e4, -1e4));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", (event) => onCenter(event.offsetX, event.offsetY));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    orbit.zoom(Math.exp(Math.max(-60, Math.min(60, event.deltaY * (event.deltaMode ? 30 : 1))) * 0.002));
  }, { passive: false });
  const keys = {
    ArrowLeft: () => orbit.turn(20, 0), ArrowRight: () => orbit.turn(-20, 0), ArrowUp: () => orbit.turn(0, 20),
    ArrowDown: () => orbit.turn(0, -20), "+": () => orbit.zoom(0.9), "-": () => orbit.zoom(1.1), Home: () => orbit.home(),
  };
  canvas.addEventListener("keydown", (event) => {
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  });
}
