// Three things that WebGL 2 draws, all as instances: voxels, thick line segments, round marks.
const VOXEL_SHADER = `#version 300 es
in vec3 corner; in vec3 cell; in vec3 normal; in vec2 value; in float seen;
uniform mat4 matrix; uniform vec3 eye, first; uniform float size, grown, cut, least, until;
uniform int mode; uniform vec2 range; uniform sampler2D colors;
out vec3 color; out vec3 local;
void main() {
  vec3 center = (cell + first + 0.5) * size;
  if (center.z > cut || value.y < least || seen > until) { gl_Position = vec4(0.0, 0.0, 2.0, 1.0); return; }
  vec3 side = mix(vec3(-1.0), vec3(1.0), greaterThanEqual(eye, center)); // the three faces that are seen
  local = corner;
  gl_Position = matrix * vec4(center + 0.5 * grown * corner * side, 1.0);
  float shown = mode == 0 ? center.z : mode == 1 ? value.x : value.y;
  float share = clamp((shown - range.x) / (range.y - range.x), 0.0, 1.0);
  vec3 view = normalize(eye - center), n = normalize(normal + 1e-4);
  n *= dot(n, view) < 0.0 ? -1.0 : 1.0;
  float light = 0.55 + 0.38 * max(dot(n, vec3(0.35, 0.25, 0.9)), 0.0) + 0.22 * dot(n, view);
  color = texture(colors, vec2(share * 255.0 / 256.0 + 0.5 / 256.0, 0.5)).rgb * light;
}`;
const VOXEL_PIXEL = `#version 300 es
precision highp float;
in vec3 color; in vec3 local; out vec4 pixel;
void main() { // faces differ a little, so that a voxel is seen as a cube from near
  vec3 a = abs(local);
  float face = a.z >= a.x && a.z >= a.y ? 1.0 : a.x >= a.y ? 0.94 : 0.88;
  pixel = vec4(color * face, 1.0);
}`;
const LINE_SHADER = `#version 300 es
in vec2 corner; in vec3 a; in vec3 b; in vec4 tint; in float width;
uniform mat4 matrix; uniform vec2 screen; uniform float fade, ratio;
out vec4 color;
void main() {
  vec4 p = matrix * vec4(a, 1.0), q = matrix * vec4(b, 1.0);
  const float near = 1e-3;
  if (p.w < near && q.w < near) { gl_Position = vec4(0.0, 0.0, 2.0, 1.0); return; }
  if (p.w < near) p = mix(p, q, (near - p.w) / (q.w - p.w));
  if (q.w < near) q = mix(q, p, (near - q.w) / (p.w - q.w));
  vec2 along = (q.xy / q.w - p.xy / p.w) * screen;
  along = length(along) > 1e-4 ? normalize(along) : vec2(1.0, 0.0);
  vec2 offset = 0.5 * width * ratio * (corner.y * vec2(-along.y, along.x) + (2.0 * corner.x - 1.0) * along * 0.5);
  gl_Position = corner.x < 0.5 ? p : q;
  gl_Position.xy += 2.0 * offset / screen * gl_Position.w;
  gl_Position.z -= 2e-4 * gl_Position.w;
  color = vec4(tint.rgb, tint.a * fade);
}`;
const LINE_PIXEL = `#version 300 es
precision highp float;
in vec4 color; out vec4 pixel;
void main() { pixel = vec4(color.rgb * color.a, color.a); }`;
const MARK_SHADER = `#version 300 es
in vec2 corner; in vec3 a; in vec4 tint; in float width;
uniform mat4 matrix; uniform vec2 screen; uniform float fade, ratio;
out vec4 color; out vec2 local; out float radius;
void main() {
  radius = 0.5 * width * ratio;
  local = corner * (radius + 1.0);
  color = vec4(tint.rgb, tint.a * fade);
  gl_Position = matrix * vec4(a, 1.0);
  gl_Position.xy += 2.0 * local / screen * gl_Position.w;
  gl_Position.z -= 2e-4 * gl_Position.w;
}`;
const MARK_PIXEL = `#version 300 es
precision highp float;
in vec4 color; in vec2 local; in float radius; out vec4 pixel;
void main() {
  float d = length(local), alpha = color.a * clamp(radius - d + 0.5, 0.0, 1.0);
  if (alpha < 0.01) discard;
  float rim = radius > 3.0 ? clamp(d - radius + 2.0, 0.0, 1.0) : 0.0;
  pixel = vec4(mix(color.rgb, vec3(0.08), 0.75 * rim) * alpha, alpha);
}`;
// The seven corners of the three faces of a cube that its nearest corner shares, as triangles.
const CUBE_CORNERS = [1, 1, 1, 1, -1, 1, 1, -1, -1, 1, 1, -1, -1, 1, -1, -1, 1, 1, -1, -1, 1];
const CUBE_TRIANGLES = [0, 1, 2, 0, 2, 3, 0, 3, 4, 0, 4, 5, 0, 5, 6, 0, 6, 1];

