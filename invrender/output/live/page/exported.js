// The page that `lightfactor export --format html` writes: everything it shows is in it.

import { control, goodExposure, initialState } from "./controls.js";
import { unpacked } from "./packed.js";
import { Picture } from "./picture.js";

/** Bytes of base64 text. */
function bytes(text) {
  return Uint8Array.from(atob(text.trim()), (letter) => letter.charCodeAt(0));
}

async function start() {
  const said = document.getElementById("state");
  try {
    const subject = await unpacked(bytes(document.getElementById("subject").textContent));
    const picture = new Picture(document.getElementById("picture"), subject);
    for (const element of document.querySelectorAll("script.light")) picture.add(await unpacked(bytes(element.textContent)));
    const state = initialState(subject.camera);
    state.exposure = goodExposure(picture, state);
    control(picture, state, document.getElementById("controls"), document.getElementById("readout"));
    // For whoever wants numbers: radiance (height, width, 4) from a state, in the console.
    window.lightfactor = { picture, state };
    said.textContent = "";
  } catch (error) {
    said.textContent = `The object can't be shown: ${error.message}`;
    throw error;
  }
}

start();
