// Starts fits, shows how they go on, and what they found, side by side.

import { askedJson, lines, posted } from "./asking.js";
import { byId, element, row } from "./building.js";

const watched = new Map();
// Where each kind of job is listed.
const LISTS = { fit: "fits", alignment: "alignments", plan: "plans" };

/** Lists the fits that were started; whenDone is called when one ends with a result. */
export function listFits(fits, whenDone) {
  for (const fit of fits) {
    if (!watched.has(fit.id)) {
      const item = element("li");
      watched.set(fit.id, item);
      byId(LISTS[fit.name.split("-")[0]]).prepend(item);
      show(item, fit);
      if (fit.state === "running") watch(item, fit, whenDone);
    }
  }
}

async function watch(item, fit, whenDone) {
  try {
    for await (const now of lines(`/api/fits/${fit.id}/progress`)) {
      show(item, now);
      if (now.state !== "running") whenDone(now);
    }
  } catch (error) {
    item.append(element("p", { className: "problem" }, `The server is gone (${error.message}); the fit goes on. Load the page again.`));
  }
}

function show(item, fit) {
  const head = element("div", { className: "head" }, element("strong", {}, fit.name), element("span", { className: "status" }, fit.state));
  const parts = [head];
  if (fit.state === "running") {
    const stop = element("button", { type: "button" }, "Stop");
    stop.addEventListener("click", () => posted(`/api/fits/${fit.id}/cancel`));
    head.append(stop);
    const { doing = "Starting", done = 0, of = 1, outcomes = [] } = fit.progress ?? {};
    parts.push(
      element("span", {}, fit.progress ? `${doing}: ${done} of ${of}` : doing),
      element("progress", { value: done, max: Math.max(of, 1), "aria-label": doing }),
      ...(outcomes.length ? [element("span", { className: "muted" }, "Models so far, and their error on unseen photographs:")] : []),
      element("ol", { className: "ladder" }, ...outcomes.map((outcome) => element("li", {}, outcome))),
    );
  } else if (fit.said) {
    parts.push(element("details", { open: fit.state === "failed" }, element("summary", {}, "What it said"), element("pre", {}, fit.said)));
  }
  item.replaceChildren(...parts);
}

/** Shows results side by side: those that are ticked, the chosen one at first. */
export async function showResults(results, chosen) {
  const choices = byId("compare"), ticked = new Set([...choices.querySelectorAll("input:checked")].map((input) => input.value));
  ticked.add(chosen);
  choices.hidden = results.length < 2;
  choices.replaceChildren(element("legend", {}, "Results side by side"), ...results.map(({ id, name }) => {
    const input = element("input", { type: "checkbox", value: id, checked: ticked.has(id) });
    input.addEventListener("change", fill);
    return element("label", { className: "check" }, input, name);
  }));
  await fill();
}

async function fill() {
  const ids = [...byId("compare").querySelectorAll("input:checked")].map((input) => input.value);
  const found = await Promise.all(ids.map((id) => askedJson(`/api/results/${id}`)));
  byId("results").replaceChildren(...found.map(article));
}

function article(result) {
  const numbers = result.numbers.map(({ label, text, status, reason, remedy }) => {
    const line = row(label, text);
    line.append(element("td", {}, element("span", { className: `status ${status.replace(" ", "-")}` }, status)));
    if (reason) line.append(element("td", {}, `${reason}; to settle it: ${remedy}`));
    return line;
  });
  const percent = (share) => (share === null ? "" : `${(100 * share).toFixed(2)}%`);
  const models = result.models.map((model) => {
    const line = row(model.name, percent(model.unseen), `${model.parameters}`);
    if (model.chosen) line.className = "chosen";
    return line;
  });
  const { fitted, unseen, heldOut } = result.errors;
  const errors = [["fitted", fitted], ["unseen", unseen], ["held out", heldOut]].filter(([, error]) => error !== null);
  return element(
    "article", {},
    element("h2", {}, `${result.name}: ${result.lobe}`),
    element("table", {}, row("parameter", "value ± std", "status", "why"), ...numbers),
    element("p", { className: "muted" }, `Scale: ${result.gauge}. Error on photographs (relative RMS): ${errors.map(([kind, error]) => `${percent(error)} ${kind}`).join(", ")}.`),
    ...result.warnings.map((warning) => element("p", { className: "warning" }, warning)),
    element("h2", {}, "Models that were tried"),
    element("table", {}, row("model", "error on unseen photographs", "numbers"), ...models),
  );
}

/** Starts a fit; an error says why it can't be. */
export async function startFit() {
  await posted("/api/fits", { samples: Number(byId("samples").value) });
}
