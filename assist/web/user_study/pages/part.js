// A participant's page: consent, instructions, questionnaires and the end. It redirects to the page of tasks.

import { Outbox, askJson, follow, passes, pageOf, person, place, unsent } from "../../pages/connection.js";
import { all, at, complain, element, forget, keep, language, recall, sentence, text } from "../../pages/page.js";
import { Questions } from "./questions.js";

const own = (rest) => `/api/study/participants/${encodeURIComponent(person)}/${rest}`;
const TASKS = ["practice", "task"];
const LEAVING = "leaving";
const LAST = ["thanks", "unmatched", "declined", "withdrew"]; // nothing is answered after these

let form = null; // texts and questionnaires of the study
let view = null; // the latest view from the service
let shown = null; // the stage that the page shows, or LEAVING

// Answers that are not sent yet survive a reload.

const draftKey = () => `kitassist draft ${place} ${view.study.stage}`;

function questionnaire(study) {
  const asked = form.questionnaires[study.what];
  const questions = new Questions(asked.items, study.items, recall(draftKey()) ?? {}, (answers) => keep(draftKey(), answers));
  title(asked.title);
  if (asked.introduction) at("body").append(element("p", {}, asked.introduction));
  at("form").append(...questions.elements(), buttons([text("page.continue"), null]));
  at("form").onsubmit = (event) => {
    event.preventDefault();
    const wrong = questions.check();
    if (wrong) at("said").textContent = text("study.missing", { n: wrong });
    else onward({ ...questions.answers });
  };
}

// The other stages.

function title(heading) {
  at("stage-title").textContent = heading;
  document.title = `${heading}: ${form.title}`;
}

/** The first button submits the form; each further button has its own action. */
function buttons([word, _], ...others) {
  return element("p", { class: "buttons" }, element("button", { type: "submit", class: "main" }, word), ...others.map(([other, click]) => element("button", { type: "button", click }, other)));
}

function page(heading, name, ...words) {
  title(heading);
  at("body").innerHTML = form.texts[name]; // written by the researchers and converted to HTML by the service; scripts in it do not run
  at("form").append(buttons(...words));
  at("form").onsubmit = (event) => {
    event.preventDefault();
    onward(null);
  };
}

function plain(heading, ...lines) {
  title(heading);
  at("body").append(...lines.map((line) => element("p", {}, line)));
}

function ends(study, heading = text("study.thanks"), words = form.texts.thanks) {
  title(heading);
  at("body").innerHTML = words;
  const code = element("input", { readonly: true, value: study.completion, id: "code", size: study.completion.length + 1 });
  const copy = element("button", { type: "button" }, text("study.copy"));
  copy.addEventListener("click", async () => {
    code.select();
    try {
      await navigator.clipboard.writeText(code.value);
      at("said").textContent = text("study.copied");
    } catch {
      at("said").textContent = text("study.selected");
    }
  });
  at("body").append(element("p", { class: "code" }, element("label", { for: "code" }, text("study.code")), code, copy), element("p", {}, text("study.close")));
  askJson(own("withdrawal")).then(({ code, address: place, until }) => {
    const day = until === null ? "" : new Date(until).toLocaleDateString(language, { dateStyle: "long", timeZone: "UTC" });
    const link = element("a", { href: place }, place); // the text names the address for those who write it down
    const words = text(day ? "study.later_until" : "study.later", { day, code, address: "\n" }).split("\n");
    at("body").append(element("p", { class: "hint", id: "withdrawal" }, words[0], link, ...words.slice(1)));
  }).catch(() => {}); // the page works without it
}

/** A page whose button lets the participant return. */
function again(heading, words, word) {
  plain(heading, words);
  at("form").append(buttons([word, null]));
  at("form").onsubmit = (event) => {
    event.preventDefault();
    send("return", {});
  };
}

const STAGES = {
  consent: () => page(text("study.consent"), "consent", [text("study.agree"), null], [text("study.disagree"), () => send("withdraw", {})]),
  instructions: () => page(text("study.instructions"), "instructions", [text("page.continue"), null]),
  questionnaire,
  waiting: () => plain(text("study.waiting"), text("study.waiting_text")),
  unmatched: (study) => ends(study, text("study.unmatched"), `<p>${text("study.unmatched_text")}</p>`),
  thanks: (study) => ends(study),
  declined: () => plain(text("study.declined"), text("study.declined_text")),
  withdrew: () => plain(text("study.left"), text("study.left_text")),
  gone: (study, opened) => {
    if (opened) {
      plain(text("study.returned"), text("study.returned_text"));
      send("return", {});
    } else again(text("study.returned"), text("study.away_text"), text("page.continue")); // nobody may be there
  },
  full: () => again(text("study.full"), text("study.full_text"), text("study.try_again")),
};

