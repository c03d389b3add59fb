// Connection to the service: a socket that reconnects, and requests that are repeated under the same id until they are
// answered, even after the page was reloaded.

import { at, behind, keep, recall, sentence, text, wait } from "./page.js";

const root = new URL("../", import.meta.url); // address of the service, under any path
const parts = location.pathname.slice(root.pathname.length).split("/").filter(Boolean);
const seat = ["join", "part"].includes(parts[0]); // the page of one person
const conducts = parts[0] === "operator" || (parts[0] === "study" && parts[1] === "operator");
const depth = seat || (conducts && parts[0] === "study") ? 2 : 1; // parts of the path without a token
export const person = seat ? decodeURIComponent(parts[1] ?? "") : "";
const subject = conducts ? "operator" : `person ${person || "?"}`;

/** Names what this browser stores for the page. */
export const place = `${root.pathname} ${subject}`;

const [secret, appended] = behind(location.hash);

// The token of the link, behind # or, in links of earlier versions, at the end of the path; null if there is a cookie.
let token = secret || parts[depth] || null;

/** The parameters of the link, before the token or behind it. */
export const parameters = new URLSearchParams([...new URLSearchParams(location.search), ...appended]);

/** What names the caller: the token, or the cookie that is used in its place. @type {() => Record<string, string>} */
const credentials = () => (token === null ? { "Kitassist-Caller": encodeURIComponent(subject) } : { Authorization: `Bearer ${token}` });
const protocol = () => (token === null ? `caller.${encodeURIComponent(subject)}` : `token.${token}`);

/** Exchange the token for a cookie, and remove it from the address. Without cookies the page goes on with the token. */
async function exchange() {
  const own = { "Kitassist-Caller": encodeURIComponent(subject) };
  try {
    const set = await fetch(address("/api/session"), { method: "POST", headers: credentials(), signal: AbortSignal.timeout(SILENCE) });
    if (!set.ok || !(await fetch(address("/api/me"), { headers: own, signal: AbortSignal.timeout(SILENCE) })).ok) return;
    token = null;
    history.replaceState(history.state, "", address(`/${parts.slice(0, depth).join("/")}`) + search());
  } catch {
    // the service cannot be reached: the token stays
  }
}

/** The parameters as a part of an address. */
function search() {
  const all = parameters.toString().replaceAll("=&", "&").replace(/=$/, "");
  return all && `?${all}`;
}

const SLOWEST = 3000; // milliseconds between two attempts to connect
const SILENCE = 10000; // milliseconds after which a request counts as lost

/** Milliseconds for a request that reads or rewrites all data. */
export const LONG = 600000;

export class Refused extends Error {
  constructor(status, detail) {
    super(detail);
    this.status = status;
  }
}

/** The address of a path of the service. */
export const address = (path) => new URL(path.slice(1), root).href;

