// Correspondences: a point in a photograph, the same point of the mesh; what they say of the mesh's place at once.

import { askedBytes, askedJson, lastAsked, posted } from "./asking.js";
import { byId, element, row } from "./building.js";
import { listPhotos } from "./capture.js";
import { mark } from "./marks.js";
import { unpacked } from "./packed.js";
import { Picture } from "./picture.js";
import { exposed, RadianceView, SharedView, whiteLevel } from "./radianceview.js";
import { cross, dot, turnView, viewed } from "./vectors.js";

const NEAR = 4, read = lastAsked();
const shared = new SharedView(), view = new RadianceView(byId("pick-photo"), shared);
const state = { light: 0, turn: 0, room: 1, exposure: -0.1, filled: true, lamps: [], azimuth: 30, elevation: 20, zoom: 1 };
// For whoever drives the page by a script.
window.lightfactorPicking = { state, turned: () => drawMesh(), subject: () => picture.subject };
let set = null, photo = null, picture = null, mesh = null, picks = [], fit = null, pending = null;

/** Shows a set's photographs and its mesh. */
export async function openPicking(opened) {
  if (set) return;
  set = opened;
  listPhotos(byId("pick-photos"), set.photos, choose);
  say("Reading the mesh...");
  try {
    mesh = await unpacked(await askedBytes("/api/mesh"));
    picture = new Picture(byId("pick-mesh"), mesh);
    picture.add(mesh);
    new ResizeObserver(drawMesh).observe(picture.canvas);
    say("");
    byId("pick-shown").textContent = mesh.notes.join(" ");
    take(await askedJson("/api/picks"));
    byId("pick-photos").querySelector("button")?.click();
  } catch (error) {
    say(error.message);
  }
}

function say(text) {
  byId("pick-state").textContent = text;
}

async function choose(chosen) {
  photo = { ...chosen };
  pending = null;
  view.clear();
  try {
    const found = await read(`/api/photos/${chosen.id}`);
    if (!found) return;
    const [height, width] = found.arrays.radiance.shape, data = found.arrays.radiance.data;
    Object.assign(photo, { shownWidth: width, shownHeight: height, codes: exposed(data, whiteLevel(data)) });
    drawPhoto();
  } catch (error) {
    say(error.message);
  }
}

/** What the server says of the picks. */
function take(found) {
  picks = found.picks;
  fit = found.fit;
  const lines = picks.map((pick, k) => {
    const gone = element("button", { type: "button", "aria-label": `Remove pick ${k + 1}` }, "x");
    gone.addEventListener("click", () => keep(picks.filter((_, other) => other !== k)));
    const label = set.photos.find((each) => each.id === pick.photo)?.label ?? "";
    const line = row(`${k + 1}`, label, fit ? `${fit.residuals[k].toFixed(1)} px` : "");
    if (fit && !fit.kept[k]) line.className = "doubted";
    line.append(element("td", {}, gone));
    return line;
  });
  byId("picks").replaceChildren(row("", "photograph", "off by", ""), ...lines);
  byId("align").disabled = !fit;
  byId("pick-fit").textContent = fit ? described() : found.said;
  drawPhoto();
  drawMesh();
}

function described() {
  const sure = fit.turnDeg === null
    ? "One point more shows how well they fit."
    : `They place the mesh to ${fit.turnDeg.toPrecision(2)} degrees and ${(1000 * fit.shiftMetres).toPrecision(2)} mm.`;
  const several = fit.places > 1 ? ` ${fit.places} places fit alike: pick more points, in other photographs.` : "";
  const doubted = fit.kept.some((each) => !each) ? " Picks in red contradict the others." : "";
  return `Clicks scatter by ${fit.sigma.toFixed(1)} pixels. ${sure}${several}${doubted}`;
}

async function keep(wanted) {
  try {
    take(await (await posted("/api/picks", { picks: wanted })).json());
    say("");
  } catch (error) {
    say(error.message);
  }
}

function drawPhoto() {
  if (!photo?.codes) return;
  view.show(photo.codes, photo.shownWidth, photo.shownHeight);
}

view.over((context) => {
  if (!photo?.codes) return;
  const scale = view.scale(), ratio = photo.shownWidth / photo.width;
  const own = picks.map((pick, k) => ({ ...pick, name: `${k + 1}` })).filter((pick) => pick.photo === photo.id);
  if (pending) own.push({ ...pending, name: "?" });
  for (const { u, v, name } of own) {
    mark(context, scale * (u * ratio - shared.x) + view.canvas.width / 2, scale * (v * ratio - shared.y) + view.canvas.height / 2, name);
  }
});

let overlay = null;

