// Where lamps may be: circles on the lat-long map of a light, by pointer, keyboard or numbers.

import { askedBytes, posted } from "./asking.js";
import { byId, cleared, element } from "./building.js";
import { MARK, mark } from "./marks.js";
import { unpacked } from "./packed.js";
import { exposed, whiteLevel } from "./radianceview.js";
import { cross, direction, dot } from "./vectors.js";

const canvas = byId("region-map"), box = byId("regions"), choice = byId("region-light"), RADIANS = Math.PI / 180;
// Of a region that is new, and of one that nothing is known of; what lies outside is dimmed so.
const RADIUS = 20, GREY = 0.18, DIMMED = 0.3, STEP = 5, ROUND = 90;
const ASKS = [["azimuth", 0, 360], ["elevation", -90, 90], ["radius", 1, 180]];
let set = null, result = null, light = null, seen = null, at = null, waiting = 0, sending = Promise.resolve();

/** Offers to mark where the lamps of a set's lights are, on the maps that a result has of them. */
export function openRegions(opened, chosen) {
  set = opened;
  result = chosen;
  const lights = set?.lightings.filter((each) => each.takesRegions) ?? [];
  box.hidden = !lights.length;
  const kept = light?.id;
  choice.replaceChildren(...lights.map(({ id, name }) => element("option", { value: id }, name)));
  choice.parentElement.hidden = lights.length < 2;
  light = lights.find((each) => each.id === kept) ?? lights[0] ?? null;
  if (!light) return;
  choice.value = light.id;
  const count = lights.reduce((sum, each) => sum + each.regions.length, 0);
  byId("regions-summary").textContent = `Where lamps may be: ${count ? `${count} region${count > 1 ? "s" : ""}` : "anywhere"}`;
  list();
  look();
}

/** Reads the light's map once it is to be seen. */
async function look() {
  if (!box.open) return;
  const mine = light, known = result?.lights.includes(light.name);
  const path = known ? `/api/results/${result.id}/lightings/${light.id}/map` : `/api/lightings/${light.id}/map`;
  if (seen?.path === path) return draw();
  say("");
  seen = null;
  if (known || !light.unknown) {
    try {
      say("Reading the light...");
      const { arrays } = await unpacked(await askedBytes(path));
      if (mine !== light) return;
      const { data, shape } = arrays.radiance;
      seen = { path, radiance: data, height: shape[0], lamps: triples(arrays.lamps.data) };
      say(known ? `The light as ${result.name} has it; crosses are its lamps.` : "The light as the mirror ball shows it; crosses are its lamps.");
    } catch (error) {
      say(error.message);
    }
  } else say("Nothing is known of this light yet. Once the set is fitted, its map is shown here.");
  draw();
}

const say = (text) => { byId("region-said").textContent = text; };
const triples = (data) => Array.from({ length: data.length / 3 }, (_, k) => [...data.slice(3 * k, 3 * k + 3)]);

function angles([x, y, z]) {
  const azimuth = Math.atan2(y, x) / RADIANS;
  return [azimuth < 0 ? azimuth + 360 : azimuth, Math.atan2(z, Math.hypot(x, y)) / RADIANS];
}

const onCanvas = (azimuth, elevation) => [(azimuth / 360) * canvas.width, ((90 - elevation) / 180) * canvas.height];

function unit(vector) {
  const length = Math.hypot(...vector);
  return vector.map((value) => value / length);
}

/** Codes of the map, dimmed where no lamps may be. */
function pictured() {
  const height = seen?.height ?? 64, width = 2 * height;
  const radiance = seen?.radiance ?? new Float32Array(3 * width * height).fill(GREY);
  const codes = exposed(radiance, seen ? whiteLevel(radiance) : 1);
  const cones = light.regions.map((region) => [unit(region.direction), Math.cos(region.radiusDeg * RADIANS)]);
  if (cones.length) {
    for (let k = 0; k < width * height; k++) {
      const way = direction((((k % width) + 0.5) * 360) / width, 90 - ((Math.floor(k / width) + 0.5) * 180) / height);
      if (cones.some(([axis, cos]) => dot(axis, way) >= cos)) continue;
      for (let c = 0; c < 3; c++) codes[4 * k + c] *= DIMMED;
    }
  }
  const picture = new OffscreenCanvas(width, height);
  picture.getContext("2d").putImageData(new ImageData(codes, width, height), 0, 0);
  return picture;
}

