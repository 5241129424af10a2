// Blocks of numbers as pdcd/pages/report/packing.py made them.

async function bytesOf(text) {
  const raw = atob(text);
  const packed = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) packed[i] = raw.charCodeAt(i);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

const sizeOf = (shape) => shape.reduce((a, b) => a * b, 1);

const unpackers = {
  async linear(block) {
    const data = await bytesOf(block.data);
    const count = sizeOf(block.shape), width = block.shape.at(-1);
    const out = new Float32Array(count);
    let before = 0;
    for (let i = 0; i < count; i++) {
      if (i % width === 0) before = 0;
      const folded = data[i] | (data[count + i] << 8);
      before = ((before + ((folded >>> 1) ^ -(folded & 1))) << 16) >> 16;
      out[i] = before === -32768 ? NaN : before * block.step;
    }
    return out;
  },
  async logarithmic(block) {
    const logs = await unpackers.linear(block);
    return logs.map((log) => (Number.isNaN(log) ? Infinity : Math.exp(log)));
  },
  async factored(block) {
    const data = await bytesOf(block.data);
    const low = new Float32Array((await bytesOf(block.low)).buffer);
    const step = new Float32Array((await bytesOf(block.step)).buffer);
    const [rows, columns] = block.shape;
    const out = new Float32Array(rows * columns);
    for (let r = 0; r < rows; r++) {
      for (let n = r * columns, end = n + columns; n < end; n++) out[n] = low[r] + step[r] * data[n];
    }
    return out;
  },
  async singles(block) {
    return new Float32Array((await bytesOf(block.data)).buffer);
  },
  async integers(block) {
    const out = new Int32Array((await bytesOf(block.data)).buffer);
    const width = block.shape.at(-1) || 1;
    for (let i = 0; i < out.length; i++) if (i % width) out[i] += out[i - 1];
    return out;
  },
};

const unpacked = new WeakMap();

// Each block is unpacked once, when it is first looked at.
function unpack(block) {
  if (!unpacked.has(block)) unpacked.set(block, unpackers[block.kind](block));
  return unpacked.get(block);
}
