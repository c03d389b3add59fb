// A person's page: the drawing with the possible actions, the suggestion, the number of steps, and the goal.

import { Outbox, askJson, follow, passes, pageOf, pathOf, person, place, unsent } from "./connection.js";
import { all, at, clock, complain, element, figure, first, focused, keep, language, lines, recall, released, sentence, single, text } from "./page.js";

const LARGEST = 1.3; // largest magnification of a drawing; larger ones look coarse
const WIDTHS = [320, 400, 520, 640, 760, 960];

let view = null; // the latest view from the service
let drawn = null; // the latest drawing, with the actions in words
let declined = null; // the suggestion that the person declined, with the step at which they did
let chosen = []; // objects clicked in succession
let started = null;
let refusals = 0;
let explained = null; // the view whose explanation is shown
let left = null; // the action whose button had the focus when the list of actions was disabled
let questioned = null; // the question that is shown, with the step at which it was asked

// Texts.

const plain = (action) => action.replace(/^\(|\)$/g, "");
const words = (action) => drawn?.words[action] ?? plain(action).replace(" ", ": ").replaceAll(" ", ", ").replace(":,", ":");
const objectsOf = (action) => plain(action).split(" ").slice(1);

function say(words) {
  at("said").textContent = "";
  requestAnimationFrame(() => {
    at("said").textContent = words;
  });
}

function percent(share) {
  return `${Math.round(100 * share)} %`;
}

/** What the robot believes about the person; a belief is no observation. */
function beliefs(reason) {
  const { beta, beta_interval: b, suggestions, followed, follow, follow_interval: f } = reason;
  const level = beta < 0.6 ? "novice" : beta < 1.8 ? "skilled" : "expert";
  const past = suggestions ? text("task.followed", { followed, all: suggestions }) : text("task.unanswered");
  return [
    text(`task.${level}`, { beta: figure(beta, 2), low: figure(b[0], 2), high: figure(b[1], 2) }),
    `${past} ${text("task.expected", { share: percent(follow), low: percent(f[0]), high: percent(f[1]) })}`,
  ];
}

// Display.

function item(words, act) {
  const line = document.createElement("li");
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = words;
  button.addEventListener("click", single(act));
  line.append(button);
  return line;
}

function fill(list, lines) {
  list.replaceChildren(...lines);
}

/** Several goals are possible, or actions were seen badly: the goal has been reached with some probability only. */
const probably = () => view.finished && view.applicable.length > 0;

const open = () => (view !== null && !view.finished && view.suggestion !== null && declined !== `${view.steps} ${view.suggestion}` ? view.suggestion : null);

function show() {
  if (view === null) return;
  at("person").textContent = view.person;
  document.title = text("task.title_of", { person: view.person });
  at("steps").textContent = view.steps;
  at("steps-word").textContent = text("task.steps", { n: view.steps });
  at("undo").disabled = view.steps === 0 || outbox.busy;
  showStudy(view.study);
  showAdvice();
  showActions();
  showEnd();
}

/** In a user study, this page links to the study's other pages and offers no undo. */
function showStudy(study) {
  if (!study) return;
  if (!["practice", "task"].includes(study.kind)) {
    location.replace(pageOf("part", study.kind === "gone" ? "?away" : "")); // without "away", who comes back returns
    return;
  }
  at("person").textContent = text(study.kind === "practice" ? "task.practice" : "task.title");
  document.title = at("person").textContent;
  for (const button of [at("again"), ...all("button[data-event]")]) button.hidden = true;
  first("a", at("leave")).href = pageOf("part", "?leave");
  at("onward").hidden = at("leave").hidden = false;
  at("onward").disabled = outbox.busy;
}

function showAdvice() {
  const suggestion = open();
  at("advice").hidden = view.finished && !view.question;
  at("advice").classList.toggle("open", suggestion !== null || Boolean(view.question));
  at("offer").hidden = suggestion === null;
  fill(at("lines-shown"), lines("person", view, (of) => element("button", {
    type: "button", disabled: outbox.busy, click: single(() => tell("undo", { of })),
  }, text("task.retract"))));
  at("advice-title").textContent = text(view.question ? "task.asks" : "task.suggests");
  at("nothing").hidden = view.paused || suggestion !== null || Boolean(view.question);
  showQuestion(view.question);
  showAnswer(view.answered);
  showReasons(suggestion);
  if (suggestion === null) {
    at("suggestion").textContent = "";
    return;
  }
  const step = words(suggestion);
  at("accept").disabled = outbox.busy;
  if (at("suggestion").textContent !== step) {
    at("suggestion").textContent = step;
    say(text("task.suggestion", { action: step }));
  }
}