// The numbers below n in an order that is the same each time, any part of it spread evenly.
function shuffled(n) {
  const order = Uint32Array.from({ length: n }, (_, i) => i);
  let state = 12345;
  for (let i = n - 1; i > 0; i--) {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    const j = Math.floor((state / 2 ** 32) * (i + 1));
    [order[i], order[j]] = [order[j], order[i]];
  }
  return order;
}

class Program {
  constructor(gl, vertex, fragment) {
    this.gl = gl;
    this.program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
    }
    gl.linkProgram(this.program);
    if (!gl.getProgramParameter(this.program, gl.LINK_STATUS)) {
      throw new Error(`shader: ${gl.getProgramInfoLog(this.program)}`);
    }
  }

  // fields: {name: [data or null, size, type, normalized, once per instance]}
  arrays(fields, triangles) {
    const { gl } = this, vao = gl.createVertexArray();
    gl.bindVertexArray(vao);
    for (const [name, [data, size, type, normalized, perInstance]] of Object.entries(fields)) {
      const place = gl.getAttribLocation(this.program, name);
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, type, normalized, 0, 0);
      gl.vertexAttribDivisor(place, perInstance ? 1 : 0);
    }
    if (triangles) {
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint8Array(triangles), gl.STATIC_DRAW);
    }
    gl.bindVertexArray(null);
    return vao;
  }

  use(values) {
    const { gl } = this;
    gl.useProgram(this.program);
    for (const [name, value] of Object.entries(values)) {
      const place = gl.getUniformLocation(this.program, name);
      if (name === "matrix") gl.uniformMatrix4fv(place, false, value);
      else if (name === "mode" || name === "colors") gl.uniform1i(place, value);
      else if (typeof value === "number") gl.uniform1f(place, value);
      else gl[`uniform${value.length}fv`](place, value);
    }
  }
}

class Painter {
  constructor(canvas, arrays) {
    const options = { antialias: true, preserveDrawingBuffer: true, alpha: false };
    const gl = canvas.getContext("webgl2", options);
    if (!gl) throw new Error("WebGL 2 is not available");
    this.gl = gl;
    this.voxels = new Program(gl, VOXEL_SHADER, VOXEL_PIXEL);
    this.lines = new Program(gl, LINE_SHADER, LINE_PIXEL);
    this.marks = new Program(gl, MARK_SHADER, MARK_PIXEL);
    this.textures = {};
    for (const name of Object.values(manifest.colorMaps)) this.textures[name] = this.texture(arrays[`map_${name}`]);
    this.count = arrays.cells.length / 3;
    const order = shuffled(this.count);
    const values = new Uint8Array(2 * this.count), cells = new Uint16Array(3 * this.count), normals = new Int8Array(3 * this.count);
    const seen = new Uint16Array(this.count);
    order.forEach((from, to) => {
      seen[to] = arrays.seen[from];
      values[2 * to] = arrays.sigmas[from];
      values[2 * to + 1] = arrays.evidence[from];
      for (let k = 0; k < 3; k++) {
        cells[3 * to + k] = arrays.cells[3 * from + k];
        normals[3 * to + k] = arrays.normals[3 * from + k];
      }
    });
    this.surface = this.voxels.arrays({
      corner: [new Float32Array(CUBE_CORNERS), 3, gl.FLOAT, false, false],
      cell: [cells, 3, gl.UNSIGNED_SHORT, false, true],
      normal: [normals, 3, gl.BYTE, true, true],
      value: [values, 2, gl.UNSIGNED_BYTE, true, true],
      seen: [seen, 1, gl.UNSIGNED_SHORT, false, true],
    }, CUBE_TRIANGLES);
  }