function draw() {
  if (!light || !canvas.clientWidth) return;
  const { context, width, height, ratio } = cleared(canvas);
  context.drawImage(pictured(), 0, 0, width, height);
  context.font = `${11 * ratio}px system-ui`;
  context.lineWidth = ratio;
  const line = (from, to, label, x, y) => {
    context.strokeStyle = "#ffffff40";
    context.beginPath();
    context.moveTo(...from);
    context.lineTo(...to);
    context.stroke();
    context.strokeStyle = "#000";
    context.lineWidth = 3 * ratio;
    context.strokeText(label, x, y);
    context.lineWidth = ratio;
    context.fillStyle = "#fff";
    context.fillText(label, x, y);
  };
  for (const azimuth of [45, 90, 135, 180, 225, 270, 315]) {
    const [x] = onCanvas(azimuth, 0);
    line([x, 0], [x, height], `${azimuth}°`, x + 3 * ratio, height - 4 * ratio);
  }
  for (const elevation of [60, 30, 0, -30, -60]) {
    const [, y] = onCanvas(0, elevation);
    line([0, y], [width, y], `${elevation}°`, 3 * ratio, y - 3 * ratio);
  }
  for (const region of light.regions) outline(context, unit(region.direction), region.radiusDeg * RADIANS, ratio);
  seen?.lamps.forEach((lamp, k) => mark(context, ...onCanvas(...angles(lamp)), `${k + 1}`));
  if (at && document.activeElement === canvas) outline(context, direction(...at), 2 * RADIANS, ratio);
}

/** The circle of directions at an angle from an axis. */
function outline(context, axis, radius, ratio) {
  const other = Math.abs(axis[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0];
  const across = unit(cross(axis, other)), along = cross(axis, across);
  context.beginPath();
  let before = null;
  for (let k = 0; k <= ROUND; k++) {
    const turn = (2 * Math.PI * k) / ROUND;
    const way = axis.map((value, i) => Math.cos(radius) * value + Math.sin(radius) * (Math.cos(turn) * across[i] + Math.sin(turn) * along[i]));
    const [x, y] = onCanvas(...angles(way));
    // At the map's edge it goes on at the other one.
    if (before === null || Math.abs(x - before) > canvas.width / 2) context.moveTo(x, y);
    else context.lineTo(x, y);
    before = x;
  }
  for (const [colour, width] of [["#000", 4], [MARK, 2]]) {
    context.strokeStyle = colour;
    context.lineWidth = width * ratio;
    context.stroke();
  }
}

const numbers = (region) => [...angles(unit(region.direction)), region.radiusDeg].map(Math.round);

function list() {
  const table = byId("region-list"), shown = table.querySelectorAll("input");
  if (shown.length && shown.length === ASKS.length * light.regions.length) {
    // In place: what a person is about to click, or types into, stays where it is.
    light.regions.flatMap(numbers).forEach((value, place) => {
      if (shown[place] !== document.activeElement) shown[place].value = value;
    });
    return;
  }
  const rows = light.regions.map((region, k) => {
    const values = numbers(region);
    const inputs = ASKS.map(([name, min, max], place) => {
      const input = element("input", { type: "number", min, max, step: 1, value: values[place], "aria-label": `Region ${k + 1}: ${name}, degrees` });
      input.addEventListener("change", () => {
        if (!input.checkValidity()) return input.reportValidity();
        const [azimuth, elevation, radius] = inputs.map((each) => Number(each.value));
        keep(light.regions.with(k, { direction: direction(azimuth, elevation), radiusDeg: radius }));
      });
      return input;
    });
    const gone = element("button", { type: "button", "aria-label": `Remove region ${k + 1}` }, "x");
    gone.addEventListener("click", () => keep(light.regions.filter((_, other) => other !== k)));
    return element("tr", {}, element("th", {}, `${k + 1}`), ...inputs.map((input) => element("td", {}, input)), element("td", {}, gone));
  });
  const heads = ["", "azimuth °", "elevation °", "radius °", ""].map((text) => element("th", {}, text));
  table.replaceChildren(...(rows.length ? [element("tr", {}, ...heads), ...rows] : []));
}

/** Shows regions at once, and has them written after those before; the set is read again after the last. */
function keep(regions) {
  const mine = light, before = mine.regions;
  mine.regions = regions.map((region) => ({ ...region, direction: unit(region.direction) }));
  const sent = mine.regions;
  list();
  draw();
  waiting += 1;
  sending = sending.then(async () => {
    try {
      await posted(`/api/lightings/${mine.id}/source-regions`, { regions: sent });
      if (waiting === 1) document.dispatchEvent(new CustomEvent("changed"));
    } catch (error) {
      mine.regions = before;
      list();
      draw();
      say(error.message);
    } finally {
      waiting -= 1;
    }
  });
}

const add = ([azimuth, elevation]) => keep([...light.regions, { direction: direction(azimuth, elevation), radiusDeg: RADIUS }]);

canvas.addEventListener("click", (event) => {
  const { left, top, width, height } = canvas.getBoundingClientRect();
  at = [(360 * (event.clientX - left)) / width, 90 - (180 * (event.clientY - top)) / height];
  add(at);
});
canvas.addEventListener("keydown", (event) => {
  const step = event.shiftKey ? 1 : STEP;
  const move = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] }[event.key];
  at ??= [180, 0];
  if (move) at = [(at[0] + move[0] + 360) % 360, Math.max(-90, Math.min(90, at[1] + move[1]))];
  else if (event.key === " ") add(at);
  else return;
  event.preventDefault();
  draw();
});
for (const name of ["focus", "blur"]) canvas.addEventListener(name, draw);
box.addEventListener("toggle", look);
choice.addEventListener("change", () => {
  light = set.lightings.find((each) => each.id === choice.value);
  openRegions(set, result);
});
new ResizeObserver(draw).observe(canvas);
