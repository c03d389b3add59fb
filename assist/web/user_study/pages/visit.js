// The page of the join link: each browser becomes one participant, always the same one.

import { Refused, address, askJson, newId, passes, place } from "../../pages/connection.js";

const at = (id) => document.getElementById(id);
const KEY = `kitassist visit ${place}`;

function kept() {
  try {
    return JSON.parse(localStorage.getItem(KEY));
  } catch {
    return null;
  }
}

function keep(visit) {
  try {
    localStorage.setItem(KEY, JSON.stringify(visit));
  } catch {
    // no storage: the address of the next page identifies the participant
  }
}

/** Participants sent by another system bring its id. With a signature they are the same participant on every device. */
function sent() {
  const id = new URLSearchParams(location.search).get("participant");
  return id ? `participant ${id}`.slice(0, 128) : null;
}

/** The key of this browser, without which nobody else can use an id that is not signed. */
function browserKey() {
  try {
    const key = localStorage.getItem(`${KEY} key`) ?? newId();
    localStorage.setItem(`${KEY} key`, key);
    return key;
  } catch {
    return newId(); // no storage: the address of the next page identifies the participant
  }
}

function bodyOf(id) {
  if (id !== sent()) return { id };
  const signature = new URLSearchParams(location.search).get("signature");
  return signature ? { id, signature } : { id, key: browserKey() };
}

function tell(text, { begin = null, before = null } = {}) {
  at("text").textContent = text;
  at("begin").hidden = begin === null;
  if (begin !== null) at("begin").textContent = begin;
  at("before").hidden = before === null;
  if (before !== null) at("before").href = before;
}

const wait = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

async function visit(id) {
  for (let pause = 250; ; pause = Math.min(2 * pause, 3000)) {
    try {
      return await askJson("/api/study/seats", { method: "POST", body: bodyOf(id) });
    } catch (error) {
      if (!passes(error)) throw error;
      tell("The study server cannot be reached. Trying again.");
      await wait(pause);
    }
  }
}

async function enter(id) {
  tell("One moment, please.");
  keep({ id });
  try {
    const seat = await visit(id);
    location.replace(address(seat.part));
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    if (error.status !== 409) tell(`This link is not valid: ${error.message}.`);
    else if (!error.message.includes("full")) tell(`Sorry, ${error.message}.`);
    else tell("The study is full at the moment. You can try again later, since places may become free.", { begin: "Try again" });
  }
}

/** In a laboratory, several participants use one browser. After one has finished, the next may begin. */
async function begin() {
  const id = sent() ?? kept()?.id ?? null;
  if (id === null) {
    await enter(newId());
    return;
  }
  try {
    const seat = await visit(id);
    if (sent() === null && ["thanks", "withdrew", "declined"].includes(seat.study.kind)) {
      next(seat);
      return;
    }
    location.replace(address(seat.part));
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    await enter(id);
  }
}

function next(seat) {
  tell("A participant has already used this browser. If you are the next participant, begin.", { begin: "Begin as the next participant", before: address(seat.part) });
}

/** Withdraw data by the code that the last page of the study showed. */
function withdraws() {
  tell("Your data will not appear in any table or result. This cannot be undone.");
  at("withdraw").hidden = false;
  at("withdraw").addEventListener("submit", async (event) => {
    event.preventDefault();
    try {
      await askJson("/api/study/withdrawals", { method: "POST", body: { code: at("code").value } });
      at("withdraw").hidden = true;
      tell("Your data are withdrawn. You can close this page.");
    } catch (error) {
      tell(error instanceof Refused ? `${error.message}.` : "The study server cannot be reached. Try again.");
    }
  });
}

at("begin").addEventListener("click", () => enter(sent() ?? newId()));
addEventListener("pageshow", (event) => event.persisted && location.reload());
askJson("/api/study/form").then((form) => {
  at("title").textContent = document.title = form.title;
}).catch(() => {});
if (new URLSearchParams(location.search).has("withdraw")) withdraws();
else begin();
