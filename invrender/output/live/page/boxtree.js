// A tree of boxes around triangles, laid out for rays that only ask whether anything is in their way.
//
// Nodes follow each other depth first: where a ray meets a node's box it goes on to the next one, else to the node's
// `miss`, so that no stack is needed.

const LEAF = 4, BINS = 16;

/** Nodes (8 numbers: low, miss, high, first triangle or -1 of an inner node) and triangles' corners in leaf order. */
export function boxTree(positions, faces) {
  const count = faces.length / 3;
  const centres = new Float32Array(3 * count), low = new Float32Array(3 * count), high = new Float32Array(3 * count);
  for (let f = 0; f < count; f++) {
    for (let k = 0; k < 3; k++) {
      const a = positions[3 * faces[3 * f] + k], b = positions[3 * faces[3 * f + 1] + k];
      const c = positions[3 * faces[3 * f + 2] + k];
      low[3 * f + k] = Math.min(a, b, c);
      high[3 * f + k] = Math.max(a, b, c);
      centres[3 * f + k] = (low[3 * f + k] + high[3 * f + k]) / 2;
    }
  }
  const order = new Uint32Array(count).map((_, f) => f), nodes = [];
  const build = (start, end) => {
    const node = nodes.length, box = [Infinity, Infinity, Infinity, -Infinity, -Infinity, -Infinity];
    const spread = [Infinity, Infinity, Infinity, -Infinity, -Infinity, -Infinity];
    for (let i = start; i < end; i++) {
      for (let k = 0; k < 3; k++) {
        const at = 3 * order[i] + k;
        box[k] = Math.min(box[k], low[at]);
        box[k + 3] = Math.max(box[k + 3], high[at]);
        spread[k] = Math.min(spread[k], centres[at]);
        spread[k + 3] = Math.max(spread[k + 3], centres[at]);
      }
    }
    const isLeaf = end - start <= LEAF;
    nodes.push([...box, 0, isLeaf ? start : -1, isLeaf ? end - start : 0]);
    if (!isLeaf) {
      const middle = divided(order.subarray(start, end), spread, centres, low, high);
      build(start, start + middle);
      build(start + middle, end);
    }
    nodes[node][6] = nodes.length;
  };
  build(0, count);
  const packed = new Float32Array(12 * nodes.length), corners = new Float32Array(12 * count);
  nodes.forEach(([x, y, z, X, Y, Z, miss, first, size], n) => packed.set([x, y, z, miss, X, Y, Z, first, size, 0, 0, 0], 12 * n));
  order.forEach((f, i) => {
    for (let c = 0; c < 3; c++) {
      for (let k = 0; k < 3; k++) corners[12 * i + 4 * c + k] = positions[3 * faces[3 * f + c] + k];
    }
  });
  return { nodes: packed, triangles: corners, count: nodes.length };
}

/**
 * Sorts triangles along the longest side of the box of their centres; returns how many come before the cut at which
 * rays are expected to meet least: number times area on both sides [Wald 2007, "On fast construction of SAH-based
 * bounding volume hierarchies"].
 */
function divided(order, spread, centres, low, high) {
  const sides = [0, 1, 2].map((k) => spread[k + 3] - spread[k]), axis = sides.indexOf(Math.max(...sides));
  const bin = (f) => Math.min(BINS - 1, Math.floor((BINS * (centres[3 * f + axis] - spread[axis])) / sides[axis]));
  if (!(sides[axis] > 0)) return order.length >> 1;
  const counts = new Uint32Array(BINS), boxes = Array.from({ length: BINS }, emptyBox);
  for (const f of order) {
    const b = bin(f);
    counts[b]++;
    extend(boxes[b], low.subarray(3 * f, 3 * f + 3), high.subarray(3 * f, 3 * f + 3));
  }
  const costs = new Float64Array(BINS), before = emptyBox(), after = emptyBox();
  for (let b = 0, n = 0; b < BINS - 1; b++) {
    extend(before, boxes[b].slice(0, 3), boxes[b].slice(3));
    costs[b] += (n += counts[b]) * area(before);
  }
  for (let b = BINS - 1, n = 0; b > 0; b--) {
    extend(after, boxes[b].slice(0, 3), boxes[b].slice(3));
    costs[b - 1] += (n += counts[b]) * area(after);
  }
  let cut = 0;
  for (let b = 1; b < BINS - 1; b++) if (costs[b] < costs[cut]) cut = b;
  order.sort((a, b) => bin(a) - bin(b));
  const first = order.findIndex((f) => bin(f) > cut);
  return first > 0 ? first : order.length >> 1;
}

function emptyBox() {
  return [Infinity, Infinity, Infinity, -Infinity, -Infinity, -Infinity];
}

function extend(box, low, high) {
  for (let k = 0; k < 3; k++) {
    box[k] = Math.min(box[k], low[k]);
    box[k + 3] = Math.max(box[k + 3], high[k]);
  }
}

function area(box) {
  const [x, y, z] = [0, 1, 2].map((k) => Math.max(box[k + 3] - box[k], 0));
  return x * y + y * z + z * x;
}
