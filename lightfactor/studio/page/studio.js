// The workbench: tabs over one set and the result that is chosen. All state lies on the server's disk.

import { askedJson, posted } from "./asking.js";
import { byId, element } from "./building.js";
import { openSet } from "./capture.js";
import { listFits, showResults, startFit } from "./fits.js";
import { judge } from "./judge.js";
import { openPicking } from "./pick.js";
import { openPlan } from "./plan.js";
import { openRegions } from "./regions.js";
import { relight } from "./relight.js";

const tabs = [...document.querySelectorAll("[role=tab]")];
let opened = null, result = null;

function say(problem) {
  byId("problem").hidden = !problem;
  byId("problem").textContent = problem;
}

function select(tab) {
  for (const each of tabs) {
    each.setAttribute("aria-selected", each === tab);
    each.tabIndex = each === tab ? 0 : -1;
    byId(each.getAttribute("aria-controls")).hidden = each !== tab;
  }
  show();
}

/** Fills the panel that is in sight. */
async function show() {
  const [tab] = tabs.filter((each) => each.getAttribute("aria-selected") === "true");
  try {
    if (tab.id === "tab-pick") await openPicking(opened.set);
    if (tab.id === "tab-fit") openRegions(opened.set, result);
    if (tab.id === "tab-fit" && result) await showResults(opened.results, result.id);
    if (tab.id === "tab-judge" && result) judge(result);
    if (tab.id === "tab-plan" && result) await openPlan(result, opened);
    if (tab.id === "tab-relight" && result) await relight(result);
  } catch (error) {
    say(error.message);
  }
}

/** Reads what is open anew; chosen : the name of the result to choose, if it is there. */
async function load(chosen, photo) {
  const first = opened === null || photo;
  opened = await askedJson("/api/state");
  document.title = `${opened.set?.name ?? opened.folder} - lightfactor studio`;
  byId("title").textContent = opened.set?.name ?? opened.folder;
  say(opened.problem);
  const choice = byId("result"), wanted = chosen ?? opened.results.find((each) => each.first)?.name;
  const kept = choice.value;
  choice.replaceChildren(...opened.results.map(({ id, name }) => element("option", { value: id }, name)));
  const found = opened.results.find((each) => each.name === wanted) ?? opened.results.find((each) => each.id === kept) ?? opened.results.at(-1);
  byId("chosen").hidden = !found;
  if (found) {
    choice.value = found.id;
    result = await askedJson(`/api/results/${found.id}`);
  }
  for (const tab of tabs) if (["tab-judge", "tab-relight"].includes(tab.id)) tab.disabled = !found;
  byId("tab-plan").disabled = !found || !opened.set;
  byId("tab-pick").hidden = opened.set?.shape !== "mesh";
  if (first && opened.set) openSet(opened.set, photo);
  offer(opened.starter);
  const busy = opened.fits.some((fit) => fit.state === "running");
  byId("start-fit").disabled = !opened.set || busy;
  byId("start-plan").disabled = busy;
  listFits(opened.fits, (fit) => load(fit.hasResult ? fit.name : undefined));
  await show();
}

/** Offers to write the manifest that a folder of photographs lacks. */
function offer(starter) {
  byId("starter").hidden = !starter;
  if (!starter) return;
  for (const tab of tabs) tab.disabled = true;
  byId("capture").hidden = true;
  const { photos, meshes } = starter, form = byId("manifest");
  byId("starter-photos").textContent = `${photos.length} photographs: ${photos.slice(0, 4).join(", ")}${photos.length > 4 ? ", ..." : ""}`;
  form.elements.namedItem("mesh").append(...meshes.map((name) => element("option", { value: name }, name)));
}

byId("manifest").addEventListener("submit", async (event) => {
  event.preventDefault();
  const said = Object.fromEntries(new FormData(event.target));
  try {
    await posted("/api/manifest", { ...said, focal: said.focal ? Number(said.focal) : null });
    location.reload();
  } catch (error) {
    say(error.message);
  }
});
for (const tab of tabs) tab.addEventListener("click", () => select(tab));
document.querySelector("[role=tablist]").addEventListener("keydown", (event) => {
  const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
  if (!step) return;
  const usable = tabs.filter((tab) => !tab.disabled && !tab.hidden), now = usable.indexOf(document.activeElement);
  const next = usable[(now + step + usable.length) % usable.length];
  next.focus();
  select(next);
});
byId("result").addEventListener("change", () => load(byId("result").selectedOptions[0].textContent).catch((error) => say(error.message)));
byId("start").addEventListener("submit", async (event) => {
  event.preventDefault();
  try {
    await startFit();
    await load();
  } catch (error) {
    say(error.message);
  }
});
document.addEventListener("changed", ({ detail }) => load(undefined, detail).catch((error) => say(error.message)));
load().catch((error) => say(error.message));
