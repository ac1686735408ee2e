// A mask over a photograph: what it leaves out is dark violet, its outline yellow; and what is being drawn.

const OUTSIDE = "#3c1a66", OUTLINE = "#ffd60a", ADDS = "#ffd60a", TAKES = "#ff6a5e";
// Canvases as large as the screen's, for the mask as it lies there and for what is made of it.
const layers = [0, 1].map(() => new OffscreenCanvas(1, 1).getContext("2d"));

/** Where the photograph lies on a view's canvas: pixels of the canvas per pixel of it, and its corner. */
function placed(view, { ratio }) {
  const { canvas, shared } = view, scale = view.scale(), [across, down] = ratio.map((each) => scale / each);
  return [across, 0, 0, down, canvas.width / 2 - scale * shared.x, canvas.height / 2 - scale * shared.y];
}

/** A place in the photograph, pixels, on a view's canvas. */
export function onScreen(view, edited, [u, v]) {
  const [across, , , down, x, y] = placed(view, edited);
  return [across * u + x, down * v + y];
}

/** Draws a mask over a view's picture. brush : its diameter, 0 for none; at : the cross's place, or null. */
export function drawMask(view, context, edited, { corners, brush, at, adds }) {
  const { canvas } = view, place = placed(view, edited), { width, height } = edited.photo;
  const [seen, other] = layers;
  for (const layer of layers) {
    Object.assign(layer.canvas, { width: canvas.width, height: canvas.height });
    layer.setTransform(...place);
  }
  seen.imageSmoothingEnabled = view.scale() < 2;
  seen.drawImage(edited.context.canvas, 0, 0, width, height);
  const fill = (mode, colour) => {
    other.globalCompositeOperation = mode;
    other.fillStyle = colour;
    other.fillRect(0, 0, width, height);
  };
  const lay = (on, mode, layer, x = 0, y = 0) => {
    on.save();
    on.resetTransform();
    on.globalCompositeOperation = mode;
    on.drawImage(layer.canvas, x, y);
    on.restore();
  };
  context.save();
  context.beginPath();
  context.rect(place[4], place[5], place[0] * width, place[3] * height);
  context.clip();
  context.globalAlpha = 0.6;
  lay(context, "multiply", seen);
  context.globalAlpha = 1;
  lay(other, "copy", seen);
  fill("difference", "#fff");
  fill("multiply", OUTSIDE);
  lay(context, "lighter", other);
  // The outline is where the mask differs from itself, moved by its thickness.
  const thick = 2 * (window.devicePixelRatio || 1);
  for (const [x, y] of [[thick, 0], [0, thick]]) {
    lay(other, "copy", seen);
    lay(other, "difference", seen, x, y);
    // Black first: added to white, yellow would be white.
    fill("difference", "#fff");
    lay(context, "multiply", other);
    fill("difference", "#fff");
    fill("multiply", OUTLINE);
    lay(context, "lighter", other);
  }
  context.restore();
  drawTool(context, corners.map((corner) => onScreen(view, edited, corner)), at && onScreen(view, edited, at), place[0] * brush / 2, adds);
}

/** The corners that are set and the cross, or the brush, in dark and bright, so that they show on anything. */
function drawTool(context, corners, at, radius, adds) {
  for (const [colour, width] of [["#000", 4], [adds ? ADDS : TAKES, 2]]) {
    context.strokeStyle = context.fillStyle = colour;
    context.lineWidth = width;
    context.beginPath();
    corners.forEach((corner) => context.lineTo(...corner));
    if (corners.length && at) context.lineTo(...at);
    context.stroke();
    for (const [x, y] of corners) context.fillRect(x - 3 - width / 2, y - 3 - width / 2, 6 + width, 6 + width);
    if (!at) continue;
    const [x, y] = at, arm = radius || 9;
    context.beginPath();
    if (radius) context.arc(x, y, radius, 0, 2 * Math.PI);
    else for (const [dx, dy] of [[arm, 0], [0, arm]]) {
      context.moveTo(x - dx, y - dy);
      context.lineTo(x + dx, y + dy);
    }
    context.stroke();
  }
}
