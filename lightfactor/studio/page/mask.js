// Drawing a photograph's mask, by polygon and by brush, with the pointer or the keyboard.

import { byId, shown } from "./building.js";
import { DrawnMask } from "./drawnmask.js";
import { drawMask, onScreen } from "./maskview.js";

// Pixels of the page: how near a click is to a corner, and how far an arrow key moves.
const NEAR = 6, STEP = 10;
const HINTS = {
  off: "",
  polygon: "Violet is left out. Click corner by corner. A double click or Enter closes the polygon; Escape drops its corners. Keys: arrows move the cross, with Shift by one pixel; Space sets a corner; Backspace undoes.",
  brush: "Violet is left out. Drag to draw; drag with Shift to move the picture. Keys: arrows move the brush, with Shift by one pixel; Space draws there; Backspace undoes.",
};
const setSize = shown(byId("brush-size"), () => redraw());
// edited : the chosen photograph's mask. corners : of the polygon that isn't closed yet. at : the pointer's place or the
// cross's. All places are pixels of the photograph, but for `from`: the page's, where a click began.
let view = null, changed = () => {}, edited = null, corners = [], stroke = null, from = null, at = null, waits = false;

const chosen = (name) => document.querySelector(`input[name=${name}]:checked`).value;
const drawing = () => chosen("mask-tool") !== "off";
const brushSize = () => Number(byId("brush-size").value);
const say = (text) => { byId("mask-said").textContent = text; };

/** Whether the mask is shown as it is drawn, in place of the one that is saved. */
export const showsMask = () => Boolean(edited?.ready) && (drawing() || edited.shapes.length > 0);

/** No photograph, until one is opened. */
export function closeMask() {
  edited = stroke = from = at = null;
  corners = [];
}

/** A photograph, of which a picture of a size is shown. */
export function openMask(photo, width, height) {
  closeMask();
  if (byId("mask-tools").dataset.photo !== photo.id) say("");
  byId("mask-tools").dataset.photo = photo.id;
  edited = new DrawnMask(photo, width, height);
  const size = byId("brush-size"), most = Math.max(Math.round(Math.max(photo.width, photo.height) / 4), 2);
  if (Number(size.max) !== most) {
    size.max = most;
    setSize(Math.ceil(most / 6));
  }
  begin();
}

/** Reads the mask once it is drawn; who only looks has it with the photograph. */
async function begin() {
  const mine = edited;
  if (mine && !mine.ready && (drawing() || mine.shapes.length)) {
    byId("mask-hint").textContent = "Reading the mask...";
    try {
      await mine.start();
    } catch (error) {
      say(error.message);
    }
    if (mine !== edited) return;
  }
  update();
}

function update() {
  const count = edited?.shapes.length ?? 0, tool = chosen("mask-tool");
  const empty = edited?.ready && !edited.photo.hasMask && !count;
  byId("mask-more").hidden = !drawing() && !count;
  byId("mask-size").hidden = tool !== "brush";
  byId("mask-hint").textContent = `${empty ? "There is no mask yet: draw where the object is. " : ""}${HINTS[tool]}`;
  byId("mask-undo").disabled = byId("mask-discard").disabled = !count && !corners.length;
  byId("mask-save").disabled = !count || corners.length > 0;
  changed();
}

function add(shape) {
  const whole = { ...shape, adds: chosen("mask-adds") === "add" };
  edited.add(whole);
  say("");
  update();
  return whole;
}

function close() {
  if (corners.length < 3) return say("A polygon has three corners or more.");
  const polygon = corners;
  corners = [];
  add({ polygon });
}

function setCorner(point) {
  const [x, y] = onScreen(view, edited, point);
  const near = (corner) => {
    const [otherX, otherY] = onScreen(view, edited, corner);
    return Math.hypot(x - otherX, y - otherY) < NEAR * (window.devicePixelRatio || 1);
  };
  // The second click of a double click is no corner of its own.
  if (corners.length && near(corners.at(-1))) return;
  if (corners.length > 2 && near(corners[0])) return close();
  corners.push(point);
  say("");
  update();
}

