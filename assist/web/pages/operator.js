// The operator's page: people's progress, the beliefs about them, the robot, and the log.

import { Channel, LONG, Refused, ask, newId, pathOf, show as showState } from "./connection.js";
import { all, at, clock, complain, element, focused, lines, released, sentence } from "./page.js";

const SVG = "http://www.w3.org/2000/svg";
const WIDTH = 300;
const HEIGHT = 70;
const LEFT = 20;

let team = null;
const links = {};

const one = (value) => (Math.abs(value) < 0.05 ? "0" : value.toFixed(1).replace(/\.0$/, ""));
const two = (value) => (Math.abs(value) < 0.005 ? "0" : String(Number(value.toPrecision(2))));
const spread = (mean, ends) => `${mean.toFixed(2)} (${ends.map((end) => end.toFixed(2)).join(" to ")})`;
const plain = (action) => action?.replace(/^\(|\)$/g, "") ?? "";

function shape(name, attributes) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

function plot(label, width, height) {
  return shape("svg", { class: "plot", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label });
}

function label(x, y, text, anchor = "start") {
  const made = shape("text", { x, y, "text-anchor": anchor });
  made.textContent = text;
  return made;
}

/** Latest time in this session; all plots share one time axis. */
function lastTime() {
  return Math.max(0, ...(team.log ?? []).map((event) => event.time), ...team.people.map((person) => person.history?.at(-1)?.[0] ?? 0));
}

/** Description of a person's cost-to-go. */
function remaining(person) {
  return person.cost_to_go === null ? "goal unreachable" : `remaining cost ${one(person.cost_to_go)}`;
}

/** Cost-to-go over time as a step plot, with gaps at dead ends. */
function progressOf(person) {
  const points = (person.history ?? []).filter(([, value]) => value !== null);
  const highest = Math.max(1, ...points.map(([, value]) => value));
  const last = Math.max(1, lastTime());
  const drawn = plot(`Remaining cost over ${clock(last)} minutes: ${points.length ? one(points[0][1]) : "?"} at first, now ${remaining(person)}`, WIDTH, HEIGHT);
  const x = (time) => LEFT + ((WIDTH - LEFT - 5) * time) / last;
  const y = (value) => HEIGHT - 14 - ((HEIGHT - 24) * value) / highest;
  drawn.append(shape("line", { class: "axis", x1: LEFT, x2: WIDTH, y1: y(0), y2: y(0) }));
  let path = "";
  points.forEach(([time, value], number) => {
    path += number ? `H${x(time).toFixed(1)}V${y(value).toFixed(1)}` : `M${x(time).toFixed(1)} ${y(value).toFixed(1)}`;
  });
  if (points.length) {
    const [, value] = points.at(-1);
    if (!person.finished) path += `H${x(last).toFixed(1)}`;
    drawn.append(shape("path", { class: "line", d: path }));
    drawn.append(shape("circle", { class: "end", cx: x(person.finished ? points.at(-1)[0] : last), cy: y(value), r: 3.5 }));
  }
  drawn.append(label(LEFT, HEIGHT - 2, "0:00"), label(WIDTH, HEIGHT - 2, clock(last), "end"), label(LEFT - 5, y(highest) + 4, one(highest), "end"), label(LEFT - 5, y(0) + 3, "0", "end"));
  return drawn;
}

/** Plot of the belief over beta or theta. */
function beliefOf(name, values, shares) {
  const mean = values.reduce((sum, value, number) => sum + value * shares[number], 0);
  const highest = Math.max(...shares, 1e-9);
  const width = WIDTH / 2;
  const drawn = plot(`${name}: ${one(values[0])} to ${one(values.at(-1))}, mean ${mean.toFixed(2)}`, width, HEIGHT);
  const wide = width / values.length;
  shares.forEach((share, number) => {
    const high = ((HEIGHT - 18) * share) / highest;
    drawn.append(shape("rect", { class: "column", x: (number * wide + 1).toFixed(1), y: (HEIGHT - 14 - high).toFixed(1), width: Math.max(1, wide - 2).toFixed(1), height: high.toFixed(1) }));
  });
  drawn.append(shape("line", { class: "axis", x1: LEFT, x2: width, y1: HEIGHT - 14, y2: HEIGHT - 14 }));
  drawn.append(label(0, HEIGHT - 2, values[0].toFixed(2)), label(width, HEIGHT - 2, values.at(-1).toFixed(2), "end"));
  return [drawn, mean];
}

