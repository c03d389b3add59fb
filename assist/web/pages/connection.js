// Connection to the service: a stream of events that is opened again whenever it ends, and requests that are repeated
// under the same id until they are answered, even after the page was reloaded.

import { at, behind, complain, focused, keep, recall, released, report, sentence, text, wait } from "./page.js";

const root = new URL("../", import.meta.url); // address of the service, under any path
const parts = location.pathname.slice(root.pathname.length).split("/").filter(Boolean);
const seat = ["join", "part"].includes(parts[0]); // the page of one person
const conducts = parts[0] === "operator" || (parts[0] === "study" && parts[1] === "operator");
export const person = seat ? decodeURIComponent(parts[1] ?? "") : "";
const subject = conducts ? "operator" : `person ${person || "?"}`;

/** Names what this browser stores for the page. */
export const place = `${root.pathname} ${subject}`;

const [secret, appended] = behind(location.hash);

// The token of the link; null if there is a cookie.
let token = secret || null;

/** The parameters of the link, before the token or behind it. */
export const parameters = new URLSearchParams([...new URLSearchParams(location.search), ...appended]);

/** What names the caller: the token, or the cookie that is used in its place. @type {() => Record<string, string>} */
const credentials = () => (token === null ? { "Kitassist-Caller": encodeURIComponent(subject) } : { Authorization: `Bearer ${token}` });

// Whether requests carry cookies. A request with a token goes without them where those of other programs are too large.
/** @type {"same-origin" | "omit"} */
let cookies = "same-origin";

/** Whether a server or a proxy refuses a request for its size, which is that of its cookies. */
const isTooLarge = (answer) => [400, 431].includes(answer.status) && !answer.headers.get("Content-Type")?.includes("json");

/** Send a request with the token or the cookie. @type {(path: string, options?: RequestInit) => Promise<Response>} */
async function send(path, options = {}) {
  const attempt = () => fetch(address(path), { ...options, headers: { ...credentials(), ...options.headers }, credentials: cookies });
  const answer = await attempt();
  if (token === null || cookies === "omit" || !isTooLarge(answer)) return answer;
  cookies = "omit";
  return attempt();
}

/** The refusal that an answer is. */
async function refusalOf(answer) {
  let detail = isTooLarge(answer) ? text("page.cookies") : `${answer.status} ${answer.statusText}`;
  try {
    detail = (await answer.json()).detail ?? detail;
  } catch {
    // no JSON: use the status line
  }
  return new Refused(answer.status, String(answer.status === 401 ? text("page.incomplete") : detail));
}

/** Exchange the token for a cookie, and remove it from the address. Without cookies the page goes on with the token. */
async function exchange() {
  const own = { "Kitassist-Caller": encodeURIComponent(subject) };
  try {
    const set = await fetch(address("/api/session"), { method: "POST", headers: credentials(), signal: AbortSignal.timeout(SILENCE) });
    if (!set.ok || !(await fetch(address("/api/me"), { headers: own, signal: AbortSignal.timeout(SILENCE) })).ok) return;
    token = null;
    history.replaceState(history.state, "", address(`/${parts.join("/")}`) + search());
  } catch {
    // the service cannot be reached: the token stays
  }
}

/** The parameters as a part of an address. */
function search() {
  const all = parameters.toString().replaceAll("=&", "&").replace(/=$/, "");
  return all && `?${all}`;
}

const FASTEST = 200; // milliseconds before the first attempt to connect again
const SLOWEST = 3000; // milliseconds between two later attempts
const SILENCE = 10000; // milliseconds after which a request counts as lost
const PATIENCE = 8 / 3; // a stream counts as lost after so many times without a sign of life
const STEADY = 5000; // milliseconds after which a stream counts as one that lasts
const MOST = 4; // streams of a browser, which opens six connections to a server at a time

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
  const answer = await send(path, {
    method,
    headers: body === undefined ? {} : { "Content-Type": "application/json" },
    body: body === undefined ? undefined : JSON.stringify(body),
    signal: AbortSignal.timeout(silence),
  });
  if (answer.ok) return answer;
  throw await refusalOf(answer);
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
    /** @type {HTMLElement | null} */
    this.from = null; // what had the focus when a request was sent
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
    this.from = focused();
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
    // A button loses the focus while it is disabled.
    if (focused() === document.body && this.from?.isConnected) this.from.focus({ preventScroll: true });
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

/**
 * Yield the events of a stream, with their data. `heard` is called with every sign of life.
 * @type {(body: ReadableStream<Uint8Array>, heard: () => void) => AsyncGenerator<[string, any]>}
 */
async function* eventsOf(body, heard) {
  const [reader, decoder] = [body.getReader(), new TextDecoder()];
  for (let rest = ""; ;) {
    const { done, value } = await reader.read();
    if (done) return;
    heard();
    const parts = (rest + decoder.decode(value, { stream: true })).split("\n\n");
    rest = parts.pop() ?? "";
    for (const part of parts) {
      const found = /^event: (.*)\ndata: (.*)$/.exec(part);
      if (found) yield [found[1], JSON.parse(found[2])];
    }
  }
}

/**
 * A stream that is opened again whenever it ends, or nothing is heard of it. A hidden page has none, unless it `stays`;
 * nor has the window that was not used for longest if the browser shows more than `MOST`.
 */