const key = (study) => `${study.kind} ${study.stage}`;

function show() {
  if (view === null || form === null) return;
  const { study } = view;
  const leaves = new URLSearchParams(location.search).has("leave");
  const under = !["thanks", "declined", "withdrew", "gone", "full", "unmatched"].includes(study.kind);
  if (TASKS.includes(study.kind) && !leaves) {
    location.replace(pageOf("join"));
    return;
  }
  at("title").textContent = form.title;
  at("progress-word").textContent = under || study.kind === "thanks" ? text("study.part", { n: study.number, all: study.of }) : "";
  at("progress").hidden = !(under || study.kind === "thanks");
  at("progress").max = study.of;
  at("progress").value = study.number;
  const ended = ["thanks", "unmatched"].includes(study.kind); // data can be withdrawn afterwards, too
  at("leave").hidden = !(under || ended) || leaves || study.kind === "consent";
  at("leave-button").textContent = at("leave-now").textContent = text(ended ? "study.withdraw" : "page.leave");
  at("stay").textContent = text(ended ? "study.keep" : "study.stay");
  at("leaving-title").textContent = text(ended ? "study.withdrawing" : "study.leaving");
  at("leaving-text").textContent = text(ended ? "study.withdraw_text" : "study.leaving_text");
  const leaving = leaves && (under || ended);
  at("leaving").hidden = !leaving;
  at("stage").hidden = leaving;
  if (study.waiting) {
    at("said").textContent = at("progress-word").textContent = text("study.here", { here: study.waiting.here, all: study.waiting.of });
    at("progress").max = study.waiting.of;
    at("progress").value = study.waiting.here;
  }
  const now = leaving ? LEAVING : key(study);
  if (shown !== now) build(study, now);
  // Nothing can be changed that has been sent already.
  for (const one of all("main .buttons button, #form fieldset")) one.disabled = outbox.busy;
}

function build(study, now) {
  const first = shown === null;
  shown = now;
  if (!first) complain(null);
  at("body").replaceChildren();
  at("form").replaceChildren();
  at("form").onsubmit = (event) => event.preventDefault();
  at("stage").removeAttribute("aria-busy");
  if (LAST.includes(study.kind)) forget(`kitassist draft ${place} `);
  if (now === LEAVING) {
    at("leaving-title").focus();
    return;
  }
  STAGES[study.kind](study, first && !new URLSearchParams(location.search).has("away"));
  scrollTo(0, 0);
  if (!first) at("stage-title").focus({ preventScroll: true });
}

// Requests.

function send(what, body) {
  complain(null);
  if (outbox.send(own(what), body)) show();
}

const onward = (given) => send("onward", { stage: view.study.stage, answers: given });

const outbox = new Outbox("part", {
  answered(answer) {
    complain(null);
    take(answer);
    show();
  },
  refused(error, path) {
    refresh();
    // Where another tab was faster, the page shows how things are; a refused withdrawal changes nothing.
    if (error.status !== 409 || path === own("withdraw")) complain(sentence(error.message));
    show();
  },
  waiting(error) {
    complain(unsent(error));
  },
});

function take(next) {
  if (view !== null && next.seq < view.seq) return;
  view = next;
  show();
}

// Who reads the consent or waits for a group has a place only while the page is there.
const stays = () => ["consent", "waiting"].includes(view?.study.kind);
const refresh = follow(outbox, { take, gone: complain, stays });

const back = () => {
  history.replaceState(null, "", location.pathname + location.hash);
  shown = null;
  complain(null);
  show();
};
at("stay").addEventListener("click", back);
at("leave-now").addEventListener("click", () => send("withdraw", {}));
at("leave-button").addEventListener("click", () => {
  history.replaceState(null, "", `${location.pathname}?leave${location.hash}`);
  show();
});

async function load() {
  try {
    form = await askJson("/api/study/form");
    show();
  } catch (error) {
    if (passes(error)) setTimeout(load, 1000);
    else complain(text("page.invalid_because", { why: sentence(error.message) }));
  }
}
load();
outbox.resume();
