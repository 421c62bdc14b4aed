// The 3-D view: its state, what is drawn, and what lies under the pointer.
class Viewer {
  constructor(arrays) {
    this.arrays = arrays;
    this.scene = byId("scene");
    this.labels = byId("labels");
    this.painter = new Painter(this.scene, arrays);
    this.shown = { surface: true, axes: true, base: true, camera: true, views: true, candidates: true };
    this.mode = "height";
    this.step = -1;
    this.candidates = [];
    this.marked = []; // at most two voxels, between which is measured
    this.cut = manifest.cut === null ? Infinity : manifest.cut;
    this.least = manifest.least;
    this.share = 1; // of the voxels that is drawn while the map turns, as fast as this machine draws
    this.moving = this.busy = this.wanted = false;
    this.orbit = new Orbit(manifest.bounds, () => this.turned());
    this.size = Math.max(0.12, Math.min(0.6, 0.05 * this.orbit.radius));
    this.recolor();
    this.resize();
    this.orbit.home();
    new ResizeObserver(() => this.resize()).observe(this.scene);
  }

  recolor() {
    this.colors = themeColors();
    const { painter, colors } = this;
    this.groups = {
      axes: painter.group(axisItems(manifest.bounds, colors), painter.lines),
    };
    this.regroup();
  }

  regroup() {
    const { painter, colors, size } = this;
    const table = this.arrays[`map_${manifest.colorMaps.rating}`];
    const { marks, stubs } = candidateItems(this.candidates, size, colors, table);
    for (const who of ["base", "camera"]) {
      this.groups[who] = painter.group(pathItems(this.arrays, who, colors, this.until), painter.lines);
    }
    this.groups.views = painter.group(viewItems(this.step, size, colors), painter.lines);
    this.groups.candidates = painter.group(marks, painter.marks);
    this.groups.stubs = painter.group(stubs, painter.lines);
    paintLegend(this);
    this.redraw();
  }

  select(step) {
    this.step = step;
    this.candidates = candidatesOf(this.arrays, step);
    this.regroup();
  }

  // What a decision did not know yet is not drawn; all with the last one, or without a run.
  get until() {
    return this.step >= 0 && this.step < steps.length - 1 ? this.step : 65535;
  }

  range(mode) {
    if (mode === "height") return this.cut < Infinity ? manifest.heights : [0, 1].map((i) => manifest.focus[i][2]);
    if (mode === "probability") return [0, 1];
    const [a, b] = manifest.sigma.scale.map(Math.log);
    return manifest.sigma.shown.map((v) => (Math.log(v) - a) / (b - a));
  }

  // For paper, which shows no WebGL: from here on every frame puts the picture into the canvas with
  // the labels, also one that was asked for before.
  freeze() {
    this.frozen = true;
    this.recolor();
    this.draw();
  }

  resize() {
    if (this.frozen || matchMedia("print").matches) return; // paper gets the picture as it is
    const { clientWidth, clientHeight } = this.scene;
    this.ratio = Math.min(window.devicePixelRatio || 1, 2);
    for (const canvas of [this.scene, this.labels]) {
      canvas.width = Math.max(1, Math.round(clientWidth * this.ratio));
      canvas.height = Math.max(1, Math.round(clientHeight * this.ratio));
    }
    this.orbit.update(Math.max(clientWidth, 1), Math.max(clientHeight, 1));
    if (this.orbit.untouched) this.orbit.home();
    this.moving = false;
    this.redraw();
  }

  turned() {
    this.moving = true;
    this.redraw();
  }

  // One frame after the other: the next one begins when the last one is done.
  redraw() {
    this.wanted = true;
    this.scene.dataset.drawn = "part";
    if (this.busy) return;
    this.busy = true;
    requestAnimationFrame(() => {
      this.wanted = false;
      const share = this.moving ? this.share : 1, started = performance.now();
      this.draw(share);
      this.painter.whenDone(() => this.done(share, performance.now() - started));
    });
  }

