// A photograph beside its prediction and the difference, and the errors of all.

import { askedJson, lastAsked } from "./asking.js";
import { byId, cleared, COLOURS, shown } from "./building.js";
import { listPhotos } from "./capture.js";
import { singles } from "./packed.js";
import { code, exposed, RadianceView, SharedView, whiteLevel } from "./radianceview.js";

const shared = new SharedView(), read = lastAsked();
const views = ["observed", "predicted", "difference"].map((id) => new RadianceView(byId(id), shared, probe));
// Milliseconds after which a pointer rests, and pixels across a close-up.
const REST = 250, CLOSE = 48;
let result = null, current = null, resting = 0;

/** Shows a result's photographs, the worst first. */
export function judge(described) {
  result = described;
  const photos = [...result.photos].sort((a, b) => b.error - a.error);
  listPhotos(byId("judged"), photos, choose, (photo) => ` ${(100 * photo.error).toFixed(2)}%${photo.heldOut ? ", held out" : ""}`);
  drawErrors();
  byId("judged").querySelector("button")?.click();
}

async function choose(photo) {
  byId("judge-name").textContent = photo.label;
  byId("judge-state").textContent = "Reading...";
  current = { photo };
  views.forEach((view) => view.clear());
  cleared(byId("angles"));
  try {
    const found = await read(`/api/results/${result.id}/photos/${photo.id}`);
    if (!found) return;
    const [height, width] = found.arrays.radiance.shape;
    Object.assign(current, { ...found.arrays, factor: found.factor, width, height, white: whiteLevel(found.arrays.predicted.data) });
    byId("judge-state").textContent = "";
    draw();
    drawAngles();
    drawErrors();
  } catch (error) {
    byId("judge-state").textContent = error.message;
  }
}

function draw() {
  if (!current?.radiance) return;
  const { radiance, predicted, counted, width, height } = current;
  const white = current.white * 2 ** -Number(byId("judge-exposure").value);
  const left = exposed(radiance.data, white), right = exposed(predicted.data, white), over = (Number(byId("wipe").value) / 100) * width;
  for (let row = 0; row < height; row++) {
    const start = 4 * row * width;
    left.set(right.subarray(start, start + 4 * Math.round(over)), start);
  }
  const limit = (current.white * Number(byId("limit").value)) / 100, codes = new Uint8ClampedArray(4 * width * height);
  for (let k = 0; k < width * height; k++) {
    codes[4 * k + 3] = 255;
    if (!counted.data[k]) {
      codes.fill(128, 4 * k, 4 * k + 3);
      continue;
    }
    let off = 0;
    for (let c = 0; c < 3; c++) off += (predicted.data[3 * k + c] - radiance.data[3 * k + c]) / 3 / limit;
    const size = Math.min(Math.abs(off), 1), faded = code(1 - size);
    // Red where the prediction is too bright, blue where it is too dark; they differ in lightness from white alike.
    codes.set(off > 0 ? [255, faded, faded] : [faded, faded, 255], 4 * k);
  }
  [left, right, codes].forEach((each, k) => views[k].show(each, width, height));
  byId("difference-caption").textContent = `difference (red: too bright; full at ${byId("limit").value}%)`;
}

function probe(column, row) {
  if (!current?.radiance) return;
  const k = row * current.width + column, [observed, std, predicted] = [current.radiance, current.std, current.predicted].map(({ data }) => data.subarray(3 * k, 3 * k + 3));
  const text = (values) => Array.from(values, (value) => value.toPrecision(3)).join(", ");
  const [x, y, z, cosine] = Array.from(singles(current.normals.data.subarray(4 * k, 4 * k + 4)));
  const surface = cosine > 0 ? `; normal ${[x, y, z].map((part) => part.toFixed(2)).join(", ")}, seen at ${degrees(cosine).toFixed(0)}°` : "";
  const off = Math.hypot(...[0, 1, 2].map((c) => (predicted[c] - observed[c]) / Math.max(std[c], 1e-12))) / Math.sqrt(3);
  const said = `(${column}, ${row}) photograph ${text(observed)}; noise ${text(std)}; prediction ${text(predicted)}; ${off.toFixed(1)} standard deviations of the noise apart${surface}`;
  byId("probe").textContent = said;
  clearTimeout(resting);
  if (current.counted.data[k]) resting = setTimeout(() => addTerms(said, row, column, text), REST);
}

