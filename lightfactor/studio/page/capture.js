// The photographs of a set, one of them large, and where they were taken from.

import { asked, lastAsked, posted } from "./asking.js";
import { byId, cleared, COLOURS, element, row, shown } from "./building.js";
import { exposed, RadianceView, SharedView, whiteLevel } from "./radianceview.js";
import { turnView } from "./vectors.js";

const shared = new SharedView(), view = new RadianceView(byId("photo"), shared);
const turn = { azimuth: 40, elevation: 25 }, read = lastAsked();
let current = null, set = null;

/** A list of photographs with thumbnails, that are fetched as they come into sight. */
export function listPhotos(list, photos, chosen, note = () => "") {
  const seen = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      if (!isIntersecting) continue;
      seen.unobserve(target);
      thumbnail(target);
    }
  }, { root: list.parentElement });
  list.replaceChildren(...photos.map((photo) => {
    const image = element("img", { alt: "" });
    image.dataset.photo = photo.id;
    const button = element("button", { type: "button" }, image, photo.label, element("span", { className: "aside" }, note(photo)));
    button.addEventListener("click", () => {
      for (const other of list.querySelectorAll("button")) other.removeAttribute("aria-current");
      button.setAttribute("aria-current", "true");
      chosen(photo);
    });
    seen.observe(image);
    return element("li", {}, button);
  }));
}

async function thumbnail(image) {
  try {
    image.src = URL.createObjectURL(await (await asked(`/api/photos/${image.dataset.photo}/thumbnail`)).blob());
  } catch (error) {
    image.replaceWith(element("span", { className: "broken" }, `broken: ${error.message} `));
  }
}

/** Shows a set. */
export function openSet(opened, kept) {
  set = opened;
  const unknown = new Set(set.lightings.filter((lighting) => lighting.unknown).map((lighting) => lighting.name));
  const note = (photo) => [
    photo.heldOut ? " held out" : "", photo.hasMask ? "" : " no mask", unknown.has(photo.lighting) ? " light unknown" : "",
  ].filter(Boolean).join(",");
  listPhotos(byId("photos"), set.photos, choose, note);
  drawCameras();
  const buttons = [...byId("photos").querySelectorAll("button")], number = set.photos.findIndex((photo) => photo.id === kept);
  buttons[Math.max(number, 0)]?.click();
}

async function choose(photo) {
  byId("photo-name").textContent = photo.label;
  byId("held-out").checked = photo.heldOut;
  byId("photo-state").textContent = "Reading...";
  byId("photo-facts").replaceChildren();
  view.clear();
  cleared(byId("histogram"));
  current = { photo };
  try {
    const found = await read(`/api/photos/${photo.id}`);
    if (!found) return;
    const [height, width] = found.arrays.radiance.shape;
    Object.assign(current, found, { width, height, white: whiteLevel(found.arrays.radiance.data) });
    byId("photo-state").textContent = "";
    facts(found, photo);
    histogram(found.histogram);
    draw();
    drawCameras();
  } catch (error) {
    byId("photo-state").textContent = error.message;
  }
}

function draw() {
  if (!current?.arrays) return;
  const { radiance, saturated, mask } = current.arrays;
  const codes = exposed(radiance.data, current.white * 2 ** -Number(byId("photo-exposure").value));
  for (let k = 0; k < codes.length / 4; k++) {
    if (mask && byId("show-mask").checked && mask.data[k] < 128) for (let c = 0; c < 3; c++) codes[4 * k + c] = 40 + codes[4 * k + c] / 3;
    if (byId("show-saturated").checked && saturated.data[k]) codes.set([255, 0, 200], 4 * k);
  }
  view.show(codes, current.width, current.height);
}

function facts(found, photo) {
  const percent = (share) => `${(100 * share).toFixed(share < 0.01 ? 2 : 1)}%`;
  const { seconds, iso, f_number: aperture } = found.exposure;
  const exposure = [seconds && `${seconds} s`, iso && `ISO ${iso}`, aperture && `f/${aperture}`].filter(Boolean).join(", ");
  byId("photo-facts").replaceChildren(
    row("Size", `${photo.width} x ${photo.height} pixels`),
    row("Light", photo.lighting),
    row("Exposure", exposure || "not in the manifest"),
    row("Saturated", percent(found.saturated)),
    row("Mask", found.masked === null ? "none" : `${percent(found.masked)} of the picture`),
    row("Counts", photo.heldOut ? "held out: only judged by" : "in the fit"),
  );
}

function histogram({ octaves, counts }) {
  const { context, width, height, ink, muted, ratio } = cleared(byId("histogram"));
  const base = height - 18 * ratio, most = Math.max(1, ...Object.values(counts).flatMap((each) => each.slice(1)));
  Object.values(counts).forEach((each, c) => {
    context.beginPath();
    each.forEach((count, k) => context.lineTo(((k + 0.5) / each.length) * width, base - Math.sqrt(count / most) * (base - 18 * ratio)));
    context.strokeStyle = COLOURS[c];
    context.lineWidth = 1.5 * ratio;
    context.stroke();
  });
  context.fillStyle = muted;
  context.font = `${11 * ratio}px system-ui`;
  context.textAlign = "center";
  for (let octave = -octaves + 2; octave < 0; octave += 4) context.fillText(`${octave}`, (1 + octave / octaves) * width, height - 4 * ratio);
  context.textAlign = "left";
  context.fillText("root of counts over octaves below white", 4, 12 * ratio);
  context.strokeStyle = ink;
  context.strokeRect(0, base, width, 0.5);
}

