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

const TEXTS = { "page.incomplete": "Use the complete link.", "a.step": "{n} steps", "a.step_one": "{n} step", "a.of": "{done} of {all}" };

class Storage extends Map {
  getItem = (key) => this.get(key) ?? null;
  setItem = (key, value) => this.set(key, value);
  removeItem = (key) => this.delete(key);
}

/** A socket that a test opens, feeds and closes. */
export class Socket {
  static CONNECTING = 0;
  static OPEN = 1;
  static all = [];
  readyState = 0;
  constructor(url, protocols) {
    Object.assign(this, { url, protocols });
    Socket.all.push(this);
  }

  opens() {
    this.readyState = 1;
    this.onopen();
  }

  close(code = 1000) {
    this.readyState = 3;
    this.onclose({ code });
  }
}

/** Open a page at a path of the service; `fetch` answers its requests. Returns the page's modules and what it stores. */
export async function open(path, { fetch = () => new Response("{}"), language = "en", stored = new Storage() } = {}) {
  const elements = { texts: { textContent: JSON.stringify(TEXTS) } };
  const url = new URL(`.${path}`, `${pathToFileURL(folder)}/`);
  const asked = [];
  Socket.all = [];
  const named = (id) => (elements[id] ??= { textContent: "", hidden: true, scrollIntoView() {} });
  Object.assign(globalThis, {
    document: { documentElement: { lang: language }, getElementById: named, addEventListener() {}, hidden: false },
    location: url,
    history: { state: null, replaceState: (_state, _title, address) => Object.assign(globalThis, { location: new URL(address) }) },
    sessionStorage: stored,
    WebSocket: Socket,
    addEventListener() {},
    async fetch(address, options) {
      asked.push({ path: new URL(address).href.slice(`${pathToFileURL(folder)}`.length), ...options });
      return fetch(asked.at(-1), asked.length);
    },
  });
  const query = `?${Math.random()}`; // each page has its own modules
  const files = ["pages/page.js", "pages/connection.js", "user_study/pages/questions.js"];
  const modules = await Promise.all(files.map((file) => import(pathToFileURL(join(folder, file)) + query)));
  return { ...Object.assign({}, ...modules), elements, asked, stored };
}