/** The mesh under a lamp at the camera, and the picks that face it. */
function drawMesh() {
  if (!picture || !picture.canvas.clientWidth) return;
  const canvas = picture.canvas, ratio = Math.min(window.devicePixelRatio || 1, 2);
  Object.assign(canvas, { width: Math.round(canvas.clientWidth * ratio), height: Math.round(canvas.clientHeight * ratio) });
  state.room = 0.2;
  state.lamps = [{ azimuth: state.azimuth, elevation: state.elevation, strength: 1 }];
  picture.draw(state);
  overlay ??= canvas.parentElement.insertBefore(element("canvas", { className: "marks" }), canvas.nextSibling);
  Object.assign(overlay, { width: canvas.width, height: canvas.height });
  Object.assign(overlay.style, { width: `${canvas.clientWidth}px`, height: `${canvas.clientHeight}px` });
  const { matrix } = viewed(picture.subject.camera, state, canvas.width, canvas.height), context = overlay.getContext("2d");
  picks.forEach((pick, k) => {
    const p = ["x", "y", "z"].map((name, i) => (pick[name] * set.metres - mesh.centre[i]) / mesh.radius);
    const at = [0, 1, 3].map((i) => matrix[i] * p[0] + matrix[4 + i] * p[1] + matrix[8 + i] * p[2] + matrix[12 + i]);
    mark(context, ((at[0] / at[2] + 1) / 2) * canvas.width, ((1 - at[1] / at[2]) / 2) * canvas.height, `${k + 1}`);
  });
}

/** The first point of the mesh under a pixel of its canvas, in the mesh file's unit; null beside it. */
function meshPoint(x, y) {
  const { width, height } = picture.canvas, camera = viewed(picture.subject.camera, state, width, height);
  const across = (2 * x / width - 1) * camera.reach[0], up = (1 - 2 * y / height) * camera.reach[1];
  const towards = [0, 1, 2].map((k) => across * camera.right[k] + up * camera.up[k] - camera.outward[k]);
  const positions = mesh.arrays.positions.data, faces = mesh.arrays.faces.data, corner = (k) => positions.subarray(3 * faces[k], 3 * faces[k] + 3);
  let nearest = Infinity;
  for (let k = 0; k < faces.length; k += 3) {
    const [a, b, c] = [corner(k), corner(k + 1), corner(k + 2)];
    const one = [b[0] - a[0], b[1] - a[1], b[2] - a[2]], other = [c[0] - a[0], c[1] - a[1], c[2] - a[2]];
    const normal = cross(towards, other), area = dot(one, normal);
    if (area === 0) continue;
    const offset = [0, 1, 2].map((i) => (camera.place[i] - a[i]) / area), s = dot(offset, normal);
    if (s < 0 || s > 1) continue;
    const turned = cross(offset, one), t = dot(towards, turned);
    if (t < 0 || s + t > 1) continue;
    const far = dot(other, turned);
    if (far > 0 && far < nearest) nearest = far;
  }
  if (nearest === Infinity) return null;
  return camera.place.map((value, k) => (mesh.centre[k] + mesh.radius * (value + nearest * towards[k])) / set.metres);
}

/** Calls back with a click's place, canvas pixels; what moves further is a drag. */
function clicked(canvas, done, dragged) {
  let from = null, moved = false;
  canvas.addEventListener("pointerdown", (event) => { from = event; moved = false; });
  canvas.addEventListener("pointermove", (event) => {
    if (!event.buttons || !from) return;
    moved ||= Math.hypot(event.clientX - from.clientX, event.clientY - from.clientY) > NEAR;
    if (moved) dragged(event);
  });
  canvas.addEventListener("pointerup", (event) => {
    if (from && !moved) done(event);
    from = null;
  });
}

clicked(byId("pick-photo"), (event) => {
  if (!photo?.codes) return;
  const scale = photo.width / photo.shownWidth, [u, v] = view.pixel(event).map((value) => value * scale);
  if (u < 0 || v < 0 || u > photo.width || v > photo.height) return;
  pending = { photo: photo.id, u, v };
  say("Now click the same point of the mesh.");
  view.draw();
}, () => {});

clicked(byId("pick-mesh"), (event) => {
  const { left, top, width } = picture.canvas.getBoundingClientRect(), ratio = picture.canvas.width / width;
  const point = meshPoint((event.clientX - left) * ratio, (event.clientY - top) * ratio);
  if (!point) return say("There is no mesh there.");
  if (!pending) return say("Click a point in the photograph first.");
  const [x, y, z] = point;
  keep([...picks, { ...pending, x, y, z }]);
  pending = null;
}, (event) => turnMesh(-event.movementX * 0.4, event.movementY * 0.4));

function turnMesh(azimuth, elevation) {
  turnView(state, azimuth, elevation);
  drawMesh();
}

byId("pick-mesh").addEventListener("pointerdown", (event) => event.target.setPointerCapture(event.pointerId));
byId("pick-mesh").addEventListener("wheel", (event) => {
  event.preventDefault();
  state.zoom = Math.max(0.5, Math.min(20, state.zoom * Math.exp(-event.deltaY / 600)));
  drawMesh();
}, { passive: false });
byId("pick-mesh").addEventListener("keydown", (event) => {
  const steps = { ArrowLeft: [5, 0], ArrowRight: [-5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5] };
  if (!(event.key in steps)) return;
  event.preventDefault();
  turnMesh(...steps[event.key]);
});
byId("align").addEventListener("click", async () => {
  try {
    await posted("/api/alignments");
    document.dispatchEvent(new CustomEvent("changed"));
  } catch (error) {
    say(error.message);
  }
});