/** What the assistant asks; nobody has to answer. */
function showQuestion(question) {
  at("question").hidden = !question;
  const key = question ? `${view.seq} ${drawn !== null} ${outbox.busy}` : null;
  if (key === questioned) return;
  questioned = key;
  if (!question) return;
  const asked = question.goal === null ? text("task.ask_action") : text("task.ask_goal", { goal: question.goal });
  if (at("asked").textContent !== asked) say(asked);
  at("asked").textContent = asked;
  const answers = question.goal === null ? question.options.map((action) => [words(action), action])
    : [[text("task.yes"), true], [text("task.no"), false]];
  fill(at("answers"), [...answers, [text("task.no_answer"), null]].map(([words, answer]) => {
    return element("button", { type: "button", disabled: outbox.busy, click: single(() => reply(answer)) }, words);
  }));
}

/** What the person said about their goal, which they may take back. */
function showAnswer(answered) {
  at("told").hidden = !answered;
  at("retract").disabled = outbox.busy;
  at("told-text").textContent = answered ? text(answered.yes ? "task.told_yes" : "task.told_no", { goal: answered.goal }) : "";
}

/** Report an event of this person, by the end of its path and its fields. */
function tell(event, fields) {
  complain(null);
  if (outbox.send(pathOf(person, `/${event}`), fields)) show();
}

function reply(answer) {
  tell("answer", { answer, seq: view.seq });
  at("choices-title").focus({ preventScroll: true });
}

const items = (texts) => texts.map((words) => {
  const line = document.createElement("li");
  line.textContent = words.replaceAll(" %", "\u00a0%");
  return line;
});

/** The reasons of the present suggestion, or why there is none; they are asked for when somebody opens them. */
function showReasons(suggestion) {
  at("reasons").hidden = view.suggestion !== suggestion || (suggestion === null && !view.explained);
  const key = `${view.seq} ${suggestion}`;
  if (explained === key) return;
  explained = key;
  fill(at("why"), suggestion !== null && !view.explained ? items([text("task.optimal")]) : []);
  const others = suggestion === null || !view.explained ? [] : view.applicable.filter((action) => action !== suggestion);
  fill(at("against"), ["", ...others].map((action) => new Option(action ? words(action) : text("task.choose"), action)));
  at("comparison").hidden = !others.length;
  at("compared").textContent = "";
  explain();
}

const explanation = (against) => {
  const asked = new URLSearchParams({ language, ...(against ? { against } : {}) });
  return askJson(pathOf(person, `/explanation?${asked}`));
};

async function explain() {
  const key = explained;
  if (!at("reasons").open || at("reasons").hidden || !view.explained || at("why").children.length) return;
  try {
    const { sentences, step } = await explanation();
    if (key !== explained) return;
    // The suggestion itself is shown above.
    fill(at("why"), items([...sentences.slice(step ? 1 : 0), ...(view.reason === null ? [] : beliefs(view.reason))]));
  } catch (error) {
    if (key === explained && passes(error)) setTimeout(explain, 1000);
    else if (key === explained) fill(at("why"), items([sentence(error.message)]));
  }
}

async function compare() {
  const [key, against] = [explained, at("against").value];
  at("compared").textContent = "";
  if (!against) return;
  let found;
  try {
    found = (await explanation(against)).sentences.at(-1);
  } catch (error) {
    found = sentence(error.message);
  }
  if (key === explained && against === at("against").value) at("compared").textContent = found;
}

function showActions() {
  const list = at("actions");
  const before = list.contains(focused()) ? focused()?.dataset.action : focused() === document.body ? left : null;
  left = outbox.busy ? before : null;
  fill(list, view.applicable.map((action) => {
    const line = item(words(action), () => act(action));
    const button = first("button", line);
    button.disabled = outbox.busy;
    button.dataset.action = action;
    if (action === open()) line.classList.add("suggested");
    return line;
  }));
  if (before !== null && !outbox.busy) {
    const buttons = all("button", list);
    (buttons.find((button) => button.dataset.action === before) ?? buttons[0] ?? at("choices-title")).focus();
  }
}

function showEnd() {
  const over = view.study?.over ?? false; // whether a study's task has ended, finished or not
  const ended = view.finished || over;
  const stuck = !ended && !view.study && view.cost_to_go === null; // in a study, such a task is over
  const key = probably() ? "task.probably" : view.finished ? "task.reached" : "task.ended";
  const reached = text(key, { n: view.steps });
  if (ended && (at("done").hidden || at("done-text").textContent !== reached)) {
    at("done-title").textContent = text(probably() ? "task.probably_done" : "task.done");
    at("done-text").textContent = reached;
    at("done").hidden = false;
    say(reached);
    at("done-title").focus();
  }
  if (!ended) at("done").hidden = true;
  at("hint").hidden = ended && !probably();
  at("choices-title").classList.toggle("unseen", ended && view.applicable.length === 0); // it can still have the focus
  if (stuck) complain(text("task.stuck"));
  else if (at("problem").textContent === text("task.stuck")) complain(null);
}

