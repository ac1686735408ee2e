// The mask of a photograph while a person draws it: what it started from, and the shapes that were drawn since.

import { asked } from "./asking.js";

// Shapes that aren't saved yet, by photograph: they stay when another one is chosen.
const unsaved = new Map();

window.addEventListener("beforeunload", (event) => {
  if ([...unsaved.values()].some((shapes) => shapes.length)) event.preventDefault();
});

/** Draws { adds, polygon } or { adds, size, line }, in pixels of the photograph; points before the first are drawn already. */
function drawShape(context, { adds, polygon = [], size, line = [] }, first = 0) {
  context.fillStyle = context.strokeStyle = adds ? "#fff" : "#000";
  Object.assign(context, { lineWidth: size, lineCap: "round" });
  context.beginPath();
  polygon.forEach((corner) => context.lineTo(...corner));
  context.fill();
  // Piece by piece, as a hand draws it: edges of a whole line differ by a shade.
  for (let k = first; k < line.length; k++) {
    context.beginPath();
    context.arc(...line[k], size / 2, 0, 2 * Math.PI);
    context.fill();
    context.beginPath();
    context.moveTo(...line[Math.max(k - 1, 0)]);
    context.lineTo(...line[k]);
    context.stroke();
  }
}

/**
 * White where the object is; grey levels at edges are partial cover.
 *
 * While it is drawn it is as large as the picture that is shown, so that a stroke is fast and memory small. Only to be
 * saved is it drawn at the photograph's own size, from the same shapes.
 */
export class DrawnMask {
  /** width, height : of the picture that is shown. */
  constructor(photo, width, height) {
    if (!unsaved.has(photo.id)) unsaved.set(photo.id, []);
    const context = new OffscreenCanvas(width, height).getContext("2d", { alpha: false });
    Object.assign(this, { photo, context, shapes: unsaved.get(photo.id), ready: false, former: null, base: null });
    /** Pixels of the photograph per pixel of the picture, across and down. */
    this.ratio = [photo.width / width, photo.height / height];
  }

  /** Reads what it starts from: the photograph's mask if it has one, or no object at all. */
  async start() {
    if (this.photo.hasMask) {
      this.former = await (await asked(`/api/photos/${this.photo.id}/mask`)).blob();
      const { width, height } = this.context.canvas;
      this.base = await this.formerPicture({ resizeWidth: width, resizeHeight: height, resizeQuality: "medium" });
    }
    this.ready = true;
    this.drawAll(this.context, this.base);
  }

  formerPicture(options = {}) {
    return createImageBitmap(this.former, { colorSpaceConversion: "none", ...options });
  }

  drawAll(context, base) {
    const { width, height } = this.photo;
    context.setTransform(context.canvas.width / width, 0, 0, context.canvas.height / height, 0, 0);
    context.fillStyle = "#000";
    context.fillRect(0, 0, width, height);
    if (base) context.drawImage(base, 0, 0, width, height);
    this.shapes.forEach((shape) => drawShape(context, shape));
  }

  add(shape) {
    this.shapes.push(shape);
    drawShape(this.context, shape);
  }

  extend(stroke, point) {
    stroke.line.push(point);
    drawShape(this.context, stroke, stroke.line.length - 1);
  }

  /** Takes back the last shapes, one unless said otherwise. */
  undo(count = 1) {
    this.shapes.splice(Math.max(this.shapes.length - count, 0));
    this.drawAll(this.context, this.base);
  }

  /** Sends it to be kept; returns the name of its file. Shapes that are drawn meanwhile stay unsaved. */
  async save() {
    const { id, width, height } = this.photo, base = this.former && await this.formerPicture();
    const count = this.shapes.length, canvas = new OffscreenCanvas(width, height);
    this.drawAll(canvas.getContext("2d", { alpha: false }), base);
    const body = await canvas.convertToBlob({ type: "image/png" });
    const { name } = await (await asked(`/api/photos/${id}/mask`, { method: "POST", body })).json();
    this.shapes.splice(0, count);
    return name;
  }
}