/** Bars of the probabilities of the most probable goals. */
function goalsOf(goals) {
  const most = Object.entries(goals).sort((a, b) => b[1] - a[1]).slice(0, 5);
  const percent = (share) => `${Math.round(100 * share)} %`;
  const drawn = plot(`Goal: ${most.map(([name, share]) => `${name} ${percent(share)}`).join(", ")}`, WIDTH, 16 * most.length);
  most.forEach(([name, share], number) => {
    const y = 16 * number;
    drawn.append(shape("rect", { class: "column", x: WIDTH / 2, y: y + 2, width: (share * (WIDTH / 2 - 40)).toFixed(1), height: 11 }));
    drawn.append(label(0, y + 12, name.length > 24 ? `${name.slice(0, 23)}…` : name), label(WIDTH, y + 12, percent(share), "end"));
  });
  return figureOf(drawn, `Probable goals${Object.keys(goals).length > most.length ? ` (${most.length} of ${Object.keys(goals).length})` : ""}`);
}

/** The open question to a person, whose answer the operator may enter. */
function questionTo({ person, seq }, { goal, options }) {
  const answers = goal === null ? options.map((action) => [plain(action), action]) : [["Yes", true], ["No", false]];
  return element("p", { class: "buttons" },
    `Asked: ${goal === null ? "what was done last?" : `is the goal ${goal}?`} `,
    ...[...answers, ["No answer", null]].map(([said, answer]) => element("button", {
      type: "button", "data-key": `answer ${person} ${said}`, "aria-label": `Answer of ${person}: ${said}`,
      click: () => tell(pathOf(person, "/answer"), { method: "POST", body: { answer, seq, id: newId() } }, `The answer of ${person} is recorded.`),
    }, said)));
}

/** What a person said about their goal, which the operator may take back. */
function answerOf({ person }, { goal, yes }) {
  return element("p", { class: "buttons" },
    `Said: the goal is ${yes ? "" : "not "}${goal}. `,
    element("button", {
      type: "button", "data-key": `retract ${person}`, "aria-label": `Take back the answer of ${person}`,
      click: () => tell(pathOf(person, "/undo"), { method: "POST", body: { of: "answered", id: newId() } }, `The answer of ${person} is taken back.`),
    }, "Take back"));
}

function figureOf(drawn, caption) {
  return element("figure", {}, drawn, element("figcaption", {}, caption));
}

