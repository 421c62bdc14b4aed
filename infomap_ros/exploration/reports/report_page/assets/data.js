// The page's data: one JSON object, and arrays in one block that is compressed with zlib.
const ARRAY_TYPES = { f4: Float32Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, i1: Int8Array };

const manifest = JSON.parse(byId("manifest").textContent);
const steps = manifest.steps || [];

async function readArrays() {
  const packed = Uint8Array.from(atob(byId("arrays").textContent.trim()), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  const arrays = {};
  for (const [name, place] of Object.entries(manifest.arrays)) {
    arrays[name] = new ARRAY_TYPES[place.type](buffer, place.offset, place.count);
  }
  return arrays;
}

const PREFIXES = [[1e9, "G"], [1e6, "M"], [1e3, "k"], [1, ""], [1e-3, "m"], [1e-6, "µ"]];

function number(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const places = Math.max(0, digits - 1 - Math.floor(Math.log10(Math.abs(value))));
  const text = value.toFixed(Math.min(places, 9));
  return (text.includes(".") ? text.replace(/\.?0+$/, "") : text).replace("-", "−");
}

function quantity(value, unit, digits = 3) {
  if (!value) return `${number(value)} ${unit}`;
  const [factor, prefix] = PREFIXES.find(([f]) => Math.abs(value) >= 0.9995 * f) || PREFIXES.at(-1);
  return `${number(value / factor, digits)} ${prefix}${unit}`;
}

function duration(seconds) {
  const whole = Math.round(seconds);
  if (whole < 60) return `${whole} s`;
  const pad = (n) => String(n).padStart(2, "0");
  if (whole < 3600) return `${Math.floor(whole / 60)} min ${pad(whole % 60)} s`;
  return `${Math.floor(whole / 3600)} h ${pad(Math.floor((whole % 3600) / 60))} min`;
}

const words = (name) => name.replaceAll("_", " ");
const probability = (logOdds) => 1 / (1 + Math.exp(-logOdds));

function roundTicks(low, high, wanted) {
  const rough = (high - low) / wanted;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((f) => f * power).find((s) => s >= rough * 0.999);
  const ticks = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) ticks.push(i * step);
  return ticks;
}
