// What the pages' modules need of a browser, for tests without one.

import { cpSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const folder = mkdtempSync(join(tmpdir(), "kitassist-pages-"));
cpSync(new URL("../../assist/web/pages/", import.meta.url), join(folder, "pages"), { recursive: true });
cpSync(new URL("../../assist/web/user_study/pages/", import.meta.url), join(folder, "user_study", "pages"), { recursive: true });
writeFileSync(join(folder, "package.json"), '{"type": "module"}'); // they are modules, as in the pages
process.on("exit", () => rmSync(folder, { recursive: true }));

const TEXTS = { "page.incomplete": "Use the complete link.", "page.cookies": "The cookies are too large.", "a.step": "{n} steps", "a.step_one": "{n} step", "a.of": "{done} of {all}" };

class Storage extends Map {
  getItem = (key) => this.get(key) ?? null;
  setItem = (key, value) => this.set(key, value);
  removeItem = (key) => this.delete(key);
}

/** The answer of a stream that a test feeds and ends. */
export function stream() {
  let controller;
  const body = new ReadableStream({ start: (own) => { controller = own; } });
  const bytes = new TextEncoder();
  const breaks = () => controller.error(new TypeError("network"));
  return {
    answer: Object.assign(new Response(body), { breaks }),
    tell: (kind, data) => controller.enqueue(bytes.encode(`event: ${kind}\ndata: ${JSON.stringify(data)}\n\n`)),
    piece: (text) => controller.enqueue(bytes.encode(text)),
    ends: () => controller.close(),
    breaks,
  };
}

/** The windows of a browser hear each other. */
class Windows {
  static all = [];
  constructor() {
    Windows.all.push(this);
  }

  postMessage(data) {
    for (const other of Windows.all) if (other !== this) other.onmessage({ data });
  }
}

const pages = [];

/** Leave all pages. */
export function leave() {
  for (const happens of pages.splice(0)) happens("pagehide");
}

/** Open a page at a path of the service; `fetch` answers its requests. Returns the page's modules and what it stores. */
export async function open(path, { fetch = () => new Response("{}"), language = "en", stored = new Storage(), lines = {} } = {}) {
  const elements = { texts: { textContent: JSON.stringify(TEXTS) }, lines: { textContent: JSON.stringify(lines) } };
  const url = new URL(`.${path}`, `${pathToFileURL(folder)}/`);
  const asked = [];
  const listeners = {};
  const listen = (kind, act) => (listeners[kind] ??= []).push(act);
  Windows.all = [];
  const named = (id) => (elements[id] ??= { textContent: "", hidden: true, scrollIntoView() {} });
  Object.assign(globalThis, {
    document: { documentElement: { lang: language }, getElementById: named, addEventListener: listen, hidden: false, body: null, activeElement: null },
    location: url,
    history: { state: null, replaceState: (_state, _title, address) => Object.assign(globalThis, { location: new URL(address) }) },
    sessionStorage: stored,
    BroadcastChannel: Windows,
    addEventListener: listen,
    async fetch(address, options) {
      asked.push({ path: new URL(address).href.slice(`${pathToFileURL(folder)}`.length), ...options });
      const answer = fetch(asked.at(-1), asked.length);
      options.signal?.addEventListener("abort", () => answer.breaks?.());
      return answer;
    },
  });
  const query = `?${Math.random()}`; // each page has its own modules
  const files = ["pages/page.js", "pages/connection.js", "user_study/pages/questions.js"];
  const modules = await Promise.all(files.map((file) => import(pathToFileURL(join(folder, file)) + query)));
  const happens = (kind, first = Infinity) => listeners[kind]?.slice(0, first).forEach((act) => act({}));
  pages.push(happens);
  return { ...Object.assign({}, ...modules), elements, asked, stored, happens };
}