function card(person) {
  const { robots } = team;
  const here = robots.findIndex((robot) => robot.location === person.person);
  const { beta, theta } = person.grid;
  const ofBeta = person.belief.map((row) => row.reduce((sum, share) => sum + share, 0));
  const ofTheta = theta.map((_, column) => person.belief.reduce((sum, row) => sum + row[column], 0));
  const [betas, betaMean] = beliefOf("Expertise beta", beta, ofBeta);
  const [thetas, thetaMean] = beliefOf("Influence theta", theta, ofTheta);
  const seat = person.simulated ? "simulated" : person.connected ? "connected" : "not connected";
  const state = person.finished ? "finished" : seat;
  const join = links[person.person] ?? person.join;
  return element("li", { class: `card${here >= 0 ? " here" : ""}` },
    element("h3", {}, person.person,
      here >= 0 ? element("span", { class: "badge here" }, robots.length > 1 ? `robot ${here + 1} here` : "robot here") : null,
      element("span", { class: `badge${person.finished ? " ended" : ""}` }, state)),
    element("p", {}, `${team.tasks.length > 1 ? `${person.task}: ` : ""}${person.steps} ${person.steps === 1 ? "step" : "steps"}, ${remaining(person)}`),
    ...lines("operator", person, (of) => element("button", {
      type: "button", "data-key": `${of} ${person.person}`, "aria-label": `Take back what ${person.person} did last: ${of}`,
      click: () => tell(pathOf(person.person, "/undo"), { method: "POST", body: { of, id: newId() } }, `What ${person.person} did is taken back.`),
    }, "Take back")),
    person.question ? questionTo(person, person.question) : null,
    person.answered ? answerOf(person, person.answered) : null,
    figureOf(progressOf(person), "Remaining cost over time"),
    element("div", { class: "pair" },
      figureOf(betas, `Expertise β: ${betaMean.toFixed(2)}`),
      figureOf(thetas, `Influence θ: ${thetaMean.toFixed(2)}`)),
    person.goals ? goalsOf(person.goals) : null,
    join ? element("p", { class: "link" }, element("input", { readonly: true, value: join, "aria-label": `Link for ${person.person}`, "data-key": `link ${person.person}` })) : null,
    element("p", { class: "buttons" },
      element("button", { type: "button", "data-key": `undo ${person.person}`, disabled: person.steps === 0, "aria-label": `Undo the last step of ${person.person}`, click: () => tell(pathOf(person.person, "/undo"), { method: "POST", body: { id: newId() } }, `The last step of ${person.person} is undone.`) }, "Undo last step"),
      element("button", { type: "button", "data-key": `remove ${person.person}`, "aria-label": `Remove ${person.person}`, click: () => remove(person.person) }, "Remove"),
      element("button", { type: "button", "data-key": `erase ${person.person}`, "aria-label": `Erase the records of ${person.person}`, click: () => erase(person.person) }, "Erase")));
}

/** Where a robot is, what it does next, and why; `name` is empty if there is only one. */
function robotOf(robot, name) {
  const where = robot.location ? `With ${robot.location}` : "At its base";
  const next = team.paused ? "Suggestions are paused."
    : !robot.person ? "No useful suggestion right now."
    : !robot.suggestion ? `${robot.arrived ? "Stays with" : "Goes to"} ${robot.person}.`
    : `${robot.arrived === false ? "On the way to" : "Serves"} ${robot.person}: ${plain(robot.suggestion)}`;
  const why = !robot.reason || team.paused ? "" :
    `Expected to save a cost of ${two(robot.reason.saving)}, minus ${two(robot.reason.moving)} for moving: ${two(robot.reason.score)}. ` +
    `Expertise ${spread(robot.reason.beta, robot.reason.beta_interval)}, ` +
    `influence ${spread(robot.reason.theta, robot.reason.theta_interval)}.`;
  return [
    name ? element("h3", {}, name) : null,
    element("p", { class: "large where" }, where), element("p", { class: "next" }, next), element("p", { class: "why" }, why),
  ].filter(Boolean);
}

function show() {
  const { people, robots } = team;
  const there = people.filter((person) => person.present !== false);
  at("count").textContent = `${there.length} ${there.length === 1 ? "person" : "people"}, ${there.filter((person) => person.finished).length} finished`;
  at("pause").textContent = team.paused ? "Resume suggestions" : "Pause suggestions";
  at("pause").setAttribute("aria-pressed", String(team.paused));
  at("robot-title").textContent = robots.length > 1 ? "The robots" : "The robot";
  at("robots").replaceChildren(...robots.flatMap((robot, index) => robotOf(robot, robots.length > 1 ? `Robot ${index + 1}` : "")));
  showState({ faults: [...(team.problems ?? []).map(sentence), ...(team.fault ? [`The policy failed, so nothing is suggested: ${team.fault}`] : [])] });
  showTasks();
  keepingFocus(() => at("people").replaceChildren(...there.map(card)));
  at("log").replaceChildren(...[...(team.log ?? [])].reverse().map((event) =>
    element("tr", {},
      element("td", { class: "count" }, clock(event.time)),
      element("td", {}, event.person ?? ""),
      element("td", {}, [event.event, plain(event.action) || saidIn(event)].filter(Boolean).join(": ")),
      element("td", {}, event.suggestion ? `${plain(event.suggestion)}${event.followed === true ? " (followed)" : event.followed === false ? " (not followed)" : ""}` : ""))));
}