  texture(colors) {
    const { gl } = this, texture = gl.createTexture();
    const texels = new Uint8Array(256 * 4).fill(255);
    for (let i = 0; i < 256; i++) texels.set(colors.subarray(3 * i, 3 * i + 3), 4 * i);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, texels);
    for (const key of ["MIN_FILTER", "MAG_FILTER"]) gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${key}`], gl.NEAREST);
    for (const key of ["WRAP_S", "WRAP_T"]) gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${key}`], gl.CLAMP_TO_EDGE);
    return texture;
  }

  // items: [{a, b, tint: [r, g, b, alpha] from 0 to 1, width [px]}]; without b they are marks.
  group(items, program) {
    const { gl } = this;
    const flat = (pick) => new Float32Array(items.flatMap(pick));
    const fields = {
      corner: [new Float32Array(program === this.lines ? [0, -1, 1, -1, 0, 1, 1, 1] : [-1, -1, 1, -1, -1, 1, 1, 1]), 2, gl.FLOAT, false, false],
      a: [flat((item) => item.a), 3, gl.FLOAT, false, true],
      tint: [flat((item) => item.tint), 4, gl.FLOAT, false, true],
      width: [flat((item) => [item.width]), 1, gl.FLOAT, false, true],
    };
    if (program === this.lines) fields.b = [flat((item) => item.b), 3, gl.FLOAT, false, true];
    return { program, count: items.length, vao: program.arrays(fields) };
  }

  begin(background, width, height) {
    const { gl } = this;
    gl.viewport(0, 0, width, height);
    gl.clearColor(...background);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  // Calls back when what was asked for has been drawn.
  whenDone(callback) {
    const { gl } = this, fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    const look = () => {
      if (gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED) return setTimeout(look, 4);
      gl.deleteSync(fence);
      callback();
    };
    setTimeout(look, 0);
  }

  // A share of the voxels, drawn larger to close the gaps, is enough while the map turns.
  drawSurface(values, colors, share) {
    const { gl } = this;
    this.voxels.use({ ...values, colors: 0, grown: values.size / Math.sqrt(share) });
    gl.bindTexture(gl.TEXTURE_2D, this.textures[colors]);
    gl.bindVertexArray(this.surface);
    gl.drawElementsInstanced(gl.TRIANGLES, CUBE_TRIANGLES.length, gl.UNSIGNED_BYTE, 0, Math.ceil(share * this.count));
  }

  // Twice: faint where the map hides it, then what is in sight.
  drawGroup(group, values, hidden) {
    if (!group || !group.count) return;
    const { gl } = this;
    gl.bindVertexArray(group.vao);
    gl.depthMask(false);
    for (const [test, fade] of [[gl.ALWAYS, hidden], [gl.LEQUAL, 1]]) {
      if (fade === 0) continue;
      gl.depthFunc(test);
      group.program.use({ ...values, fade });
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, group.count);
    }
    gl.depthFunc(gl.LEQUAL);
    gl.depthMask(true);
  }
}
