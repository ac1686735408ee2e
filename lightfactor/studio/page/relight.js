// The fitted object under light that is turned: live, and exact when the pointer rests.

import { asked, askedBytes, askedJson } from "./asking.js";
import { byId, element } from "./building.js";
import { control, goodExposure, initialState } from "./controls.js";
import { singles, unpacked } from "./packed.js";
import { Picture } from "./picture.js";
import { exposed } from "./radianceview.js";

const REST = 700;
let without = "", shownResult = null, picture = null, state = null, resting = 0, asking = null;

/** In the place of a live picture, where the browser can't draw one: all that is seen are stills. */
class Stills {
  constructor(canvas, subject) {
    Object.assign(this, { canvas, subject, lights: [] });
  }

  add(light, number = this.lights.length) {
    this.lights[number] = light;
  }

  draw() {}

  busy() {
    return false;
  }

  radiance() {
    return [];
  }

  pixel() {
    return [0, 0, 0, 0];
  }
}

/** Shows a result; others that were shown before are let go. */
export async function relight(result) {
  if (shownResult?.id === result.id && shownResult.lights.length === result.lights.length) return;
  shownResult = result;
  without = "";
  const said = byId("relight-state");
  said.textContent = "Preparing the object...";
  try {
    const subject = await unpacked(await askedBytes(`/api/results/${result.id}/subject`));
    const first = await unpacked(await askedBytes(`/api/results/${result.id}/lights/0`));
    if (shownResult !== result) return;
    const fresh = byId("picture").cloneNode();
    byId("picture").replaceWith(fresh);
    state = initialState(subject.camera);
    try {
      picture = new Picture(fresh, subject);
      picture.add(first);
      state.exposure = goodExposure(picture, state);
    } catch (error) {
      picture = new Stills(fresh, subject);
      picture.add(first);
      without = `${error.message} Stills take its place.`;
    }
    const form = byId("controls").cloneNode(true);
    byId("controls").replaceWith(form);
    form.elements.namedItem("light").replaceChildren(...result.lights.map((name, k) => element("option", { value: k }, name)));
    form.elements.namedItem("filled").closest("label").hidden = !subject.hasGaps;
    form.addEventListener("input", takeLight, { capture: true });
    control(picture, state, form, byId("readout"), rested);
    window.lightfactor = { picture, state };
    said.textContent = without;
    if (!without) stated();
  } catch (error) {
    said.textContent = `The object can't be shown live: ${error.message}`;
  }
}

/** A light is fetched when it is first chosen. */
async function takeLight(event) {
  const number = Number(event.target.value);
  if (event.target.name !== "light" || picture.lights[number]) return;
  event.stopPropagation();
  byId("relight-state").textContent = "Preparing the light...";
  try {
    picture.add(await unpacked(await askedBytes(`/api/results/${shownResult.id}/lights/${number}`)), number);
    byId("relight-state").textContent = "";
    event.target.dispatchEvent(new Event("input", { bubbles: true }));
    stated();
  } catch (error) {
    byId("relight-state").textContent = error.message;
  }
}

async function stated() {
  const { notes } = picture.subject;
  byId("stated").textContent = notes.join(" ");
  const light = state.light, { stated: text } = await askedJson(`/api/results/${shownResult.id}/lights/${light}/error`);
  if (light === state.light) byId("stated").textContent = [...notes, text].join(" ");
}

/** What moves is live; when it rests, an exact picture takes its place. */
function rested() {
  byId("still").hidden = true;
  clearTimeout(resting);
  asking?.abort();
  if (byId("relight").hidden) return;
  resting = setTimeout(takeStill, REST);
}

async function takeStill() {
  const canvas = picture.canvas, ratio = canvas.clientWidth / Math.max(canvas.clientWidth, 800);
  const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio), result = shownResult;
  if (!width || !height) return;
  asking = new AbortController();
  const body = JSON.stringify({ state, width, height });
  byId("relight-state").textContent = `${without || "live"}; computing the exact picture...`;
  try {
    const answer = await asked(`/api/results/${result.id}/still`, { method: "POST", body, signal: asking.signal });
    const { arrays } = await unpacked(await answer.arrayBuffer());
    const radiance = singles(arrays.radiance.data), coverage = arrays.coverage.data;
    if (without) state.exposure = -Math.log2(Math.max(1e-6, ...radiance.filter((_, k) => k % 301 === 0)));
    const seen = radiance.map((value, k) => value / Math.max(coverage[Math.floor(k / 3)], 1e-4));
    const codes = exposed(seen, 2 ** -state.exposure);
    coverage.forEach((share, k) => { codes[4 * k + 3] = Math.round(255 * share); });
    const still = byId("still");
    Object.assign(still, { width, height, hidden: false });
    still.getContext("2d").putImageData(new ImageData(codes, width, height), 0, 0);
    byId("relight-state").textContent = without || "exact";
  } catch (error) {
    if (error.name !== "AbortError") byId("relight-state").textContent = error.message;
  }
}

byId("export").addEventListener("click", async () => {
  byId("relight-state").textContent = "Writing the page...";
  byId("export").disabled = true;
  try {
    const text = await (await asked(`/api/results/${shownResult.id}/page`)).text();
    const url = URL.createObjectURL(new Blob([text], { type: "text/html" }));
    element("a", { href: url, download: `${shownResult.name}.html` }).click();
    URL.revokeObjectURL(url);
    byId("relight-state").textContent = "";
  } catch (error) {
    byId("relight-state").textContent = error.message;
  }
  byId("export").disabled = false;
});

byId("map").addEventListener("change", async () => {
  const [file] = byId("map").files;
  if (!file) return;
  byId("relight-state").textContent = `Reading ${file.name}...`;
  try {
    await asked(`/api/lights?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file });
    byId("relight-state").textContent = "";
    document.dispatchEvent(new Event("changed"));
  } catch (error) {
    byId("relight-state").textContent = error.message;
  }
});
