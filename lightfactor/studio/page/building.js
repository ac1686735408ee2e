// Elements of the page, from text that is never taken for markup.

export const byId = (id) => document.getElementById(id);

/** An element with properties and children; strings become text. */
export function element(name, properties = {}, ...children) {
  const result = document.createElement(name);
  for (const [key, value] of Object.entries(properties)) {
    if (key.startsWith("aria-") || key === "role") result.setAttribute(key, value);
    else result[key] = value;
  }
  result.append(...children);
  return result;
}

/** A table row of texts, the first a heading. */
export function row(heading, ...texts) {
  return element("tr", {}, element("th", {}, heading), ...texts.map((text) => element("td", { className: "number" }, text)));
}

/** Shows a range's value beside it, now and whenever it changes. */
export function shown(input, changed = () => {}) {
  const output = document.querySelector(`output[for="${input.id}"]`);
  const show = () => { output.textContent = `${input.value}${output.dataset.unit}`; };
  input.addEventListener("input", () => { show(); changed(Number(input.value)); });
  show();
  return (value) => { input.value = value; show(); };
}

/** Colours for channels, red, green and blue, that differ in lightness, too. */
export const COLOURS = ["#c0392b", "#2e8b57", "#2f6fd0"];

/** A canvas as sharp as the screen, cleared; returns its context and size. */
export function cleared(canvas) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const width = Math.max(Math.round(canvas.clientWidth * ratio), 1), height = Math.max(Math.round(canvas.clientHeight * ratio), 1);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  context.clearRect(0, 0, width, height);
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(name).trim();
  return { context, width, height, ratio, ink: colour("--ink"), muted: colour("--muted"), line: colour("--line"), stage: colour("--stage") };
}