export class Channel {
  /**
   * @param {string} path
   * @param {{ message: (kind: string, data: any) => void, state: (state: string, refused?: Refused) => void, stays?: () => boolean }} tells
   *     `state`: "connected", "lost", "resting" or "over"
   */
  constructor(path, { message, state, stays = () => false }) {
    this.path = path;
    this.message = message;
    this.state = state;
    this.stays = stays;
    this.pause = FASTEST;
    this.over = false;
    this.resting = false;
    /** @type {AbortController | null} */
    this.stream = null;
    this.timer = 0;
    this.name = newId();
    this.newer = new Set(); // windows that were used since this one
    this.windows = new BroadcastChannel(`kitassist ${root.pathname}`);
    this.windows.onmessage = ({ data }) => this.noted(data);
    addEventListener("online", () => this.open());
    document.addEventListener("visibilitychange", () => (document.hidden ? this.stays() || this.close() : this.hurry()));
    addEventListener("pageshow", () => this.hurry());
    addEventListener("pagehide", () => this.close());
    for (const used of ["focus", "pointerdown", "keydown"]) addEventListener(used, () => this.resting && this.open());
    this.open();
  }

  /** Open the stream now, unless there is one. */
  hurry() {
    if (this.stream === null || this.timer) this.open();
  }

  close() {
    clearTimeout(this.timer);
    this.timer = 0;
    if (this.stream !== null) this.windows.postMessage({ closed: this.name });
    this.stream?.abort();
    this.stream = null;
  }

  end() {
    this.over = true;
    this.close();
  }

  open() {
    this.close();
    if (this.over || (document.hidden && !this.stays())) return;
    this.resting = false;
    this.newer.clear();
    this.windows.postMessage({ opened: this.name });
    this.stream = new AbortController();
    this.read(this.stream);
  }

  /** Take in that another window has opened or closed its stream. */
  noted({ opened, closed }) {
    this.newer.delete(closed);
    if (opened) this.newer.add(opened);
    if (this.stream === null || this.newer.size < MOST) return;
    this.close();
    this.resting = true;
    this.state("resting");
  }

  async read(own) {
    const began = performance.now();
    let [limit, silent, connected, timer] = [SILENCE, false, false, 0];
    const heard = () => {
      clearTimeout(timer);
      timer = setTimeout(() => {
        silent = true;
        own.abort();
      }, limit);
    };
    heard();
    let refused;
    try {
      const answer = await send(this.path, { signal: own.signal, cache: "no-store" });
      if (answer.ok && answer.body) {
        const events = eventsOf(answer.body, heard);
        for (let next = await events.next(); !next.done && own === this.stream; next = await events.next()) {
          const [kind, data] = next.value;
          if (!connected) this.state("connected");
          connected = true;
          if (kind === "ping") limit = 1000 * PATIENCE * data.seconds;
          else this.tell(kind, data);
          heard();
        }
      } else refused = await refusalOf(answer);
    } catch {
      // the service cannot be reached, or not any more
    }
    clearTimeout(timer);
    if (own !== this.stream) return;
    if (connected && performance.now() - began > STEADY) this.pause = FASTEST;
    this.ended(silent || !connected, refused);
  }

  /** A fault of the page is no fault of the stream. */
  tell(kind, data) {
    try {
      this.message(kind, data);
    } catch (error) {
      reportError(error);
    }
  }

  /** Open the stream again after a pause; say that it is lost, unless it was one that a proxy ends from time to time. */
  ended(lost, refused) {
    if (refused && [401, 403, 404].includes(refused.status)) {
      this.end();
      this.state("over", refused);
      return;
    }
    if (lost) this.state("lost", refused);
    this.timer = setTimeout(() => this.open(), this.pause * (0.75 + Math.random() / 2));
    this.pause = Math.min(2 * this.pause, SLOWEST);
  }
}

let [state, faults] = ["connecting", /** @type {string[]} */ ([])];

/**
 * Show the state of the connection, and what keeps the service from its work; what is not given stays.
 * @type {(change: { state?: string, faults?: string[], refused?: Refused }) => void}
 */
export function show(change) {
  ({ state, faults } = { state, faults, ...change });
  const words = text(state === "connected" && faults.length ? "page.faulty" : `page.${state}`);
  if (at("connection").textContent !== words) at("connection").textContent = words;
  at("connection").classList.toggle("lost", state !== "connected" || faults.length > 0);
  report(faults);
  if (change.refused) complain(sentence(change.refused.message));
}

/**
 * Keep the view of the page's person current; return a function that asks for it now.
 * @param {Outbox} outbox
 * @param {{ take: (view: any) => void, gone: (why: string) => void, over?: () => void, stays?: () => boolean }} tells
 *     `over`: the person has left
 */
export function follow(outbox, { take, gone, over, stays }) {
  async function refresh() {
    try {
      take(await askJson(pathOf(person)));
    } catch (error) {
      if (error instanceof Refused && [401, 403, 404].includes(error.status)) {
        channel.end();
        ends(error);
      }
    }
  }
  function ends(refused) {
    show({ state: "over" });
    if (refused.status === 404 && over) over();
    else gone(text("page.invalid_because", { why: sentence(refused.message) }));
  }
  const channel = new Channel(pathOf(person, "/events"), {
    stays,
    message(kind, data) {
      if (kind === "view") released(() => take(data));
      else if (kind === "faults") show({ faults: data });
    },
    state(state, refused) {
      if (state === "over") ends(refused);
      else show({ state, refused });
      if (state === "connected") outbox.resume();
    },
  });
  return refresh;
}

if (token !== null) exchange();
addEventListener("hashchange", () => location.reload()); // another link was opened in this tab
