// A participant's page: consent, instructions, questionnaires and the end. It redirects to the page of tasks.

import { Channel, Outbox, Refused, address, askJson, passes, pageOf, pathOf, person, place } from "../../pages/connection.js";

const at = (id) => document.getElementById(id);
const own = (rest) => `/api/study/participants/${encodeURIComponent(person)}/${rest}`;
const TASKS = ["practice", "task"];

let form = null; // texts and questionnaires of the study
let view = null; // the latest view from the service
let shown = null; // the stage that the page shows

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (value === true) made.setAttribute(key, "");
    else if (value !== false && value !== null) made.setAttribute(key, value);
  }
  made.append(...children.filter((child) => child !== null));
  return made;
}

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

// Questionnaires. Each question is a fieldset, so that screen readers announce it with its answers.

let answers = {};

function answer(name, value) {
  answers[name] = value;
  keepDraft(answers);
  const field = at(`item ${name}`);
  field.classList.remove("missing");
  field.querySelector(".error").hidden = true;
}

function fieldOf(item, ...children) {
  return element("fieldset", { id: `item ${item.name}`, class: "item" },
    element("legend", {}, item.text),
    ...children,
    element("p", { class: "error", id: `error ${item.name}`, hidden: true }, "Please answer this question."));
}

/** A scale from 0 to 100. It is unmarked at first, so that the middle is never a default answer. */
function slider(item) {
  const input = element("input", {
    type: "range", min: 0, max: 100, step: 5, "aria-label": `${item.text} 0: ${item.low}, 100: ${item.high}`, class: "unmarked",
  });
  const output = element("output", {}, "not marked");
  const mark = () => {
    input.classList.remove("unmarked");
    output.textContent = input.value;
    input.setAttribute("aria-valuetext", `${input.value} of 100`);
    answer(item.name, Number(input.value));
  };
  input.value = answers[item.name] ?? 50;
  input.setAttribute("aria-valuetext", "not marked");
  if (item.name in answers) {
    input.classList.remove("unmarked");
    output.textContent = input.value;
    input.setAttribute("aria-valuetext", `${input.value} of 100`);
  }
  input.addEventListener("input", mark);
  input.addEventListener("click", mark);
  input.addEventListener("keydown", (event) => ["Enter", " "].includes(event.key) && (event.preventDefault(), mark()));
  return fieldOf(item,
    element("div", { class: "scale", "aria-hidden": "true" }, element("span", {}, item.low), element("span", {}, item.high)),
    input, element("p", { class: "marked" }, output));
}

function points(item, count) {
  const choices = Array.from({ length: count }, (_, number) => {
    const value = number + 1;
    const end = value === 1 ? item.low : value === count ? item.high : null;
    const input = element("input", { type: "radio", name: `item ${item.name}`, value, checked: answers[item.name] === value });
    input.addEventListener("change", () => answer(item.name, value));
    return element("label", { class: "point" }, input, element("span", {}, String(value), end === null ? null : element("span", { class: "unseen" }, `: ${end}`)));
  });
  return fieldOf(item,
    element("div", { class: "points" }, ...choices),
    element("div", { class: "scale", "aria-hidden": "true" }, element("span", {}, item.low), element("span", {}, item.high)));
}

function words(item) {
  const input = element("textarea", { rows: 4, maxlength: 4000, "aria-label": item.text });
  input.value = answers[item.name] ?? "";
  input.addEventListener("input", () => answer(item.name, input.value));
  return fieldOf(item, input);
}

function questionnaire(study) {
  const asked = form.questionnaires[study.what];
  answers = draft();
  title(asked.title);
  at("body").append(element("p", {}, asked.introduction));
  const kinds = { "nasa-tlx": slider, likert: (item) => points(item, asked.points), text: words };
  at("form").append(...asked.items.map(kinds[asked.form]), buttons(["Continue", null]));
  at("form").onsubmit = (event) => {
    event.preventDefault();
    const missing = asked.form === "text" ? [] : asked.items.filter((item) => !(item.name in answers));
    for (const item of missing) {
      at(`item ${item.name}`).classList.add("missing");
      at(`error ${item.name}`).hidden = false;
    }
    if (missing.length) {
      at(`item ${missing[0].name}`).querySelector("input").focus();
      at("said").textContent = `${missing.length === 1 ? "One question is" : `${missing.length} questions are`} unanswered.`;
      return;
    }
    onward({ ...answers });
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

function ends(study) {
  title("Thank you");
  at("body").innerHTML = form.texts.thanks;
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
  thanks: ends,
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
  const under = !["thanks", "declined", "withdrew", "gone", "full"].includes(study.kind);
  if (TASKS.includes(study.kind) && !leaves) {
    location.replace(pageOf("join"));
    return;
  }
  at("title").textContent = form.title;
  at("progress-word").textContent = under || study.kind === "thanks" ? `Part ${study.number} of ${study.of}` : "";
  at("progress").hidden = !(under || study.kind === "thanks");
  at("progress").max = study.of;
  at("progress").value = study.number;
  const ended = study.kind === "thanks"; // data can be withdrawn afterwards, too
  at("leave").hidden = !(under || ended) || leaves || study.kind === "consent";
  at("leave-button").textContent = at("leave-now").textContent = ended ? "Withdraw my data" : "Leave the study";
  at("stay").textContent = ended ? "Keep my data in the study" : "Stay";
  at("leaving").hidden = !(leaves && (under || ended));
  at("stage").hidden = leaves && (under || ended);
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
