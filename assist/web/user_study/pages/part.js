// A participant's page: consent, instructions, questionnaires and the end. It redirects to the page of tasks.

import { Channel, Outbox, Refused, address, askJson, passes, pageOf, pathOf, person, place } from "../../pages/connection.js";
import { Questions, element } from "./questions.js";

const at = (id) => document.getElementById(id);
const own = (rest) => `/api/study/participants/${encodeURIComponent(person)}/${rest}`;
const TASKS = ["practice", "task"];

let form = null; // texts and questionnaires of the study
let view = null; // the latest view from the service
let shown = null; // the stage that the page shows

function complain(text) {
  at("problem").textContent = text ?? "";
  at("problem").hidden = !text;
  if (text) at("problem").scrollIntoView({ block: "nearest" });
}

// Answers that are not sent yet survive a reload.

const draftKey = () => `kitassist draft ${place} ${view.study.stage}`;

function draft() {
  try {
    return JSON.parse(sessionStorage.getItem(draftKey())) ?? {};
  } catch {
    return {};
  }
}

function keepDraft(answers) {
  try {
    sessionStorage.setItem(draftKey(), JSON.stringify(answers));
  } catch {
    // no storage: answers are lost when the page is closed
  }
}

function questionnaire(study) {
  const asked = form.questionnaires[study.what];
  const questions = new Questions(asked.items, study.items, draft(), keepDraft);
  title(asked.title);
  if (asked.introduction) at("body").append(element("p", {}, asked.introduction));
  at("form").append(...questions.elements(), buttons(["Continue", null]));
  at("form").onsubmit = (event) => {
    event.preventDefault();
    const wrong = questions.check();
    if (wrong) at("said").textContent = `${wrong === 1 ? "One question needs" : `${wrong} questions need`} an answer.`;
    else onward({ ...questions.answers });
  };
}

// The other stages.

function title(text) {
  at("stage-title").textContent = text;
  document.title = `${text}: ${form.title}`;
}

/** The first button submits the form; each further button has its own action. */
function buttons([word, _], ...others) {
  return element("p", { class: "buttons" }, element("button", { type: "submit", class: "main" }, word), ...others.map(([text, act]) => {
    const made = element("button", { type: "button" }, text);
    made.addEventListener("click", act);
    return made;
  }));
}

function text(heading, name, ...words) {
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

function ends(study, heading = "Thank you", words = form.texts.thanks) {
  title(heading);
  at("body").innerHTML = words;
  const code = element("input", { readonly: true, value: study.completion, id: "code", size: study.completion.length + 1 });
  const copy = element("button", { type: "button" }, "Copy");
  copy.addEventListener("click", async () => {
    code.select();
    try {
      await navigator.clipboard.writeText(code.value);
      at("said").textContent = "Copied.";
    } catch {
      at("said").textContent = "The code is selected; copy it with the keyboard.";
    }
  });
  at("body").append(element("p", { class: "code" }, element("label", { for: "code" }, "Your completion code"), code, copy), element("p", {}, "You can close this page."));
  askJson(`/api/study/participants/${encodeURIComponent(person)}/withdrawal`).then(({ code, address: place, until }) => {
    const last = until === null ? "" : ` until ${until}`;
    at("body").append(element("p", { class: "hint", id: "withdrawal" }, `You can withdraw your data${last}: on this page, or with the code ${code} at ${place}.`));
  }).catch(() => {}); // the page works without it
}

const STAGES = {
  consent: () => text("Taking part", "consent", ["I agree and take part", null], ["I do not agree", () => send("withdraw", {})]),
  instructions: () => text("What you will do", "instructions", ["Continue", null]),
  questionnaire,
  waiting: () => plain("Waiting for your group", "The task begins by itself when all are here. Please keep this page open."),
  unmatched: (study) => ends(study, "There is no group for you", "<p>Not enough people came in time. Thank you for waiting.</p>"),
  thanks: (study) => ends(study),
  declined: () => plain("You chose not to take part", "Nothing more is recorded about you. You can close this page."),
  withdrew: () => plain("You have left the study", "Thank you for your time. You can close this page."),
  gone: () => {
    plain("Welcome back", "You were away for a while. One moment, please.");
    send("return", {});
  },
  full: () => {
    plain("The study is full", "While you were away, your session was reassigned. You can try again later, since places may become free.");
    at("form").append(buttons(["Try again", null]));
    at("form").onsubmit = (event) => {
      event.preventDefault();
      send("return", {});
    };
  },
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
  at("progress-word").textContent = under || study.kind === "thanks" ? `Part ${study.number} of ${study.of}` : "";
  at("progress").hidden = !(under || study.kind === "thanks");
  at("progress").max = study.of;
  at("progress").value = study.number;
  const ended = ["thanks", "unmatched"].includes(study.kind); // data can be withdrawn afterwards, too
  at("leave").hidden = !(under || ended) || leaves || study.kind === "consent";
  at("leave-button").textContent = at("leave-now").textContent = ended ? "Withdraw my data" : "Leave the study";
  at("stay").textContent = ended ? "Keep my data in the study" : "Stay";
  at("leaving").hidden = !(leaves && (under || ended));
  at("stage").hidden = leaves && (under || ended);
  if (study.waiting) {
    at("said").textContent = at("progress-word").textContent = `${study.waiting.here} of ${study.waiting.of} are here`;
    at("progress").max = study.waiting.of;
    at("progress").value = study.waiting.here;
  }
  for (const button of document.querySelectorAll("main .buttons button")) button.disabled = outbox.busy;
  if (shown === key(study) && !(leaves && under)) return;
  const first = shown === null;
  shown = key(study);
  complain(null);
  at("body").replaceChildren();
  at("form").replaceChildren();
  at("form").onsubmit = (event) => event.preventDefault();
  at("stage").removeAttribute("aria-busy");
  if (leaves && under) at("leaving-title").focus();
  else {
    STAGES[study.kind](study);
    scrollTo(0, 0);
    if (!first) at("stage-title").focus({ preventScroll: true });
  }
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
  refused(error) {
    refresh();
    if (error.status !== 409) complain(`${error.message}.`);
    show();
  },
  waiting() {
    complain("Not sent yet. It will be sent when the connection is restored.");
  },
});

function take(next) {
  if (view !== null && next.seq < view.seq) return;
  view = next;
  show();
}

async function refresh() {
  try {
    take(await askJson(pathOf(person)));
  } catch (error) {
    if (error instanceof Refused && [401, 403, 404].includes(error.status)) {
      channel.end();
      complain(`This link is not valid: ${error.message}.`);
    }
  }
}

const channel = new Channel(pathOf(person, "/events"), {
  message: take,
  state(state) {
    at("connection").textContent = { connected: "Connected", lost: "Reconnecting…", over: "Not connected" }[state];
    at("connection").classList.toggle("lost", state !== "connected");
    if (state === "connected") outbox.resume();
    if (state !== "connected") refresh();
  },
});

const back = () => {
  history.replaceState(null, "", location.pathname + location.hash);
  shown = null;
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
    else complain(`This link is not valid: ${error.message}.`);
  }
}
load();
