// The row of the probing matrix that belongs to a cell, out of its factors: wanted and realised.

// A part of the wanted matrix: its row n, (N,).
const PARTS = {
  uniform: async (part, n, grid) => new Float32Array(grid[0] * grid[1]).fill(1),
  outer: async (part, n) => {
    const gain = (await unpack(part.camera))[n];
    return (await unpack(part.projector)).map((light) => gain * light);
  },
  match: async (part, n, grid) => {
    const row = new Float32Array(grid[0] * grid[1]), partner = (await unpack(part.partner))[n];
    if (partner >= 0) row[partner] = 1;
    return row;
  },
  near: async (part, n, grid) => byShift(n, grid, (down, right) => (Math.max(Math.abs(down), Math.abs(right)) <= part.radius ? 1 : 0)),
  "same row": async (part, n, grid) => byShift(n, grid, (down) => (down === 0 ? 1 : 0)),
  kernel: async (part, n, grid) => {
    const [high, wide] = part.taps.shape, taps = await unpack(part.taps);
    return byShift(n, grid, (down, right) => {
      const r = (high - 1) / 2 - down, c = (wide - 1) / 2 - right;
      return r >= 0 && r < high && c >= 0 && c < wide ? taps[r * wide + c] : 0;
    });
  },
  gained: async (part, n, grid) => {
    const gain = (await unpack(part.camera))[n];
    return (await PARTS[part.part.kind](part.part, n, grid)).map((weight) => gain * weight);
  },
  lit: async (part, n, grid) => {
    const light = await unpack(part.projector);
    return (await PARTS[part.part.kind](part.part, n, grid)).map((weight, m) => weight * light[m]);
  },
};

// Weights by how far a projector cell m lies from camera cell n: m - n, down and right.
function byShift(n, [rows, columns], weight) {
  const row = new Float32Array(rows * columns), r = Math.floor(n / columns), c = n % columns;
  for (let m = 0; m < row.length; m++) row[m] = weight(Math.floor(m / columns) - r, (m % columns) - c);
  return row;
}

async function wantedRow(photo, n, grid) {
  if (!photo.wanted) return null;
  const total = new Float32Array(grid[0] * grid[1]);
  for (const part of photo.wanted) {
    const row = await PARTS[part.kind](part, n, grid);
    for (let m = 0; m < total.length; m++) total[m] += part.weight * row[m];
  }
  if (photo.light) {
    const light = await unpack(photo.light);
    for (let m = 0; m < total.length; m++) total[m] *= light[m];
  }
  return total;
}

async function realisedRow(photo, n) {
  const [left, right] = await Promise.all([unpack(photo.left), unpack(photo.right)]);
  const coaxial = await unpack(photo.coaxial), weights = await unpack(photo.weight);
  const cells = coaxial.length, total = new Float64Array(cells);
  for (let r = 0; r < photo.left.shape[0]; r++) {
    const open = left[r * cells + n];
    if (open) for (let m = 0, at = r * cells; m < cells; m++, at++) total[m] += open * right[at];
  }
  total[n] = coaxial[n];
  const weight = weights.length > 1 ? weights[n] : weights[0];
  return total.map((value) => value / weight);
}

const figuresOf = (row) => {
  let least = Infinity, most = -Infinity, sum = 0;
  for (const v of row) { least = Math.min(least, v); most = Math.max(most, v); sum += v; }
  return { least, mean: sum / row.length, most };
};