  // Draw fewer voxels in the next frame when this one took long, more when it was quick; all of
  // them when the map has come to rest.
  done(share, taken) {
    this.busy = false;
    this.share = Math.max(0.05, Math.min(1, share * Math.max(0.02, Math.min(1.5, 35 / taken))));
    if (this.moving) {
      clearTimeout(this.rest);
      this.rest = setTimeout(() => { this.moving = false; this.redraw(); }, 200);
    }
    if (this.wanted) this.redraw();
    else if (!this.moving) this.scene.dataset.drawn = "whole";
  }

  draw(share = 1) {
    const { painter, orbit, scene, shown, groups } = this;
    orbit.update(orbit.width, orbit.height);
    painter.begin([...toRgb(this.colors.stage), 1], scene.width, scene.height);
    const { matrix, eye } = orbit;
    const mode = ["height", "sigma", "probability"].indexOf(this.mode);
    if (shown.surface) {
      const placed = { first: manifest.first, size: manifest.voxel, cut: Math.min(this.cut, 1e9), least: this.least - 0.002, until: this.until };
      painter.drawSurface({ matrix, eye, mode, range: this.range(this.mode), ...placed }, manifest.colorMaps[this.mode], share);
    }
    const values = { matrix, screen: [scene.width, scene.height], ratio: this.ratio };
    if (shown.axes) painter.drawGroup(groups.axes, values, 0);
    for (const name of ["base", "camera"]) if (shown[name]) painter.drawGroup(groups[name], values, 0.3);
    if (shown.views) painter.drawGroup(groups.views, values, 0.25);
    if (shown.candidates) {
      painter.drawGroup(groups.stubs, values, 0.15);
      painter.drawGroup(groups.candidates, values, 0.3);
    }
    paintLabels(this.labels, this, this.frozen ? this.scene : undefined);
  }

  // The view or candidate at a place on the screen, or null.
  pick(x, y) {
    let best = null, least = 13;
    const consider = (point, found, reach) => {
      const at = this.orbit.project(point);
      const d = at ? Math.hypot(at[0] - x, at[1] - y) - reach : Infinity;
      if (d < least) { least = d; best = found; }
    };
    if (this.shown.candidates) for (const candidate of this.candidates) consider(candidate.position, { candidate }, 0);
    if (this.shown.views) steps.forEach((step, n) => step.pose && consider(eyeOf(step), { step: n }, 4));
    return best;
  }

  // The voxel in sight at a place on the screen: its center, what is known of it, depth; or null.
  voxelAt(x, y) {
    const { cells, evidence, seen, sigmas } = this.arrays, [fx, fy, fz] = manifest.first;
    let best = null, least = Infinity;
    for (let i = 0; i < cells.length; i += 3) {
      if (evidence[i / 3] / 255 < this.least - 0.002 || seen[i / 3] > this.until) continue;
      const p = [cells[i] + fx + 0.5, cells[i + 1] + fy + 0.5, cells[i + 2] + fz + 0.5].map((v) => v * manifest.voxel);
      const at = p[2] <= this.cut ? this.orbit.project(p) : null;
      if (!at || Math.hypot(at[0] - x, at[1] - y) > 6 || at[2] > least) continue;
      least = at[2];
      best = { at: p, n: i / 3, depth: least };
    }
    if (!best) return null;
    const [a, b] = manifest.sigma.scale.map(Math.log), [c, d] = manifest.logOdds;
    const sigma = Math.exp(a + (sigmas[best.n] / 255) * (b - a));
    return { ...best, sigma, probability: probability(c + (evidence[best.n] / 255) * (d - c)) };
  }

  // Mark the voxel in sight; a third one begins anew.
  mark(x, y) {
    const found = this.voxelAt(x, y);
    if (!found) return;
    this.marked = this.marked.length === 1 ? [this.marked[0], found] : [found];
    showMarked(this.marked);
    this.redraw();
  }

  unmark() {
    this.marked = [];
    showMarked(this.marked);
    this.redraw();
  }

  // Turn about the voxel in sight at a place on the screen.
  center(x, y) {
    const found = this.voxelAt(x, y);
    if (!found) return;
    this.unmark(); // the two clicks before marked a voxel each
    this.orbit.target = found.at;
    this.orbit.distance = Math.min(this.orbit.distance, 0.6 * Math.max(found.depth, 0.2 * this.orbit.radius));
    this.redraw();
  }
}