/** The texts of the domain's drawing may be in another language than the page. */
function showDrawing() {
  for (const part of ["suggestion", "against", "menu-list", "actions"]) at(part).lang = drawn.language;
  const parsed = new DOMParser().parseFromString(drawn.svg, "image/svg+xml").documentElement;
  const svg = /** @type {any} */ (document.importNode(parsed, true));
  svg.removeAttribute("width");
  svg.removeAttribute("height");
  at("drawing").replaceChildren(svg);
  at("stage").style.maxWidth = `${LARGEST * svg.viewBox.baseVal.width}px`;
  const done = drawn.goal.filter((one) => one.done).length;
  at("goal").max = Math.max(1, drawn.goal.length);
  at("goal").value = done;
  at("goal").textContent = at("wanted-count").textContent = text("task.count", { done, all: drawn.goal.length });
  at("goal-word").textContent = text("task.goal_count", { done, all: drawn.goal.length });
  first(".goal").hidden = first(".choices details").hidden = !drawn.goal.length; // unknown to the server
  fill(at("wanted"), drawn.goal.map((one) => {
    const line = document.createElement("li");
    line.className = one.done ? "so" : "open";
    line.textContent = text(one.done ? "task.fact_done" : "task.fact_open", { fact: one.text });
    return line;
  }));
  showTargets(svg);
}

/** Buttons over the objects of the drawing, since an image cannot contain buttons. */
function showTargets(svg) {
  const inside = at("targets").contains(focused());
  const before = inside ? focused()?.dataset.object : null;
  const { width, height } = svg.viewBox.baseVal;
  const suggested = open() === null ? [] : objectsOf(open());
  const buttons = [];
  for (const group of svg.querySelectorAll("[data-object]")) {
    const name = group.dataset.object;
    group.classList.toggle("ka-hint", suggested.includes(name));
    const possible = matching([name]);
    if (!possible.length || (view?.finished && !probably())) continue;
    const frame = group.querySelector(".ka-frame");
    const button = document.createElement("button");
    button.type = "button";
    button.dataset.object = name;
    button.setAttribute("aria-label", text("task.possible", { object: name, n: possible.length, action: words(possible[0]) }));
    for (const [side, attribute, whole] of [["left", "x", width], ["top", "y", height], ["width", "width", width], ["height", "height", height]]) {
      button.style[side] = `${(100 * Number(frame.getAttribute(attribute))) / whole}%`;
    }
    button.addEventListener("click", single(() => choose(name, button)));
    buttons.push(button);
  }
  fill(at("targets"), buttons);
  if (inside) (buttons.find((button) => button.dataset.object === before) ?? buttons[0] ?? at("choices-title")).focus();
}

// Clicks.

const matching = (names) => (view?.applicable ?? []).filter((action) => names.every((name) => objectsOf(action).includes(name)));

function choose(name, button) {
  if (outbox.busy) return;
  const both = [...chosen, name];
  chosen = chosen.length && !chosen.includes(name) && matching(both).length ? both : [name];
  const possible = matching(chosen);
  if (possible.length === 1) {
    act(possible[0]);
    return;
  }
  at("menu-title").textContent = text(chosen.length > 1 ? "task.with_both" : "task.with", { object: chosen[0], other: chosen[1] });
  fill(at("menu-list"), possible.map((action) => item(words(action), () => act(action))));
  const can = new Set(possible.flatMap(objectsOf));
  for (const group of all("[data-object]", at("drawing"))) {
    group.classList.toggle("ka-acted", chosen.includes(group.dataset.object));
    group.classList.toggle("ka-can", !chosen.includes(group.dataset.object) && can.has(group.dataset.object));
  }
  const menu = at("menu");
  menu.hidden = false;
  menu.style.setProperty("--left", `${Math.max(0, Math.min(button.offsetLeft, at("stage").clientWidth - menu.offsetWidth))}px`);
  menu.style.setProperty("--top", `${button.offsetTop + button.offsetHeight + 6}px`);
  first("button", at("menu-list")).focus({ preventScroll: true });
  menu.scrollIntoView({ block: "nearest" });
  say(`${at("menu-title").textContent} ${possible.map(words).join("; ")}.`);
}

function closeMenu(back = true) {
  if (at("menu").hidden) return;
  at("menu").hidden = true;
  const name = chosen.at(-1);
  chosen = [];
  for (const group of all(".ka-can, .ka-acted", at("drawing"))) group.classList.remove("ka-can", "ka-acted");
  if (back) first(`[data-object="${CSS.escape(name)}"]`, at("targets"))?.focus();
}

