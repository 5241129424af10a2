// Two pictures with a line between them, the values under the pointer, scales and histograms.

const CHANNELS = ["R", "G", "B"];
const INKS = ["#d55e00", "#009e73", "#4a7fe0"]; // told apart without red and green
const FEW_PX = 400;

// What can be shown: every picture, its sigma, and of the answer the truth and what is off.
function viewsOf(data) {
  const [width, height] = data.size, pixels = width * height, views = [];
  const full = (small, shape) => {
    const [planes, rows, columns] = shape;
    if (rows === height && columns === width) return small;
    const out = new Float32Array(planes * pixels);
    for (let c = 0, i = 0; c < planes; c++) for (let y = 0; y < height; y++) {
      const line = (c * rows + Math.min(y >> 1, rows - 1)) * columns;
      for (let x = 0; x < width; x++) out[i++] = small[line + Math.min(x >> 1, columns - 1)];
    }
    return out;
  };
  for (const one of data.pictures) {
    const id = one.kind === "truth" ? `${one.name}: truth` : one.name;
    const values = () => unpack(one.values);
    const sigma = one.sigma ? async () => full(await unpack(one.sigma), one.sigma.shape) : null;
    views.push({ id, kind: "light", values, sigma, factor: one.factor, negative: one.signed, step: one.values.step });
    if (one.sigma) views.push({ id: `${one.name}: sigma`, kind: "sigma", values: sigma, off: one.sigma.off });
    if (one.kind !== "truth") continue;
    const shown = data.pictures.find((p) => p.name === one.name && p.kind === "picture");
    const between = async (make) => {
      const found = await unpack(shown.values), truth = await unpack(one.values);
      const errors = full(await unpack(shown.sigma), shown.sigma.shape);
      return found.map((v, i) => make(v - truth[i], errors[i]));
    };
    views.push({
      id: `${one.name}: error`, kind: "signed", unit: "scene units, picture - truth",
      values: () => between((off) => off), step: shown.values.step + one.values.step,
    });
    views.push({
      id: `${one.name}: error / sigma`, kind: "signed", unit: "sigmas, picture - truth", most: 4,
      values: () => between((off, error) => (Number.isFinite(error) && error > 0 ? off / error : NaN)),
    });
  }
  return views;
}

// The channels of a picture: three, or one of a camera without colours.
function planesOf(values, pixels) {
  return Array.from({ length: values.length / pixels }, (_, c) => values.subarray(c * pixels, (c + 1) * pixels));
}

// Mean of the channels of each pixel.
function greyOf(values, pixels) {
  const grey = new Float32Array(pixels), planes = planesOf(values, pixels);
  for (let i = 0; i < pixels; i++) {
    let sum = 0;
    for (const plane of planes) sum += plane[i];
    grey[i] = sum / planes.length;
  }
  return grey;
}

