// The page of the join link: each browser becomes one participant, always the same one.

import { Refused, address, askJson, newId, parameters, passes, place } from "../../pages/connection.js";
import { at, keep, recall, sentence, text, wait } from "../../pages/page.js";

const KEY = `kitassist visit ${place}`;

/** Participants sent by another system bring its id. With a signature they are the same participant on every device. */
function sent() {
  const id = parameters.get("participant");
  return id ? `participant ${id}` : null;
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
  const signature = parameters.get("signature");
  return signature ? { id, signature } : { id, key: browserKey() };
}

function tell(words, { begin = "", before = "" } = {}) {
  at("text").textContent = words;
  at("begin").hidden = !begin;
  if (begin) at("begin").textContent = begin;
  at("before").hidden = !before;
  if (before) at("before").href = before;
}

async function visit(id) {
  for (let pause = 250; ; pause = Math.min(2 * pause, 3000)) {
    try {
      return await askJson("/api/study/seats", { method: "POST", body: bodyOf(id) });
    } catch (error) {
      if (!passes(error)) throw error;
      tell(text("study.unreachable"));
      await wait(pause);
    }
  }
}

async function enter(id) {
  tell(text("study.wait"));
  keep(KEY, { id }, "localStorage"); // without storage, the address of the next page identifies the participant
  try {
    const seat = await visit(id);
    location.replace(address(seat.part));
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    const why = sentence(error.message);
    if (error.status === 409) tell(why, { begin: text("study.try_again") });
    else tell(text("page.invalid_because", { why }));
  }
}

/** In a laboratory, several participants use one browser. After one has finished, the next may begin. */
async function begin() {
  const id = sent() ?? recall(KEY, "localStorage")?.id ?? null;
  if (id === null) {
    await enter(newId());
    return;
  }
  try {
    const seat = await visit(id);
    if (sent() === null && ["thanks", "unmatched", "withdrew", "declined"].includes(seat.study.kind)) {
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
  tell(text("study.next"), { begin: text("study.begin_next"), before: address(seat.part) });
}

/** Withdraw data by the code that the last page of the study showed. */
function withdraws() {
  tell(text("study.withdraw_text"));
  at("withdraw").hidden = false;
  at("withdraw").addEventListener("submit", async (event) => {
    event.preventDefault();
    try {
      await askJson("/api/study/withdrawals", { method: "POST", body: { code: at("code").value } });
      at("withdraw").hidden = true;
      tell(text("study.withdrawn"));
    } catch (error) {
      tell(error instanceof Refused ? sentence(error.message) : text("study.unreachable_now"));
    }
  });
}

at("begin").addEventListener("click", () => enter(sent() ?? newId()));
addEventListener("pageshow", (event) => event.persisted && location.reload());
askJson("/api/study/form").then((form) => {
  at("title").textContent = document.title = form.title;
}).catch(() => {});
if (parameters.has("withdraw")) withdraws();
else begin();
