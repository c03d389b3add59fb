// What the pages share: elements, messages, and texts and numbers in the page's language.

/** The element of an id. @type {<Id extends string>(id: Id) => Id extends keyof Elements ? Elements[Id] : HTMLElement} */
export const at = (id) => /** @type {any} */ (document.getElementById(id));

/** The first element of a selector, which has one. @type {(selector: string, within?: ParentNode) => any} */
export const first = (selector, within = document) => within.querySelector(selector);

/** All elements of a selector. @type {(selector: string, within?: ParentNode) => any[]} */
export const all = (selector, within = document) => [...within.querySelectorAll(selector)];

/** The element that has the focus. @type {() => HTMLElement | null} */
export const focused = () => /** @type {HTMLElement | null} */ (document.activeElement);

export const language = document.documentElement.lang;
const TEXTS = JSON.parse(at("texts").textContent); // the service writes them into the page

/** The text of a key, with names in braces replaced. If `n` is 1, the text for one is taken. */
export function text(key, values = {}) {
  const own = values.n === 1 && `${key}_one` in TEXTS ? `${key}_one` : key;
  return TEXTS[own].replace(/\{(\w+)\}/g, (_, name) => values[name]);
}

const LINES = JSON.parse(at("lines").textContent); // the declared lines of each page

/** What a line says of a value: an action without its parentheses, and names with weights below 1. */
function said(value) {
  if (typeof value === "string") return value.replace(/^\(|\)$/g, "");
  if (value === null || typeof value !== "object") return value;
  return Object.entries(value).map(([name, weight]) => weight < 1 ? `${name} (${weight.toFixed(2)})` : name).join(", ");
}

/**
 * The lines of a view that a page shows: what each field says that is there, and how many events were reported that
 * can be taken back. `undo` returns a button for the last event of a kind.
 * @type {(page: string, view: any, undo: (kind: string) => HTMLElement) => HTMLElement[]}
 */
export function lines(page, view, undo) {
  const [fields, events] = LINES[page].map((part, of) => Object.entries(part).map(([name, words]) => [name, words, of ? view.done?.[name] : view[name]])
    .filter(([, , value]) => value));
  const line = ([name, words, value], ...more) => element("p", { "data-line": name }, words.replace("{value}", () => said(value)), ...more);
  return [...fields.map((one) => line(one)), ...events.map((one) => line(one, " ", undo(one[0])))];
}

/** A number as it is written in the page's language, with so many digits after the decimal sign, or as many as it has. */
export const figure = (value, digits = -1) => value.toLocaleString(language, {
  minimumFractionDigits: Math.max(digits, 0), maximumFractionDigits: digits < 0 ? 6 : digits, useGrouping: false,
});

/** A refusal of the service as a sentence. */
export const sentence = (why) => `${why.charAt(0).toUpperCase()}${why.slice(1)}${/[.!?]$/.test(why) ? "" : "."}`;

let pressed = false;
const held = []; // what is done after the release

function press() {
  pressed = true;
}

function release() {
  setTimeout(() => { // after the click
    pressed = false;
    for (const act of held.splice(0)) act();
  });
}
addEventListener("pointerdown", press, true);
addEventListener("keydown", (event) => event.key === " " && press(), true); // a key that clicks when it is released
for (const ends of ["pointerup", "pointercancel", "keyup", "contextmenu"]) addEventListener(ends, release, true);
addEventListener("blur", release);

/** Redraw now, or after the release of what is pressed: a button that is redrawn meanwhile would miss its click. */
export function released(redraw) {
  if (pressed) held.push(redraw);
  else redraw();
}

/** A promise that is kept after some milliseconds. */
export const wait = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

/**
 * What the browser keeps under a key, in this tab or for all; null if there is nothing, or no storage.
 * @param {string} key
 * @param {"sessionStorage" | "localStorage"} where
 */
export function recall(key, where = "sessionStorage") {
  try {
    return JSON.parse(globalThis[where].getItem(key) ?? "null");
  } catch {
    return null;
  }
}

/**
 * Keep a value under a key, or nothing if it is null; without storage it is lost when the page is closed.
 * @param {string} key
 * @param {unknown} value
 * @param {"sessionStorage" | "localStorage"} where
 */
export function keep(key, value, where = "sessionStorage") {
  try {
    if (value === null) globalThis[where].removeItem(key);
    else globalThis[where].setItem(key, JSON.stringify(value));
  } catch {
    // no storage
  }
}

/** Forget what this tab keeps under keys that begin so. */
export function forget(beginning) {
  try {
    for (const key of Object.keys(sessionStorage)) if (key.startsWith(beginning)) sessionStorage.removeItem(key);
  } catch {
    // no storage
  }
}

/**
 * The token behind the # of a link, and the parameters that were appended to it, as recruiting services do; signs that a
 * copy has added are left out.
 * @type {(hash: string) => [string, URLSearchParams]}
 */
export function behind(hash) {
  const [, token, more] = /** @type {string[]} */ (/^#?([\w-]{0,32})(.*)$/s.exec(hash));
  let rest = more;
  try {
    rest = decodeURIComponent(more);
  } catch {
    // no such encoding: as it is
  }
  return [token, new URLSearchParams(/[?&](.*)$/s.exec(rest)?.[1] ?? "")];
}

/** Minutes and seconds. */
export const clock = (seconds) => `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, "0")}`;

/** What a click does; the second click of a double click, which may meet another button, does nothing. */
export const single = (act) => (event) => {
  if (event.detail <= 1) act();
};

export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "click") made.addEventListener("click", value);
    else if (value === true) made.setAttribute(key, "");
    else if (value !== false && value !== null) made.setAttribute(key, value);
  }
  made.append(...children.filter((child) => child !== null));
  return made;
}

/** Show what keeps the service from its work, once, so that screen readers announce it once. @type {(faults: string[]) => void} */
export function report(faults) {
  const words = faults.join(" ");
  if (at("fault").textContent !== words) at("fault").textContent = words;
  at("fault").hidden = !words;
}

/** Show what is wrong, or nothing more. */
export function complain(why) {
  const problem = at("problem");
  const isNew = why && problem.textContent !== why;
  problem.textContent = why ?? "";
  problem.hidden = !why;
  if (isNew) problem.scrollIntoView({ block: "nearest" });
}
