// Marks on pictures: a numbered ring with a cross, to be seen on any ground.

export const MARK = "#ffd60a";

/** Draws a mark with its name at a place of a canvas, pixels. */
export function mark(context, x, y, name) {
  for (const [colour, width] of [["#000", 4], [MARK, 2]]) {
    context.strokeStyle = context.fillStyle = colour;
    context.lineWidth = width;
    context.beginPath();
    context.arc(x, y, 7, 0, 2 * Math.PI);
    context.moveTo(x - 11, y);
    context.lineTo(x + 11, y);
    context.moveTo(x, y - 11);
    context.lineTo(x, y + 11);
    context.stroke();
  }
  context.font = "bold 15px system-ui";
  context.lineWidth = 4;
  context.strokeStyle = "#000";
  context.strokeText(name, x + 10, y - 8);
  context.fillText(name, x + 10, y - 8);
}
