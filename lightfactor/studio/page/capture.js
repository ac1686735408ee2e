// The photographs of a set, one of them large, and where they were taken from.

import { asked, lastAsked, posted } from "./asking.js";
import { byId, cleared, COLOURS, element, row, shown } from "./building.js";
import { checks } from "./checks.js";
import { closeMask, drawsMasks, openMask, showsMask } from "./mask.js";
import { exposed, RadianceView, SharedView, whiteLevel } from "./radianceview.js";
import { readSurface, Space } from "./space.js";

const shared = new SharedView(), view = new RadianceView(byId("photo"), shared);
const space = new Space(byId("cameras")), check = checks(view), read = lastAsked();
// lost : why the object isn't drawn. sought : the set whose object was looked for.
let current = null, set = null, surface = null, lost = "", sought = null;

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
  surface = null;
  lost = "Looking for the object...";
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
  closeMask();
  check(null);
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
    openMask(photo, width, height);
    check(photo);
    drawCameras();
  } catch (error) {
    byId("photo-state").textContent = error.message;
  }
  // After the photograph, for masks of all of them may have to be read.
  if (sought !== set) findSurface();
}

function draw() {
  if (!current?.arrays) return;
  const { radiance, saturated, mask } = current.arrays, dims = byId("show-mask").checked && !showsMask();
  const codes = exposed(radiance.data, current.white * 2 ** -Number(byId("photo-exposure").value));
  for (let k = 0; k < codes.length / 4; k++) {
    if (mask && dims && mask.data[k] < 128) for (let c = 0; c < 3; c++) codes[4 * k + c] = 40 + codes[4 * k + c] / 3;
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

/** All cameras about the object, if anyone knows yet where it is. */
function drawCameras() {
  if (!set?.cameras.length) return;
  space.show({ surface, cameras: set.cameras.map((camera) => ({ ...camera, chosen: camera.photo === current?.photo.id })) });
  byId("cameras-said").textContent = surface ? space.scaleSaid : lost;
}

async function findSurface() {
  const mine = sought = set;
  let found = null, said = "";
  try {
    found = await readSurface();
  } catch (error) {
    said = error.message;
  }
  if (mine !== set) return;
  [surface, lost] = [found, said];
  drawCameras();
}

shown(byId("photo-exposure"), draw);
drawsMasks(view, draw);
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