function undo() {
  if (corners.length) corners.pop();
  else if (edited?.ready) edited.undo();
  update();
}

function discard() {
  corners = [];
  if (edited?.ready) edited.undo(edited.shapes.length);
  update();
}

async function save() {
  const mine = edited;
  byId("mask-save").disabled = true;
  say("Saving...");
  try {
    say(`Saved as ${await mine.save()}.`);
    document.dispatchEvent(new CustomEvent("changed", { detail: mine.photo.id }));
  } catch (error) {
    say(error.message);
    update();
  }
}

/** Once per frame, however often the pointer moves. */
function redraw() {
  if (waits || !view) return;
  waits = true;
  requestAnimationFrame(() => { waits = false; view.draw(); });
}

const inPhoto = (event) => view.pixel(event).map((value, k) => value * edited.ratio[k]);

function pressed(event) {
  if (event.button || event.shiftKey) return;
  at = inPhoto(event);
  if (chosen("mask-tool") === "brush") stroke = add({ size: brushSize(), line: [at] });
  else from = [event.clientX, event.clientY];
}

function moved(event) {
  at = inPhoto(event);
  if (stroke) {
    // The picture stays: this is no drag of it.
    event.stopImmediatePropagation();
    edited.extend(stroke, at);
  } else if (from && Math.hypot(event.clientX - from[0], event.clientY - from[1]) > NEAR) from = null;
  redraw();
}

function released() {
  if (from) setCorner(at);
  from = stroke = null;
}

function keyed(event) {
  const step = event.shiftKey ? 1 : (STEP * (window.devicePixelRatio || 1) * edited.ratio[0]) / view.scale();
  const move = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] }[event.key];
  const { width, height } = edited.photo, [x, y] = at ?? [width / 2, height / 2];
  if (move) {
    at = [Math.min(Math.max(x + move[0], 0), width), Math.min(Math.max(y + move[1], 0), height)];
    redraw();
  } else if (event.key === " ") {
    at = [x, y];
    if (chosen("mask-tool") === "brush") add({ size: brushSize(), line: [at] });
    else setCorner(at);
  } else if (event.key === "Enter" && corners.length) close();
  else if (event.key === "Escape" && corners.length) {
    corners = [];
    update();
  } else if (event.key === "Backspace" || (event.key === "z" && (event.ctrlKey || event.metaKey))) undo();
  else return;
  event.preventDefault();
  event.stopImmediatePropagation();
}

/** Lets masks be drawn in a view of photographs; redrawn is called where the picture below them may be another. */
export function drawsMasks(over, redrawn) {
  [view, changed] = [over, redrawn];
  view.over((context) => {
    if (!showsMask()) return;
    const brush = chosen("mask-tool") === "brush" ? brushSize() : 0;
    drawMask(view, context, edited, { corners, brush, at: drawing() ? at : null, adds: chosen("mask-adds") === "add" });
  });
  const closing = () => { if (corners.length) close(); };
  const handlers = { pointerdown: pressed, pointermove: moved, pointerup: released, keydown: keyed, dblclick: closing };
  for (const [name, handler] of Object.entries(handlers)) {
    // Before the view's own, which move the picture.
    view.canvas.addEventListener(name, (event) => { if (drawing() && edited?.ready) handler(event); }, { capture: true });
  }
  view.canvas.addEventListener("lostpointercapture", () => { from = stroke = null; });
  const radios = (name, act) => document.querySelectorAll(`input[name=${name}]`).forEach((each) => each.addEventListener("change", act));
  radios("mask-tool", () => { corners = []; begin(); });
  radios("mask-adds", redraw);
  for (const [id, act] of [["mask-undo", undo], ["mask-save", save], ["mask-discard", discard]]) byId(id).addEventListener("click", act);
  update();
}
