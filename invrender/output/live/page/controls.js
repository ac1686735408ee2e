// Binds pointer, keyboard and form fields to the state of a live picture.

import { around, turnView } from "./vectors.js";

const STEP = 5, FASTEST = 0.4;
// Milliseconds: what a picture that moves may take, and after how long of standing still it gets all its pixels.
const LONGEST = 33, SETTLED = 150;
// A picture that moves has all pixels, half of them, a quarter, down to a sixteenth.
const COARSEST = 4;

/** State at the start: the first light as it was, from the side that `lightfactor render` takes. */
export function initialState(camera) {
  return {
    light: 0, turn: 0, room: 1, exposure: 0, lamps: [], filled: false,
    azimuth: camera.azimuth ?? 0, elevation: camera.elevation ?? 20, zoom: 1,
  };
}

/** Exposure, in stops, at which all but the brightest hundredth of the object is below white. */
export function goodExposure(picture, state) {
  const values = picture.radiance(state, 200, 150), unit = picture.lights[state.light].unit, seen = [];
  for (let k = 0; k < values.length; k += 4) {
    if (values[k + 3] > 0.99) seen.push(Math.max(values[k], values[k + 1], values[k + 2]) / unit);
  }
  const bright = seen.sort((a, b) => a - b)[Math.floor(0.99 * (seen.length - 1))];
  return bright > 0 ? -Math.log2(bright) : 0;
}

/**
 * Returns a function that draws a state soon: one picture at a time, so that none queue up. Where a card takes longer
 * than `LONGEST`, pictures that move have fewer pixels.
 */
function fluent(picture, state) {
  const { canvas } = picture;
  let wanted = false, drawing = false, coarser = 0, settling = 0;
  const draw = (level) => {
    const ratio = Math.min(window.devicePixelRatio || 1, 2) / Math.SQRT2 ** level, start = performance.now();
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(Math.round(side * ratio), 1));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    picture.draw(state);
    drawing = true;
    wanted = false;
    const wait = () => {
      if (picture.busy()) return requestAnimationFrame(wait);
      const took = performance.now() - start;
      if (level === 0) coarser = Math.max(0, Math.min(COARSEST, Math.ceil(Math.log2(took / LONGEST))));
      else if (took > 1.3 * LONGEST) coarser = Math.min(coarser + 1, COARSEST);
      drawing = false;
      if (wanted) draw(coarser);
      else if (level > 0) settling = setTimeout(() => draw(0), SETTLED);
    };
    requestAnimationFrame(wait);
  };
  return () => {
    clearTimeout(settling);
    if (!wanted && !drawing) requestAnimationFrame(() => draw(coarser));
    wanted = true;
  };
}

/**
 * Lets people turn object, light and lamp. form : holds fields named light, turn, room, exposure, lamp, lampAzimuth,
 * lampElevation, lampStrength, and maybe filled; readout : where the radiance under the pointer is written. Returns a function that draws.
 */
export function control(picture, state, form, readout, onChange = () => {}) {
  const canvas = picture.canvas, field = (name) => form.elements.namedItem(name);
  const draw = fluent(picture, state), redraw = () => {
    onChange(state);
    draw();
  };
  const show = () => {
    for (const name of ["light", "turn", "room", "exposure"]) field(name).value = state[name];
    for (const output of form.querySelectorAll("output")) {
      const input = field(output.htmlFor.value);
      output.textContent = `${Number(input.value).toFixed(Number(input.step) < 1 ? 1 : 0)}${output.dataset.unit}`;
    }
    redraw();
  };
  const read = () => {
    const light = Number(field("light").value);
    if (light !== state.light) {
      state.light = light;
      field("exposure").value = goodExposure(picture, state);
    }
    for (const name of ["turn", "room", "exposure"]) state[name] = Number(field(name).value);
    state.filled = field("filled")?.checked ?? false;
    state.lamps = field("lamp").checked
      ? [{
        azimuth: Number(field("lampAzimuth").value),
        elevation: Number(field("lampElevation").value),
        strength: Number(field("lampStrength").value),
      }]
      : [];
    show();
  };
  const turnObject = (azimuth, elevation) => {
    turnView(state, azimuth, elevation);
    redraw();
  };
  const turnLight = (degrees) => {
    state.turn = around(state.turn + degrees);
    show();
  };
  const moveLamp = (azimuth, elevation) => {
    field("lamp").checked = true;
    field("lampAzimuth").value = around(Number(field("lampAzimuth").value) + azimuth);
    field("lampElevation").value = Math.max(-90, Math.min(90, Number(field("lampElevation").value) + elevation));
    read();
  };
  const zoom = (factor) => {
    state.zoom = Math.max(0.3, Math.min(12, state.zoom * factor));
    redraw();
  };
  form.addEventListener("input", read);
  form.addEventListener("submit", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons) {
      const across = event.movementX * FASTEST, down = event.movementY * FASTEST;
      if (event.shiftKey) turnLight(across);
      else if (event.altKey || event.buttons === 2) moveLamp(across, -down);
      else turnObject(-across, down);
    }
    probe(event);
  });
  const probe = (event) => {
    const { left, top, width, height } = canvas.getBoundingClientRect();
    const [columns, rows] = [Math.round(width), Math.round(height)];
    const column = Math.floor(event.clientX - left), row = Math.floor(event.clientY - top);
    if (event.buttons || column < 0 || row < 0 || column >= columns || row >= rows) return;
    const [red, green, blue, covered] = picture.pixel(state, columns, rows, column, row);
    readout.textContent = covered > 0.5 ? `radiance ${[red, green, blue].map((x) => (x / covered).toPrecision(3)).join(", ")}` : "";
  };
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 600));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const ways = { ArrowLeft: [-STEP, 0], ArrowRight: [STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP] };
    if (event.key in ways) {
      const [across, up] = ways[event.key];
      if (event.shiftKey) turnLight(across);
      else if (event.altKey) moveLamp(across, up);
      else turnObject(across, up);
    } else if (event.key === "+" || event.key === "=") zoom(1.15);
    else if (event.key === "-") zoom(1 / 1.15);
    else if (event.key === "0") Object.assign(state, { zoom: 1, turn: 0, room: 1, ...home }) && show();
    else return;
    event.preventDefault();
  });
  const home = { azimuth: state.azimuth, elevation: state.elevation };
  new ResizeObserver(redraw).observe(canvas);
  show();
  return show;
}
