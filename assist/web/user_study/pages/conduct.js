// The experimenter's page: participants and their progress, dropouts, the sizes of conditions, and the export.

import { Channel, LONG, Refused, ask, show as showState } from "../../pages/connection.js";
import { all, at, clock, complain, focused, released, sentence } from "../../pages/page.js";

const LEFT = ["gone", "declined", "full", "unmatched"];
const STATES = { done: "completed", gone: "dropped out", withdrew: "withdrew", declined: "no consent", full: "study full", unmatched: "no group" };

function cell(content, kind = "") {
  const made = document.createElement("td");
  if (kind) made.className = kind;
  made.append(content ?? "");
  return made;
}

function cells(...parts) {
  const made = document.createElement("td");
  made.append(...parts.flat());
  return made;
}

function row(cells, kind = "") {
  const made = document.createElement("tr");
  made.className = kind;
  made.append(...cells);
  return made;
}

/** A button that sends a request about a participant: `request` returns its path and options, or null if there is none. */
function button(code, word, request, said) {
  const made = document.createElement("button");
  made.type = "button";
  made.textContent = word;
  made.setAttribute("aria-label", `${word} ${code}`);
  made.dataset.key = `${word} ${code}`;
  made.addEventListener("click", async () => {
    const asked = request();
    if (asked === null) return;
    complain(null);
    try {
      await ask(asked[0], asked[1]);
      at("said").textContent = said;
    } catch (error) {
      complain(error instanceof Refused ? error.message : "The study server cannot be reached. Try again.");
    }
  });
  return made;
}

function remover(code) {
  const sure = () => confirm(`Mark ${code} as dropped out? They can rejoin if there is a free place.`);
  const path = `/api/people/${encodeURIComponent(code)}/leave`;
  return button(code, "Remove", () => (sure() ? [path, { method: "POST" }] : null), `${code} is marked as dropped out.`);
}

function eraser(code) {
  const request = () => {
    const reason = prompt(`Erase everything that is recorded about ${code}, permanently? Enter a reason that does not contain the code.`);
    return reason ? [`/api/people/${encodeURIComponent(code)}/records?reason=${encodeURIComponent(reason)}`, { method: "DELETE", silence: LONG }] : null;
  };
  return button(code, "Erase", request, `The records of ${code} are erased.`);
}

function excluder(code, excluded) {
  const path = `/api/study/participants/${encodeURIComponent(code)}/exclude`;
  if (excluded) return button(code, "Include", () => [path, { method: "POST", body: { reason: null } }], `${code} is in the report again.`);
  const request = () => {
    const reason = prompt(`Exclude ${code} from the report? Enter a reason, which the report will name.`);
    return reason ? [path, { method: "POST", body: { reason } }] : null;
  };
  return button(code, "Exclude", request, `${code} is excluded from the report.`);
}

function show(study) {
  const { participants, stages, conditions } = study;
  at("title").textContent = document.title = study.title;
  showState({ faults: [...study.problems.map(sentence), ...(study.fault === null ? [] : [`A policy failed: ${study.fault}`])] });
  const here = participants.filter((one) => one.status === "here").length;
  const done = participants.filter((one) => one.status === "done").length;
  at("count").textContent = `${participants.length} joined, ${here} present, ${done} completed${study.places === null ? "" : `, ${study.taken} of ${study.places} places taken`}`;
  at("join").value = study.join;
  const within = study.design === "within";  // each participant is assigned an order of all conditions
  at("conditions-title").textContent = within ? "Orders of the conditions" : "Conditions";
  for (const head of document.querySelectorAll("[data-condition]")) head.textContent = within ? "Order" : "Condition";
  at("counted").textContent = participants.some((one) => one.group !== null) ? "Groups counted" : "Counted";
  at("conditions").replaceChildren(...conditions.map((one) => row([cell(one.name), cell(one.policy), cell(one.begun, "count"), cell(one.counting, "count"), cell(one.done, "count")])));
  const counts = conditions.map((one) => one.counting);
  const apart = Math.max(...counts) - Math.min(...counts);
  at("balance").textContent = within
    ? `The most and the least frequent order differ by ${apart}. An order is assigned when a participant's first task begins.`
    : `The largest and the smallest condition differ by ${apart}. A condition is assigned when a participant's first task begins.`;
  const kept = participants.filter((one) => one.status !== "withdrew");
  at("flow").replaceChildren(...stages.map((name, number) => row([
    cell(name),
    cell(kept.filter((one) => one.number > number).length, "count"),
    cell(kept.filter((one) => one.number === number + 1 && one.status === "here").length, "count"),
    cell(kept.filter((one) => one.number === number + 1 && LEFT.includes(one.status)).length, "count"),
    cell(participants.filter((one) => one.number === number + 1 && one.status === "withdrew").length, "count"),
  ])));
  const key = focused()?.dataset.key;
  at("people").replaceChildren(...[...participants].reverse().map((one) => {
    const state = STATES[one.status] ?? (one.connected ? "connected" : "not connected");
    const withdrawn = ["withdrew", "declined"].includes(one.status);
    return row([
      cell(one.code + (one.simulated ? " (simulated)" : "")), cell(one.excluded === null ? state : `${state}; excluded: ${one.excluded}`), cell(one.stage),
      running(one.seconds), cell(one.group === null ? one.condition : `${one.condition} (${one.group})`), cell(one.steps, "count"),
      cells(one.status === "here" ? [remover(one.code)] : [], withdrawn ? [] : [excluder(one.code, one.excluded !== null)], one.erased ? [] : [eraser(one.code)]),
    ], one.status === "here" ? "" : "over");
  }));
  if (key) (all("[data-key]").find((other) => other.dataset.key === key) ?? at("people-title")).focus({ preventScroll: true });
}

/** The time of each participant in their part goes on. */
setInterval(() => {
  for (const one of all("[data-since]")) one.textContent = clock((performance.now() - one.dataset.since) / 1000);
}, 1000);

/** A cell with a time that goes on, from some seconds. */
function running(seconds) {
  const made = cell(seconds === null ? "" : clock(seconds), "count");
  if (seconds !== null) made.dataset.since = String(performance.now() - 1000 * seconds);
  return made;
}

at("copy").addEventListener("click", async () => {
  at("join").select();
  try {
    await navigator.clipboard.writeText(at("join").value);
    at("said").textContent = "Copied.";
  } catch {
    at("said").textContent = "The link is selected; copy it with the keyboard.";
  }
});
at("export").addEventListener("click", async () => {
  complain(null);
  try {
    const content = await (await ask("/api/study/export", { silence: LONG })).blob();
    const link = document.createElement("a");
    link.href = URL.createObjectURL(content);
    link.download = "user-study.zip";
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
    at("said").textContent = "The export is saved.";
  } catch (error) {
    complain(error instanceof Refused ? error.message : "The study server cannot be reached. Try again.");
  }
});
new Channel("/api/study/events", {
  message: (_, data) => released(() => show(data)),
  state(state, refused) {
    showState({ state, refused: state === "over" ? undefined : refused });
    if (state === "over") complain("This link is not valid.");
  },
});