function pictureViewer(data, onCell) {
  const [width, height] = data.size, pixels = width * height;
  const views = viewsOf(data), byId = new Map(views.map((v) => [v.id, v]));
  const sides = ["left", "right"].map((name) => ({
    name, select: $(name), canvas: $(`${name}-canvas`), label: $(`${name}-name`),
    told: $(`${name}-told`), legend: $(`${name}-legend`), plot: $(`${name}-histogram`),
  }));
  const stage = $("stage");
  stage.style.aspectRatio = `${width} / ${height}`;
  stage.style.maxWidth = `calc(75vh * ${width / height})`;
  for (const side of sides) {
    side.canvas.width = width;
    side.canvas.height = height;
    side.canvas.classList.toggle("crisp", width < FEW_PX);
    for (const view of views) side.select.add(new Option(view.id, view.id));
  }

  const stops = () => Number($("stops").value);
  const factorOf = (side) => ($("together").checked ? Math.min(...sides.map((s) => s.view.factor || Infinity)) : side.view.factor);

  // What value is shown as the brightest, or as the end of the colours.
  function topOf(side) {
    const gain = Math.pow(2, stops()), view = side.view;
    if (view.kind === "light") return 1 / (data.scale * factorOf(side) * gain);
    if (view.most) return view.most / gain;
    if (view.kind === "sigma") return (percentile(side.grey, 0.995) || 1) / gain;
    return (percentile(side.grey.map(Math.abs), 0.995) || 1) / gain;
  }

  function paint(side) {
    const context = side.canvas.getContext("2d"), image = context.createImageData(width, height);
    const out = image.data, { values, grey, view } = side, top = topOf(side);
    side.top = top;
    const planes = planesOf(values, pixels), many = planes.length;
    for (let i = 0, o = 0; i < pixels; i++, o += 4) {
      out[o + 3] = 255;
      if (!Number.isFinite(grey[i])) {
        const line = (i % width + Math.floor(i / width)) % 8 < 2 ? 62 : 44;
        out[o] = out[o + 1] = out[o + 2] = line;
      } else if (view.kind === "light") {
        for (let c = 0; c < 3; c++) {
          const linear = planes[c % many][i] / top * data.balance[c % many];
          const shown = GAMMA[Math.min(Math.round(Math.abs(linear) * 4095), 4095)];
          // Around a middle grey where there is light below 0 to be seen, as previews are.
          out[o + c] = view.negative ? (linear < 0 ? 127 - (shown >> 1) : 128 + (shown >> 1)) : linear < 0 ? 0 : shown;
        }
      } else {
        const at = view.kind === "sigma" ? grey[i] / top : 0.5 + 0.5 * grey[i] / top;
        const k = 3 * clamp(Math.round(255 * at), 0, 255), table = RAMPS[view.kind];
        out[o] = table[k]; out[o + 1] = table[k + 1]; out[o + 2] = table[k + 2];
      }
    }
    context.putImageData(image, 0, 0);
  }

  function describe(side) {
    const { view, top } = side;
    const factor = view.kind === "light" ? factorOf(side) * Math.pow(2, stops()) : null;
    const shown = factor === null ? "" : ` \u00d7 ${factor >= 1 ? written(factor) : `1/${written(1 / factor)}`}`;
    side.label.textContent = view.id + shown;
    const unit = view.unit || "scene units";
    let words = `${view.id}${shown}`;
    if (view.step) words += `, rounded to \u00b1${written(view.step / 2)} scene units`;
    if (view.negative) words += "; middle grey is 0";
    if (view.off) words += `, rounded to \u00b1${written(100 * view.off)} %`;
    side.told.textContent = words;
    legend(side.legend, view, top, unit);
    histogram(side.plot, side, unit);
  }

  function legend(canvas, view, top, unit) {
    const [context, wide] = sharp(canvas), low = view.kind === "signed" || view.negative ? -top : 0;
    const table = view.kind !== "light" ? RAMPS[view.kind] : view.negative ? RAMPS.around : RAMPS.grey;
    for (let x = 0; x < wide; x++) {
      const k = 3 * Math.round((255 * x) / Math.max(wide - 1, 1));
      context.fillStyle = `rgb(${table[k]} ${table[k + 1]} ${table[k + 2]})`;
      context.fillRect(x, 0, 1, 14);
    }
    context.fillStyle = colour("--quiet");
    const marks = ticks(low, top, wide / 70);
    context.textAlign = "center";
    marks.forEach((mark, number) => {
      const text = written(mark) + (number === marks.length - 1 ? ` ${unit.split(",")[0]}` : "");
      const half = 0.5 * context.measureText(text).width, at = (wide * (mark - low)) / (top - low || 1);
      context.fillRect(clamp(at, 0, wide - 1), 12, 1, 4);
      context.fillText(text, clamp(at, half, wide - half), 27);
    });
  }

  function histogram(canvas, side, unit) {
    const [context, wide, high] = sharp(canvas), { view, values, grey, top } = side;
    const light = view.kind === "light", bins = 120;
    const planes = light ? planesOf(values, pixels) : [grey];
    let low = Math.min(...planes.map((p) => percentile(p, 0.0005)));
    let end = Math.max(...planes.map((p) => percentile(p, 0.9995)));
    if (!(end > low)) { low -= 0.5 * Math.abs(low) || 0.5; end += 0.5 * Math.abs(end) || 0.5; }
    const counts = planes.map((plane) => {
      const found = new Float64Array(bins);
      for (const v of plane) {
        if (Number.isFinite(v)) found[clamp(Math.floor((bins * (v - low)) / (end - low)), 0, bins - 1)]++;
      }
      return found;
    });
    const most = Math.log10(Math.max(...counts.map((c) => Math.max(...c)), 9) + 1);
    const decades = Array.from({ length: Math.floor(most) + 1 }, (_, k) => k);
    const at = axes(context, wide, high, { low, high: end, name: unit },
      { low: 0, high: most, name: "pixels", ticks: decades, write: (k) => (k ? `1e${k}` : "1") });
    counts.forEach((found, c) => {
      context.strokeStyle = planes.length > 1 ? INKS[c] : colour("--accent");
      context.beginPath();
      found.forEach((count, b) => {
        const y = at.down(Math.log10(count + 1));
        context.lineTo(at.across(low + (b / bins) * (end - low)), y);
        context.lineTo(at.across(low + ((b + 1) / bins) * (end - low)), y);
      });
      context.stroke();
    });
    for (const mark of view.kind === "signed" || view.negative ? [-top, top] : [top]) {
      if (mark < low || mark > end) continue;
      context.strokeStyle = colour("--ink");
      context.setLineDash([4, 3]);
      context.beginPath(); context.moveTo(at.across(mark), at.top); context.lineTo(at.across(mark), at.bottom); context.stroke();
      context.setLineDash([]);
    }
    if (planes.length > 1) {
      context.fillStyle = colour("--box");
      context.fillRect(at.right - 44, at.top + 2, 42, 15);
      context.textAlign = "center";
      INKS.forEach((ink, c) => {
        context.fillStyle = ink;
        context.fillText("RGB"[c], at.right - 36 + 13 * c, at.top + 14);
      });
    }
  }

  async function load(side) {
    side.view = byId.get(side.select.value);
    side.values = await side.view.values();
    side.sigma = side.view.sigma ? await side.view.sigma() : null;
    side.grey = greyOf(side.values, pixels);
  }

  function show() {
    for (const side of sides) { paint(side); describe(side); }
    $("stops-told").textContent = `${stops() > 0 ? "+" : ""}${stops()} stops`;
    document.body.dataset.shown = `${sides[0].view.id} | ${sides[1].view.id}`;
  }

  function divide() {
    const share = Number($("divide").value);
    sides[1].canvas.style.clipPath = `inset(0 0 0 ${share}%)`;
    $("line").style.left = `${share}%`;
  }

  // Values at a pixel: what the read-out says, as numbers.
  function valuesAt(x, y) {
    const at = y * width + x, pick = (p) => (p ? planesOf(p, pixels).map((plane) => plane[at]) : null);
    return {
      x, y, cell: [Math.floor(((y + 0.5) / height) * data.grid[0]), Math.floor(((x + 0.5) / width) * data.grid[1])],
      sides: sides.map((side) => ({ id: side.view.id, value: pick(side.values), sigma: pick(side.sigma) })),
    };
  }

  function readOut(event) {
    const box = stage.getBoundingClientRect();
    const x = clamp(Math.floor(((event.clientX - box.left) / box.width) * width), 0, width - 1);
    const y = clamp(Math.floor(((event.clientY - box.top) / box.height) * height), 0, height - 1);
    const found = valuesAt(x, y), [row, column] = found.cell;
    const lines = [`x ${x}  y ${y}  cell ${row} ${column}`];
    found.sides.forEach((side, number) => {
      const unit = (sides[number].view.unit || "scene units").split(",")[0];
      const parts = side.value.map((value, c) => {
        const error = side.sigma ? ` \u00b1 ${written(side.sigma[c])}` : "";
        return `${side.value.length > 1 ? `${CHANNELS[c]} ` : ""}${written(value)}${error}`;
      });
      lines.push(`${side.id}: ${parts.join("   ")}  ${unit}`);
    });
    $("readout").textContent = lines.join("\n");
    return found;
  }

  for (const side of sides) {
    side.select.addEventListener("change", () => load(side).then(show).catch(fault));
  }
  $("stops").addEventListener("input", show);
  $("together").addEventListener("change", show);
  $("divide").addEventListener("input", divide);
  stage.addEventListener("pointermove", readOut);
  stage.addEventListener("click", (event) => {
    if (event.target !== $("line")) onCell(readOut(event).cell);
  });
  $("line").addEventListener("pointerdown", (event) => {
    $("line").setPointerCapture(event.pointerId);
    event.preventDefault();
  });
  $("line").addEventListener("pointermove", (event) => {
    if (!$("line").hasPointerCapture(event.pointerId)) return;
    const box = stage.getBoundingClientRect();
    $("divide").value = clamp((100 * (event.clientX - box.left)) / box.width, 0, 100);
    divide();
  });

  async function start() {
    const others = data.pictures.filter((p) => p.kind === "picture" && p.name !== data.answer);
    const other = others.find((p) => p.name === "white") || others[0];
    sides[0].select.value = other ? other.name : data.answer;
    sides[1].select.value = data.answer;
    if (!other) {
      const truth = views.find((v) => v.id === `${data.answer}: truth`);
      sides[0].select.value = (truth || views[Math.min(1, views.length - 1)]).id;
    }
    divide();
    await Promise.all(sides.map(load));
    show();
  }
  return { start, redraw: () => sides.forEach(describe), valuesAt };
}
