// Which photograph, or which lamp, more would help a result most, drawn about the object.

import { askedJson, posted } from "./asking.js";
import { byId, element } from "./building.js";
import { ramp, readSurface, Space } from "./space.js";

const space = new Space(byId("plan-space"), probed), BEST = "#e0731d", LAMP = "#8a8f98";
let result = null, set = null, surface = null, plan = null;

/** Shows what is planned of a result; of one that nobody has planned yet, how to. */
export async function openPlan(chosen, opened) {
  [result, set, plan] = [chosen, opened.set, null];
  byId("plan-state").textContent = "";
  try {
    plan = (await askedJson(`/api/results/${result.id}/plan`)).plan;
    surface = await readSurface();
  } catch (error) {
    byId("plan-state").textContent = error.message;
  }
  byId("plan-choice").hidden = !plan;
  byId("start-plan").textContent = plan ? "Plan it anew" : "Plan it";
  byId("plan-said").replaceChildren(...(plan?.sentences ?? []).map((sentence) => element("p", {}, sentence.replace(/^- /, ""))));
  draw();
}

function draw() {
  if (!surface) return;
  const [kind] = ["view", "lamp"].filter((each) => byId(`plan-${each}`).checked), tried = plan?.advice[kind];
  const most = Math.max(1.25, ...(tried?.tried.gain ?? [])), lamps = plan ? plan.lamps : [];
  const dots = (tried?.tried.direction ?? []).map((direction, k) => {
    const gain = tried.tried.gain[k];
    return { direction, gain, share: Math.log(Math.max(gain, 1)) / Math.log(most) };
  });
  const arrows = lamps.map((direction) => ({ direction, name: "", colour: LAMP }));
  if (tried) {
    const { best, best_above_horizon: above } = tried, isBelow = best.elevation_deg < 0 && above.elevation_deg >= 0;
    arrows.push({ direction: best.direction, name: `best ${kind}`, colour: BEST });
    if (isBelow) arrows.push({ direction: above.direction, name: "best above the horizon", colour: BEST });
    byId("plan-best").textContent = `Best ${kind}: ${place(best)}${best.lighting ? `, light ${best.lighting}` : ""}. ${isBelow ? `Above the horizon: ${place(above)}.` : ""}`;
  }
  space.show({ surface, cameras: set.cameras.map((camera) => ({ ...camera, chosen: false })), dots, arrows });
  byId("plan-hint").textContent = `Pyramids are the set's cameras${lamps.length ? ", grey arrows its lamps" : ""}. Drag or press arrow keys to turn. ${space.scaleSaid}`;
  byId("plan-legend").hidden = !tried;
  byId("plan-legend").replaceChildren(
    element("span", {}, "no gain"),
    ...[0, 0.25, 0.5, 0.75, 1].map((share) => swatch(ramp(share))),
    element("span", {}, `${plan?.advice.label ?? ""} ${most.toPrecision(3)} times as sure`),
  );
}

function swatch(colour) {
  const canvas = element("canvas", { width: 28, height: 12 }), context = canvas.getContext("2d");
  context.fillStyle = colour;
  context.fillRect(0, 0, 28, 12);
  return canvas;
}

const place = ({ azimuth_deg: azimuth, elevation_deg: elevation }) => `azimuth ${azimuth.toFixed(0)}°, elevation ${elevation.toFixed(0)}°`;

function probed(dot) {
  if (!dot || !plan) return;
  const [x, y, z] = dot.direction, degrees = 180 / Math.PI;
  const there = place({ azimuth_deg: Math.atan2(y, x) * degrees, elevation_deg: Math.asin(z) * degrees });
  byId("plan-probe").textContent = `${there}: ${plan.advice.label} ${dot.gain.toPrecision(3)} times as sure`;
}

for (const id of ["plan-view", "plan-lamp"]) byId(id).addEventListener("change", draw);
byId("start-plan").addEventListener("click", async () => {
  try {
    await posted(`/api/results/${result.id}/plans`);
    document.dispatchEvent(new CustomEvent("changed"));
  } catch (error) {
    byId("plan-state").textContent = error.message;
  }
});