// Requests.

function act(action) {
  const suggestion = view.suggestion;
  const followed = suggestion === null ? null : action === suggestion;
  const within = at("menu").contains(focused()) || at("targets").contains(focused());
  closeMenu(within);
  chosen = [];
  complain(null);
  const stage = view.study?.stage; // another tab may be further
  if (outbox.send(pathOf(person, "/actions"), { action, followed, seq: view.seq, ...(stage ? { stage } : {}) })) show();
}

const outbox = new Outbox("actions", {
  answered(answer, body) {
    refusals = 0;
    complain(null);
    take(answer);
    show();
    if (body.action) say(text("task.done_action", { action: words(body.action) }));
  },
  refused(error) {
    complain(sentence(error.message));
    show();
    refresh();
  },
  waiting(error) {
    refusals += 1;
    if (refusals > 1) complain(unsent(error));
  },
});

function take(next) {
  if (view !== null && next.seq < view.seq) return;
  const changed = view === null || next.seq !== view.seq;
  const moved = view === null || view.study?.stage !== next.study?.stage;
  view = next;
  if (moved) started = recall(began());
  if (started === null) remember(Date.now());
  show();
  const elsewhere = view.study && !["practice", "task"].includes(view.study.kind);
  if (!elsewhere && (changed || drawn === null)) redraw();
}

let asked = 0;
async function redraw() {
  const turn = (asked += 1);
  const across = at("picture").clientWidth;
  const width = WIDTHS.findLast((one) => one <= across - 8) ?? WIDTHS[0];
  try {
    const next = await askJson(pathOf(person, `/drawing?width=${width}`));
    released(() => turn === asked && takeDrawing(next));
  } catch (error) {
    if (turn === asked && passes(error)) setTimeout(redraw, 1000);
  }
}

function takeDrawing(next) {
  if (at("menu").hidden === false) closeMenu(true);
  drawn = next;
  for (const option of at("against").options) if (option.value) option.textContent = words(option.value);
  show();
  showDrawing();
  if (view !== null && next.seq < view.seq) setTimeout(redraw, 100);
}

/** Disable the page of a person who has left the team. */
function leave(why) {
  closeMenu(false);
  for (const part of [".work", "#advice", "#done"]) first(part).hidden = true;
  complain(why);
}

const refresh = follow(outbox, { take, gone: leave, over: () => leave(text("task.removed")) });

// Steps and time.

/** The key of the time at which the task began; a user study can have several tasks. */
const began = () => `kitassist began ${place} ${view.study?.stage ?? ""}`;

function remember(when) {
  started = when;
  keep(began(), when);
}

setInterval(() => {
  if (started === null || (view?.finished && !probably())) return;
  at("time").textContent = clock(Math.max(0, Math.round((Date.now() - started) / 1000)));
}, 1000);

at("accept").addEventListener("click", single(() => {
  if (open() !== null) act(open());
  at("choices-title").focus({ preventScroll: true });
}));
at("ignore").addEventListener("click", single(() => {
  declined = `${view.steps} ${view.suggestion}`;
  say(text("task.declined"));
  show();
  if (drawn !== null) showDrawing();
  at("choices-title").focus({ preventScroll: true });
}));
at("reasons").addEventListener("toggle", explain);
at("against").addEventListener("change", compare);
/** A button may report an event: its path is `data-event`, its fields are `data-fields`, and `data-then` gets the focus. */
for (const button of all("button[data-event]")) {
  button.addEventListener("click", single(() => {
    tell(button.dataset.event, JSON.parse(button.dataset.fields ?? "{}"));
    if (button.dataset.then) at(button.dataset.then).focus({ preventScroll: true });
  }));
}
at("again").addEventListener("click", () => {
  remember(Date.now());
  if (outbox.send(pathOf(person, "/begin"), {})) show();
  at("choices-title").focus({ preventScroll: true });
});
at("onward").addEventListener("click", () => {
  complain(null);
  if (outbox.send(`/api/study/participants/${encodeURIComponent(person)}/onward`, { stage: view.study.stage })) show();
});
at("menu-close").addEventListener("click", () => closeMenu());
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape") closeMenu();
});
document.addEventListener("click", (event) => {
  const clicked = /** @type {Node} */ (event.target);
  if (!at("menu").hidden && !at("menu").contains(clicked) && !at("targets").contains(clicked)) closeMenu(false);
});
let across = 0;
new ResizeObserver(() => {
  const width = at("picture").clientWidth;
  if (view !== null && Math.abs(width - across) > 40) redraw();
  across = width;
}).observe(at("picture"));

outbox.resume();