/** What the prediction is made of, once the pointer rests. */
async function addTerms(said, row, column, text) {
  try {
    const { base, lobe, bounced } = await askedJson(`/api/results/${result.id}/photos/${current.photo.id}/terms/${current.factor}/${row}/${column}`);
    const parts = [`base ${text(base)}`, `lobe ${text(lobe)}`, ...(bounced.some(Boolean) ? [`from its other parts ${text(bounced)}`] : [])];
    if (byId("probe").textContent === said) byId("probe").textContent = `${said}; of it ${parts.join("; ")}`;
  } catch (error) {
    if (byId("probe").textContent === said) byId("probe").textContent = `${said}; ${error.message}`;
  }
}

/** Goes close to what is brightest in the prediction. */
function closeUp() {
  if (!current?.predicted) return;
  const { data } = current.predicted, { width, counted } = current;
  let best = 0, most = -1;
  for (let k = 0; k < counted.data.length; k++) {
    const sum = counted.data[k] ? data[3 * k] + data[3 * k + 1] + data[3 * k + 2] : -1;
    if (sum > most) [best, most] = [k, sum];
  }
  Object.assign(shared, { x: (best % width) + 0.5, y: Math.floor(best / width) + 0.5, zoom: Math.max(1, width / CLOSE) });
  shared.redraw();
}

const degrees = (cosine) => (Math.acos(Math.min(cosine, 1)) * 180) / Math.PI;

/** The mean of prediction less photograph, over the mean prediction, in bins of the angle between normal and view. */
function drawAngles() {
  const { context, width, height, ink, muted, line, ratio } = cleared(byId("angles"));
  const bins = 18, off = [0, 1, 2].map(() => new Float64Array(bins)), whole = [0, 1, 2].map(() => new Float64Array(bins));
  const { radiance, predicted, counted, normals } = current, cosines = singles(normals.data);
  for (let k = 0; k < counted.data.length; k++) {
    if (!counted.data[k] || !(cosines[4 * k + 3] > 0)) continue;
    const bin = Math.min(bins - 1, Math.floor((degrees(cosines[4 * k + 3]) / 90) * bins));
    for (let c = 0; c < 3; c++) {
      off[c][bin] += predicted.data[3 * k + c] - radiance.data[3 * k + c];
      whole[c][bin] += predicted.data[3 * k + c];
    }
  }
  const shares = off.map((sums, c) => Array.from(sums, (sum, bin) => (whole[c][bin] > 0 ? sum / whole[c][bin] : null)));
  // The rim is off for reasons of its own, and would hide all else.
  const inner = shares.flatMap((each) => each.slice(0, (bins * 5) / 6));
  const most = Math.max(0.005, ...inner.map((share) => Math.abs(share ?? 0))), base = height - 16 * ratio, middle = (base + 18 * ratio) / 2;
  context.strokeStyle = line;
  context.strokeRect(0, middle, width, 0.5);
  shares.forEach((each, c) => {
    context.beginPath();
    each.forEach((share, bin) => share !== null && context.lineTo(((bin + 0.5) / bins) * width, middle - Math.max(-1, Math.min(1, share / most)) * (middle - 18 * ratio)));
    context.strokeStyle = COLOURS[c];
    context.lineWidth = 1.5 * ratio;
    context.stroke();
  });
  context.fillStyle = muted;
  context.font = `${11 * ratio}px system-ui`;
  context.textAlign = "left";
  context.fillText(`±${(100 * most).toFixed(1)}% of the prediction at the edges`, 4, 12 * ratio);
  context.textAlign = "center";
  for (const angle of [15, 30, 45, 60, 75]) context.fillText(`${angle}°`, (angle / 90) * width, height - 3 * ratio);
  context.strokeStyle = ink;
  context.strokeRect(0, base, width, 0.5);
}

function drawErrors() {
  if (!result) return;
  const { context, width, height, ink, muted, ratio } = cleared(byId("errors"));
  const most = Math.max(1e-6, ...result.photos.map((photo) => photo.error)), base = height - 16 * ratio, top = 18 * ratio;
  const step = width / Math.max(result.photos.length, 1);
  result.photos.forEach((photo, k) => {
    const size = (photo.error / most) * (base - top);
    context.fillStyle = photo.id === current?.photo.id ? ink : photo.heldOut ? "#D55E00" : "#0072B2";
    context.fillRect(k * step + 0.1 * step, base - size, Math.max(0.8 * step, 1), size);
  });
  context.fillStyle = muted;
  context.font = `${11 * ratio}px system-ui`;
  context.fillText(`${(100 * most).toFixed(2)}% at the top; orange: held out`, 4, 12 * ratio);
}

for (const id of ["judge-exposure", "wipe", "limit"]) shown(byId(id), draw);
byId("close-up").addEventListener("click", closeUp);
byId("whole").addEventListener("click", () => { shared.reset(); shared.redraw(); });