/** Frusta of all cameras about the object, in a parallel projection. */
function drawCameras() {
  if (!set?.cameras.length) return;
  const { context, width, height, ink, muted, ratio } = cleared(byId("cameras"));
  const a = (turn.azimuth * Math.PI) / 180, e = (turn.elevation * Math.PI) / 180;
  const right = [-Math.sin(a), Math.cos(a), 0], up = [-Math.sin(e) * Math.cos(a), -Math.sin(e) * Math.sin(a), Math.cos(e)];
  const centres = set.cameras.map((camera) => camera.centre), middle = looked(set.cameras);
  const far = Math.max(1e-9, ...centres.map((centre) => Math.hypot(...centre.map((x, k) => x - middle[k]))));
  const scale = (0.42 * Math.min(width, height)) / far;
  const at = (point) => {
    const off = point.map((x, k) => x - middle[k]), along = (axis) => off.reduce((sum, x, k) => sum + x * axis[k], 0);
    return [width / 2 + scale * along(right), height / 2 - scale * along(up)];
  };
  const line = (points) => {
    context.beginPath();
    points.forEach((point) => context.lineTo(...at(point)));
    context.stroke();
  };
  context.lineWidth = ratio;
  [["X", [1, 0, 0]], ["Y", [0, 1, 0]], ["Z", [0, 0, 1]]].forEach(([name, axis], c) => {
    const tip = axis.map((x, k) => middle[k] + 0.35 * far * x);
    context.strokeStyle = context.fillStyle = COLOURS[c];
    line([middle, tip]);
    context.font = `${12 * ratio}px system-ui`;
    context.fillText(name, ...at(tip));
  });
  set.cameras.forEach(({ photo, centre, axes, reach }) => {
    const chosen = photo === current?.photo.id, depth = 0.22 * far;
    context.strokeStyle = chosen ? ink : muted;
    context.lineWidth = (chosen ? 2.5 : 1) * ratio;
    // Long lenses see slender pyramids: they are drawn wider, all alike.
    const flat = reach.map((side) => (0.4 * side) / Math.max(...reach));
    const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, y]) => centre.map((c, i) => c + depth * (axes[2][i] + x * flat[0] * axes[0][i] + y * flat[1] * axes[1][i])));
    line([...corners, corners[0]]);
    corners.forEach((corner) => line([centre, corner]));
  });
}

/** The point that is nearest to all cameras' lines of sight, least squares; the mean of them where these are parallel. */
function looked(cameras) {
  const sums = [0, 1, 2].map(() => [0, 0, 0, 0]), mean = [0, 0, 0];
  for (const { centre, axes } of cameras) {
    for (let i = 0; i < 3; i++) {
      mean[i] += centre[i] / cameras.length;
      for (let j = 0; j < 3; j++) {
        const across = (i === j ? 1 : 0) - axes[2][i] * axes[2][j];
        sums[i][j] += across;
        sums[i][3] += across * centre[j];
      }
    }
  }
  // Gauss's elimination of three equations.
  for (let i = 0; i < 3; i++) {
    const best = [0, 1, 2].slice(i).reduce((a, b) => (Math.abs(sums[b][i]) > Math.abs(sums[a][i]) ? b : a), i);
    [sums[i], sums[best]] = [sums[best], sums[i]];
    if (Math.abs(sums[i][i]) < 1e-4 * cameras.length) return mean;
    for (let j = 0; j < 3; j++) {
      if (j === i) continue;
      const factor = sums[j][i] / sums[i][i];
      sums[j] = sums[j].map((value, k) => value - factor * sums[i][k]);
    }
  }
  return sums.map((equation, i) => equation[3] / equation[i]);
}

shown(byId("photo-exposure"), draw);
byId("held-out").addEventListener("change", async () => {
  const photo = current.photo, heldOut = byId("held-out").checked;
  try {
    await posted(`/api/photos/${photo.id}/held-out`, { heldOut });
    document.dispatchEvent(new CustomEvent("changed", { detail: photo.id }));
  } catch (error) {
    byId("held-out").checked = !heldOut;
    byId("photo-state").textContent = error.message;
  }
});
for (const id of ["show-mask", "show-saturated"]) byId(id).addEventListener("change", draw);
const cameras = byId("cameras");
cameras.addEventListener("pointerdown", (event) => cameras.setPointerCapture(event.pointerId));
cameras.addEventListener("pointermove", (event) => {
  if (!event.buttons) return;
  turnView(turn, -event.movementX / 2, event.movementY / 2);
  drawCameras();
});
cameras.addEventListener("keydown", (event) => {
  const steps = { ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5] };
  if (!(event.key in steps)) return;
  event.preventDefault();
  turnView(turn, ...steps[event.key]);
  drawCameras();
});