/** What was asked or answered in an event. */
function saidIn({ goal, answer }) {
  if (goal !== undefined) return goal === null ? "what was done last?" : `is the goal ${goal}?`;
  return typeof answer === "string" ? plain(answer) : { true: "yes", false: "no" }[answer] ?? "";
}

/** With several tasks, a new person gets the selected one. */
function showTasks() {
  at("task-label").hidden = team.tasks.length < 2;
  if (at("task").options.length !== team.tasks.length) at("task").replaceChildren(...team.tasks.map((name) => element("option", {}, name)));
}

/** Redraw, and keep the keyboard focus. */
function keepingFocus(redraw) {
  const key = focused()?.dataset.key;
  redraw();
  if (key) (all("[data-key]").find((other) => other.dataset.key === key) ?? at("people-title")).focus({ preventScroll: true });
}

/**
 * Send a request, and say what it did; if it is refused in the present state, send it with the `other` options.
 * @type {(path: string, options: any, said: string, other?: any) => Promise<any>}
 */
async function tell(path, options, said, other = null) {
  complain(null);
  try {
    const answer = await ask(path, options).catch((error) => {
      if (other === null || error.status !== 409) throw error;
      return ask(path, other);
    });
    at("said").textContent = said;
    return answer.status === 204 ? null : await answer.json().catch(() => null);
  } catch (error) {
    complain(error instanceof Refused ? error.message : "The server cannot be reached. Try again.");
    return null;
  }
}

function erase(name) {
  const reason = prompt(`Erase everything that is recorded about ${name}, permanently? Enter a reason that does not contain the name.`);
  if (reason) tell(`/api/people/${encodeURIComponent(name)}/records?reason=${encodeURIComponent(reason)}`, { method: "DELETE", silence: LONG }, `The records of ${name} are erased.`);
}

function remove(name) {
  if (confirm(`Remove ${name} from the team?`)) tell(`/api/people/${encodeURIComponent(name)}/leave`, { method: "POST" }, `${name} is removed.`);
}

at("pause").addEventListener("click", () => {
  tell("/api/team/pause", { method: "POST", body: { paused: !team.paused } }, team.paused ? "Suggestions are resumed." : "Suggestions are paused.");
});
at("add").addEventListener("submit", async (event) => {
  event.preventDefault();
  const name = at("name").value.trim();
  if (!name) return;
  const again = { method: "POST", body: { person: name } }; // who returns has a task already
  const first = team?.tasks.length > 1 ? { method: "POST", body: { person: name, task: at("task").value } } : again;
  const added = await tell("/api/team/people", first, `${name} is added.`, again);
  if (added === null) return;
  at("name").value = "";
  if (added.join) links[name] = added.join;
  if (team !== null) show();
});
at("export").addEventListener("click", async () => {
  try {
    const content = await (await ask("/api/log", { silence: LONG })).blob();
    const link = element("a", { href: URL.createObjectURL(content), download: "log.jsonl" });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
    at("said").textContent = "The log is saved.";
  } catch (error) {
    complain(error instanceof Refused ? error.message : "The server cannot be reached. Try again.");
  }
});

let waiting = null;
function take(next) {
  if (team !== null && next.seq < team.seq) return;
  team = next;
  waiting ??= requestAnimationFrame(() => {
    waiting = null;
    show();
  });
}

new Channel("/api/team/events", {
  message: (_, data) => released(() => take(data)),
  state(state, refused) {
    showState({ state, refused: state === "over" ? undefined : refused });
    if (state === "over") complain("This link is not valid.");
  },
});
