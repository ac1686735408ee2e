// What `invrender.output.live.packed` writes, read back: header and typed arrays.

const ARRAYS = { f16: Uint16Array, f32: Float32Array, u32: Uint32Array, u8: Uint8Array };

/** Header, and `arrays` as {data, shape, type} by name; half floats stay codes in Uint16Array. */
export async function unpacked(compressed) {
  const stream = new Blob([compressed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const buffer = await new Response(stream).arrayBuffer();
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const arrays = {};
  for (const [name, { type, shape, offset }] of Object.entries(header.arrays)) {
    const count = shape.reduce((a, b) => a * b, 1);
    arrays[name] = { data: new ARRAYS[type](buffer, 4 + length + offset, count), shape, type };
  }
  return { ...header, arrays };
}

/** Half-float codes as numbers. */
export function singles(halves) {
  const result = new Float32Array(halves.length);
  for (let k = 0; k < halves.length; k++) {
    const code = halves[k], exponent = (code >> 10) & 31, fraction = code & 1023;
    const size = exponent ? (1 + fraction / 1024) * 2 ** (exponent - 15) : fraction * 2 ** -24;
    result[k] = code & 0x8000 ? -size : size;
  }
  return result;
}
