// Drawing that pictures, matrices and the time line share.

const $ = (id) => document.getElementById(id);
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

// A number with so many digits that count.
function written(value, digits = 4) {
  if (value === null || Number.isNaN(value)) return "not known";
  if (!Number.isFinite(value)) return "not known";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e5 || size < 1e-4) return value.toExponential(digits - 2);
  return String(Number(value.toPrecision(digits)));
}

// A canvas as fine as the screen; the context counts in CSS pixels.
function sharp(canvas) {
  const box = canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  canvas.width = Math.max(1, Math.round(box.width * ratio));
  canvas.height = Math.max(1, Math.round(box.height * ratio));
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, box.width, box.height);
  context.font = '12px system-ui, "DejaVu Sans", sans-serif';
  return [context, box.width, box.height];
}

// About so many round numbers from low to high.
function ticks(low, high, count) {
  if (!(high > low)) return [low];
  const raw = (high - low) / count, power = Math.pow(10, Math.floor(Math.log10(raw)));
  const step = power * [1, 2, 5, 10].find((m) => m * power >= raw);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) {
    found.push(Number((k * step).toPrecision(12)));
  }
  return found;
}

// Axes of a plot; returns where a value lies.
function axes(context, width, height, x, y) {
  const left = 52, right = width - 10, top = 8, bottom = height - 32;
  const across = (v) => left + ((v - x.low) / (x.high - x.low || 1)) * (right - left);
  const down = (v) => bottom - ((v - y.low) / (y.high - y.low || 1)) * (bottom - top);
  context.strokeStyle = colour("--line");
  context.fillStyle = colour("--quiet");
  context.lineWidth = 1;
  context.strokeRect(left, top, right - left, bottom - top);
  context.textAlign = "center";
  for (const tick of ticks(x.low, x.high, Math.max(3, Math.floor((right - left) / 70)))) {
    context.fillText(written(tick), clamp(across(tick), left + 8, right - 8), bottom + 12);
    context.beginPath(); context.moveTo(across(tick), bottom); context.lineTo(across(tick), bottom + 3); context.stroke();
  }
  context.fillText(x.name, (left + right) / 2, height - 6);
  context.textAlign = "right";
  for (const tick of y.ticks || ticks(y.low, y.high, 3)) {
    context.fillText(y.write ? y.write(tick) : written(tick), left - 5, down(tick) + 4);
  }
  context.save();
  context.translate(10, (top + bottom) / 2);
  context.rotate(-Math.PI / 2);
  context.textAlign = "center";
  context.fillText(y.name, 0, 0);
  context.restore();
  return { across, down, left, right, top, bottom };
}

// Colours of 256 steps. What is shown as a number is told by the legend.
function ramp(stops) {
  const table = new Uint8ClampedArray(256 * 3);
  for (let i = 0; i < 256; i++) {
    const at = (i / 255) * (stops.length - 1), k = Math.min(Math.floor(at), stops.length - 2);
    for (let c = 0; c < 3; c++) table[3 * i + c] = stops[k][c] + (at - k) * (stops[k + 1][c] - stops[k][c]);
  }
  return table;
}
const RAMPS = {
  grey: null,
  sigma: ramp([[13, 8, 60], [106, 22, 130], [190, 55, 110], [243, 130, 60], [250, 210, 70], [252, 255, 200]]),
  signed: ramp([[20, 60, 140], [90, 150, 215], [232, 232, 228], [226, 130, 95], [150, 20, 35]]),
};
const GAMMA = new Uint8ClampedArray(4096);
for (let i = 0; i < 4096; i++) GAMMA[i] = Math.round(255 * Math.pow(i / 4095, 1 / 2.2));
RAMPS.grey = ramp([[0, 0, 0], [255, 255, 255]]);
for (let i = 0; i < 256; i++) RAMPS.grey.fill(GAMMA[Math.round((i / 255) * 4095)], 3 * i, 3 * i + 3);
RAMPS.around = new Uint8ClampedArray(256 * 3);
for (let i = 0; i < 256; i++) {
  const linear = i / 127.5 - 1, shown = GAMMA[Math.round(Math.abs(linear) * 4095)] >> 1;
  RAMPS.around.fill(linear < 0 ? 127 - shown : 128 + shown, 3 * i, 3 * i + 3);
}
const RAMP_LINEAR = ramp([[0, 0, 0], [255, 255, 255]]);

// The value that a share of all known ones stays below.
function percentile(values, share) {
  const step = Math.max(1, Math.floor(values.length / 60000)), some = [];
  for (let i = 0; i < values.length; i += step) if (Number.isFinite(values[i])) some.push(values[i]);
  if (!some.length) return 0;
  some.sort((a, b) => a - b);
  return some[Math.min(some.length - 1, Math.floor(share * some.length))];
}
