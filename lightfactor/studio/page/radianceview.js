// Pictures of radiance on canvases that zoom and move together.

import { cleared } from "./building.js";

/** What several canvases share: the middle of what they show, pixels, and how large a pixel is there. */
export class SharedView {
  constructor() {
    this.views = [];
    this.size = [1, 1];
    this.reset();
  }

  /** All of a picture of a size. */
  fit(width, height) {
    if (this.size[0] !== width || this.size[1] !== height) {
      this.size = [width, height];
      this.reset();
    }
  }

  reset() {
    Object.assign(this, { x: this.size[0] / 2, y: this.size[1] / 2, zoom: 1 });
  }

  redraw() {
    this.views.forEach((view) => view.draw());
  }
}

/** A canvas of a shared view. onProbe(column, row) is called with the pixel under the pointer. */
export class RadianceView {
  constructor(canvas, shared, onProbe = () => {}) {
    Object.assign(this, { canvas, shared, bitmap: null, overlays: [] });
    shared.views.push(this);
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const [column, row] = this.pixel(event), factor = Math.exp(-event.deltaY / 500);
      const zoom = Math.max(1, Math.min(60, shared.zoom * factor)), kept = shared.zoom / zoom;
      shared.x = column + (shared.x - column) * kept;
      shared.y = row + (shared.y - row) * kept;
      shared.zoom = zoom;
      shared.redraw();
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) {
        const scale = this.scale() / (window.devicePixelRatio || 1);
        shared.x -= event.movementX / scale;
        shared.y -= event.movementY / scale;
        shared.redraw();
      }
      const [column, row] = this.pixel(event).map(Math.floor);
      if (column >= 0 && row >= 0 && column < shared.size[0] && row < shared.size[1]) onProbe(column, row);
    });
    canvas.addEventListener("keydown", (event) => {
      const step = 40 / this.scale(), moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
      if (event.key in moves) {
        shared.x += moves[event.key][0];
        shared.y += moves[event.key][1];
      } else if (event.key === "+" || event.key === "=") shared.zoom = Math.min(60, shared.zoom * 1.25);
      else if (event.key === "-") shared.zoom = Math.max(1, shared.zoom / 1.25);
      else if (event.key === "0") shared.reset();
      else return;
      event.preventDefault();
      shared.redraw();
    });
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  /** Shows codes (h, w, 4) of a picture. */
  show(codes, width, height) {
    this.bitmap = new OffscreenCanvas(width, height);
    this.bitmap.getContext("2d").putImageData(new ImageData(codes, width, height), 0, 0);
    this.shared.fit(width, height);
    this.draw();
  }

  /** Has something drawn over the picture, with the canvas's context, whenever this is drawn. */
  over(draw) {
    this.overlays.push(draw);
  }

  /** Shows nothing: what comes may be broken, and this is no longer it. */
  clear() {
    this.bitmap = null;
    cleared(this.canvas);
  }

  /** Canvas pixels per pixel of the picture. */
  scale() {
    const [width, height] = this.shared.size;
    return Math.min(this.canvas.width / width, this.canvas.height / height) * this.shared.zoom;
  }

  pixel(event) {
    const { left, top, width } = this.canvas.getBoundingClientRect(), ratio = this.canvas.width / width, scale = this.scale();
    return [
      ((event.clientX - left) * ratio - this.canvas.width / 2) / scale + this.shared.x,
      ((event.clientY - top) * ratio - this.canvas.height / 2) / scale + this.shared.y,
    ];
  }

  draw() {
    if (!this.bitmap || !this.canvas.clientWidth) return;
    const { context, width, height } = cleared(this.canvas), scale = this.scale();
    context.imageSmoothingEnabled = scale < 2;
    context.setTransform(scale, 0, 0, scale, width / 2 - scale * this.shared.x, height / 2 - scale * this.shared.y);
    context.drawImage(this.bitmap, 0, 0);
    context.resetTransform();
    this.overlays.forEach((draw) => draw(context));
  }
}

/** sRGB code of linear light, 1 being white. */
export function code(linear) {
  if (!(linear > 0)) return 0;
  return Math.round(255 * (linear < 0.0031308 ? 12.92 * linear : 1.055 * Math.min(linear, 1) ** (1 / 2.4) - 0.055));
}

/** A level that all but the brightest hundredth of a picture's values is below. */
export function whiteLevel(values) {
  const step = Math.max(1, Math.floor(values.length / 30000)), some = [];
  for (let k = 0; k < values.length; k += step) some.push(values[k]);
  some.sort((a, b) => a - b);
  return Math.max(some[Math.floor(0.995 * (some.length - 1))], 1e-12);
}

/** Codes (h, w, 4) of radiance (h, w, 3) with a level as white. */
export function exposed(radiance, white) {
  const count = radiance.length / 3, codes = new Uint8ClampedArray(4 * count);
  for (let k = 0; k < count; k++) {
    for (let c = 0; c < 3; c++) codes[4 * k + c] = code(radiance[3 * k + c] / white);
    codes[4 * k + 3] = 255;
  }
  return codes;
}
