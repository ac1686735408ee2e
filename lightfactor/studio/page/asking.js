// Asks the server, with the token that stands behind the # of the address.

import { unpacked } from "./packed.js";

const token = location.hash.slice(1) || sessionStorage.getItem("lightfactor-token") || "";
sessionStorage.setItem("lightfactor-token", token);

/** The answer to a request; an error says what the server says is wrong. */
export async function asked(path, options = {}) {
  const answer = await fetch(path, { ...options, headers: { "X-Lightfactor-Token": token } });
  if (answer.ok) return answer;
  const text = await answer.text();
  let said = text;
  try {
    said = JSON.parse(text).error;
  } catch {
    // Refusals before the program are plain text.
  }
  throw new Error(said);
}

export const askedJson = async (path, options) => (await asked(path, options)).json();
export const askedBytes = async (path, options) => (await asked(path, options)).arrayBuffer();
export const posted = (path, body = {}) => asked(path, { method: "POST", body: JSON.stringify(body) });

/** A reader of packed answers, which gives null for all but what it was asked for last, whatever came of it. */
export function lastAsked() {
  let number = 0;
  return async (path) => {
    const mine = ++number;
    try {
      const found = await unpacked(await askedBytes(path));
      return mine === number ? found : null;
    } catch (error) {
      if (mine === number) throw error;
      return null;
    }
  };
}

/** Lines of JSON of an answer, as they come. */
export async function* lines(path) {
  const reader = (await asked(path)).body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    const parts = (rest + value).split("\n");
    rest = parts.pop();
    for (const part of parts) yield JSON.parse(part);
  }
}