/** The address of another page of the same person. */
export const pageOf = (kind, query = "") => address(`/${kind}/${encodeURIComponent(person)}${query}${token === null ? "" : `#${token}`}`);

export function pathOf(name, rest = "") {
  return `/api/people/${encodeURIComponent(name)}${rest}`;
}

/**
 * Send a request once. Throws Refused if the service refuses it, and another error if the service is not reached.
 * @param {string} path
 * @param {{ method?: string, body?: object, silence?: number }} options `silence`: milliseconds after which it counts as lost
 */
export async function ask(path, { method = "GET", body, silence = SILENCE } = {}) {
  const answer = await fetch(address(path), {
    method,
    headers: { ...credentials(), ...(body === undefined ? {} : { "Content-Type": "application/json" }) },
    body: body === undefined ? undefined : JSON.stringify(body),
    signal: AbortSignal.timeout(silence),
  });
  if (answer.ok) return answer;
  let detail = `${answer.status} ${answer.statusText}`;
  try {
    detail = (await answer.json()).detail ?? detail;
  } catch {
    // no JSON: use the status line
  }
  if (answer.status === 401) detail = text("page.incomplete");
  throw new Refused(answer.status, String(detail));
}

/** @type {(path: string, options?: { method?: string, body?: object }) => Promise<any>} */
export const askJson = async (path, options) => (await ask(path, options)).json();

/** Whether an error is temporary, so that the request may succeed later. */
export const passes = (error) => !(error instanceof Refused) || error.status > 500 || [408, 425, 429].includes(error.status);

/** Why something is not sent yet: what the service says, or that it cannot be reached. */
export const unsent = (error) => (error instanceof Refused ? text("page.not_saved", { why: sentence(error.message) }) : text("page.not_sent"));

export function newId() {
  const bytes = crypto.getRandomValues(new Uint8Array(12));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Sends one request at a time. An unanswered request survives a reload and is sent again under the same id. */
export class Outbox {
  constructor(name, { answered, refused, waiting }) {
    this.key = `kitassist ${name} ${place}`;
    this.answered = answered;
    this.refused = refused;
    this.waiting = waiting;
    this.running = false;
    this.kept = recall(this.key);
  }

  get busy() {
    return this.kept !== null;
  }

  keep(request) {
    this.kept = request;
    keep(this.key, request);
  }

  send(path, body) {
    if (this.busy) return false;
    this.keep({ path, body: { ...body, id: newId() } });
    this.resume();
    return true;
  }

  async resume() {
    if (this.running || this.kept === null) return;
    this.running = true;
    const tell = await this.deliver(this.kept);
    this.keep(null);
    this.running = false;
    tell();
  }

  /** Repeat a request until it is answered or refused; return what tells the page. */
  async deliver({ path, body }) {
    for (let pause = 250; ; pause = Math.min(2 * pause, SLOWEST)) {
      try {
        const answer = await askJson(path, { method: "POST", body });
        return () => this.answered(answer, body);
      } catch (error) {
        if (!passes(error)) return () => this.refused(error, path);
        this.waiting(error);
        await wait(pause);
      }
    }
  }
}

/** One socket at a time. The late end of an old socket is ignored. */
export class Channel {
  constructor(path, { message, state }) {
    this.path = path;
    this.message = message;
    this.state = state;
    this.pause = 200;
    this.over = false;
    /** @type {WebSocket | null} */
    this.socket = null;
    this.timer = 0;
    addEventListener("online", () => this.hurry());
    document.addEventListener("visibilitychange", () => document.hidden || this.hurry());
    addEventListener("pageshow", () => this.hurry());
    this.open();
  }

  hurry() {
    if (this.over || this.socket?.readyState === WebSocket.OPEN) return;
    this.pause = 200;
    clearTimeout(this.timer);
    this.open();
  }

  open() {
    if (this.socket?.readyState === WebSocket.CONNECTING) return;
    const socket = new WebSocket(address(this.path).replace(/^http/, "ws"), ["kitassist", protocol()]);
    this.socket = socket;
    socket.onopen = () => {
      if (socket !== this.socket) return;
      this.pause = 200;
      this.state("connected");
    };
    socket.onmessage = (event) => {
      if (socket === this.socket) this.message(JSON.parse(event.data));
    };
    socket.onclose = (event) => {
      if (socket === this.socket && !this.over) this.closed(event.code);
    };
  }

  closed(code) {
    if ([4401, 4403, 4404].includes(code)) {
      this.over = true;
      this.state("over", code);
      return;
    }
    this.state("lost");
    this.timer = setTimeout(() => this.open(), this.pause * (0.75 + Math.random() / 2));
    this.pause = Math.min(2 * this.pause, SLOWEST);
  }

  end() {
    this.over = true;
    clearTimeout(this.timer);
    this.socket?.close();
  }
}

/**
 * Keep the view of the page's person current; return a function that asks for it now.
 * @param {Outbox} outbox
 * @param {{ take: (view: any) => void, gone: (why: string) => void, over?: () => void }} tells `over`: the person has left
 */
export function follow(outbox, { take, gone, over }) {
  async function refresh() {
    try {
      take(await askJson(pathOf(person)));
    } catch (error) {
      if (error instanceof Refused && [401, 403, 404].includes(error.status)) {
        channel.end();
        at("connection").textContent = text("page.over");
        gone(text("page.invalid_because", { why: sentence(error.message) }));
      }
    }
  }
  const channel = new Channel(pathOf(person, "/events"), {
    message: take,
    state(state) {
      at("connection").textContent = text(`page.${state}`);
      at("connection").classList.toggle("lost", state !== "connected");
      if (state === "connected") outbox.resume();
      else if (state === "over" && over) over();
      else refresh();
    },
  });
  return refresh;
}

if (token !== null) exchange();
addEventListener("hashchange", () => location.reload()); // another link was opened in this tab
