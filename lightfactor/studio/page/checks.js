// What a photograph is checked by: the object's outline where it is placed, and the samples that a fit takes.

import { lastAsked } from "./asking.js";
import { byId } from "./building.js";

const OUTLINE = "#00e5ff", SAMPLE = "60, 230, 120";

/** Draws checks over a view; returns what is called with the photograph that it shows, or null. */
export function checks(view) {
  const read = lastAsked();
  let photo = null, found = null;

  async function update() {
    const wanted = byId("show-outline").checked || byId("show-samples").checked, say = (text) => { byId("checks-said").textContent = text; };
    say("");
    if (wanted && photo && !found) {
      say("Drawing samples...");
      try {
        const answer = await read(`/api/photos/${photo.id}/checks`);
        if (!answer) return;
        found = { ...answer, path: outline(answer.arrays.covered) };
      } catch (error) {
        return say(error.message);
      }
    }
    if (wanted && found) {
      const overlap = found.overlap === null ? "" : ` Mask and mesh have ${(100 * found.overlap).toFixed(1)}% of what they cover in common.`;
      const weighs = byId("show-samples").checked ? ", brighter where they weigh more" : "";
      say(`A fit takes ${found.arrays.samples.shape[0]} samples of it${weighs}.${overlap}`);
    }
    view.draw();
  }

  view.over((context) => {
    if (!found) return;
    const [width, height] = view.shared.size, scale = view.scale(), { covered, samples } = found.arrays;
    const [left, top] = [view.canvas.width / 2 - scale * view.shared.x, view.canvas.height / 2 - scale * view.shared.y];
    if (byId("show-samples").checked) {
      const [across, down] = [(scale * width) / photo.width, (scale * height) / photo.height], size = Math.max(1.5, 0.6 * across);
      for (let k = 0; k < samples.data.length; k += 3) {
        const [column, row, weight] = samples.data.subarray(k, k + 3);
        context.fillStyle = `rgba(${SAMPLE}, ${0.25 + 0.75 * weight})`;
        context.fillRect(left + across * (column + 0.5) - size / 2, top + down * (row + 0.5) - size / 2, size, size);
      }
    }
    if (byId("show-outline").checked) {
      const [across, down] = [(scale * width) / covered.shape[1], (scale * height) / covered.shape[0]];
      context.setTransform(across, 0, 0, down, left, top);
      Object.assign(context, { strokeStyle: OUTLINE, lineWidth: (2 * (window.devicePixelRatio || 1)) / across });
      context.stroke(found.path);
      context.resetTransform();
    }
  });
  for (const id of ["show-outline", "show-samples"]) byId(id).addEventListener("change", update);
  return (shown) => {
    [photo, found] = [shown, null];
    update();
  };
}

/** Sides between what is covered and what isn't, as one path; units are the array's rows and columns. */
function outline({ data, shape: [height, width] }) {
  const path = new Path2D(), inside = (row, column) => row >= 0 && column >= 0 && row < height && column < width && data[row * width + column] > 0;
  const side = (x, y, right, down) => {
    path.moveTo(x, y);
    path.lineTo(x + right, y + down);
  };
  for (let row = 0; row <= height; row++) {
    for (let column = 0; column <= width; column++) {
      const here = inside(row, column);
      if (here !== inside(row, column - 1)) side(column, row, 0, 1);
      if (here !== inside(row - 1, column)) side(column, row, 1, 0);
    }
  }
  return path;
}