function matrixViewer(data) {
  const [rows, columns] = data.grid;
  const photos = new Map(data.photos.map((photo) => [photo.name, photo]));
  let shown = null, asked = 0;
  for (const name of photos.keys()) $("photo").add(new Option(name, name));
  $("cell-row").max = rows - 1;
  $("cell-column").max = columns - 1;

  function draw(canvas, row, low, high, table, n) {
    canvas.width = columns;
    canvas.height = rows;
    const context = canvas.getContext("2d"), image = context.createImageData(columns, rows);
    for (let m = 0; m < rows * columns; m++) {
      const k = 3 * clamp(Math.round((255 * (row[m] - low)) / (high - low || 1)), 0, 255);
      image.data.set([table[k], table[k + 1], table[k + 2], 255], 4 * m);
    }
    context.putImageData(image, 0, 0);
    canvas.setAttribute("aria-label", `weights of all paths to cell ${Math.floor(n / columns)} ${n % columns}`);
  }

  const told = (id, row) => {
    const f = figuresOf(row);
    $(id).textContent = `least ${written(f.least)}, mean ${written(f.mean)}, largest ${written(f.most)}`;
  };

  async function row(name, r, c) {
    const photo = photos.get(name), n = r * columns + c;
    if (!photo || photo.missing) return null;
    const [wanted, realised] = await Promise.all([wantedRow(photo, n, data.grid), realisedRow(photo, n)]);
    return { wanted: wanted && Array.from(wanted), realised: Array.from(realised), off: photo.off };
  }

  async function show() {
    const photo = photos.get($("photo").value), mine = ++asked;
    if (!photo) return;
    const r = clamp(Math.round(Number($("cell-row").value)) || 0, 0, rows - 1);
    const c = clamp(Math.round(Number($("cell-column").value)) || 0, 0, columns - 1);
    const found = await row(photo.name, r, c);
    if (mine !== asked) return;
    $("matrix-missing").hidden = !photo.missing;
    $("matrix-missing").textContent = photo.missing || "";
    $("matrix-figures").hidden = Boolean(photo.missing);
    shown = found && { ...found, r, c };
    if (!found) return;
    const n = r * columns + c, wanted = found.wanted || new Array(rows * columns).fill(NaN);
    const known = found.wanted ? [...found.wanted, ...found.realised] : found.realised;
    let high = 0, least = 0;
    for (const v of known) { high = Math.max(high, Math.abs(v)); least = Math.min(least, v); }
    const low = found.wanted && Math.min(...found.wanted) < 0 ? -high : 0;
    draw($("wanted"), wanted, low, high, RAMP_LINEAR, n);
    draw($("realised"), found.realised, low, high, RAMP_LINEAR, n);
    const apart = found.realised.map((v, m) => v - wanted[m]);
    let most = 0;
    for (const v of apart) most = Math.max(most, Math.abs(v) || 0);
    draw($("apart"), apart, -most, most, RAMPS.signed, n);
    if (found.wanted) { told("wanted-told", found.wanted); told("apart-told", apart); }
    else { $("wanted-told").textContent = "a matrix of numbers, too long for a page; see pdcd row"; $("apart-told").textContent = ""; }
    told("realised-told", found.realised);
    $("matrix-off").textContent =
      `Weight of the path from each projector cell to camera cell ${r} ${c}; the cell itself is what direct light sees. ` +
      `Black is ${written(low)}, white ${written(high)}; the third from ${written(-most)} (blue) to ${written(most)} (red). ` +
      `Rounded to \u00b1${written(found.off)}; pdcd row has all digits.`;
    $("matrix-readout").textContent = "";
    document.body.dataset.cell = `${photo.name} ${r} ${c}`;
  }

  for (const id of ["photo", "cell-row", "cell-column"]) {
    $(id).addEventListener("change", () => show().catch(fault));
  }
  for (const id of ["wanted", "realised", "apart"]) {
    $(id).addEventListener("pointermove", (event) => {
      if (!shown) return;
      const box = $(id).getBoundingClientRect();
      const c = clamp(Math.floor((columns * (event.clientX - box.left)) / box.width), 0, columns - 1);
      const r = clamp(Math.floor((rows * (event.clientY - box.top)) / box.height), 0, rows - 1);
      const m = r * columns + c, want = shown.wanted ? written(shown.wanted[m]) : "not known";
      $("matrix-readout").textContent = `from cell ${r} ${c} to cell ${shown.r} ${shown.c}: wanted ${want}, realised ${written(shown.realised[m])}`;
    });
  }

  function choose([r, c]) {
    $("cell-row").value = r;
    $("cell-column").value = c;
    return show();
  }
  return { choose, row, start: () => choose([Math.floor(rows / 2), Math.floor(columns / 2)]) };
}
