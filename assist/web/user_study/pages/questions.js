// The questions of a questionnaire. Each is a fieldset, so that screen readers announce it with its answers.

import { at, element, figure, first, text } from "../../pages/page.js";

const LIKE = { "nasa-tlx": "slider", "likert-grid": "likert" }; // forms that are shown as others are

/** Whether the numbers have no finer parts than such, as hundredths. */
const inParts = (parts, ...numbers) => numbers.every((one) => Math.abs(parts * one - Math.round(parts * one)) < 1e-6);

/**
 * The number in a text; nothing if it is empty; the text itself if it is no number, or its separator may be one of
 * thousands: 10,000 and 10.000 are ten thousand to some and ten to others.
 */
export function numberIn(written, { min, step }) {
  const given = written.trim();
  const ambiguous = inParts(1, min, step) ? /[.,]/ : inParts(100, min, step) ? /[.,]\d{3}$/ : null;
  const value = Number(given.replace(",", "."));
  if (given === "") return undefined;
  return Number.isFinite(value) && !ambiguous?.test(given) ? value : given;
}

/** The questions in `names`, in this order. `answers` has the given answers; `changed` is called with each new one. */
export class Questions {
  constructor(items, names, answers, changed) {
    this.items = Object.fromEntries(names.map((name) => [name, { ...items[name], name }]));
    this.answers = Object.fromEntries(Object.entries(answers).filter(([name]) => names.includes(name)));
    this.changed = changed;
    const all = Object.values(this.items);
    this.marksOptional = all.some((item) => item.required); // a page without required questions says so itself
  }

  /** The elements of all questions; neighbours in the form of a grid are in one. */
  elements() {
    const made = [];
    let grid = null;
    for (const item of Object.values(this.items)) {
      const field = this.field(item);
      if (item.form !== "likert-grid") {
        made.push(field);
        grid = null;
        continue;
      }
      if (grid === null || grid.dataset.labels !== this.labels(item).join("\n")) {
        grid = element("div", { class: "grid" }, this.head(item));
        grid.dataset.labels = this.labels(item).join("\n");
        made.push(grid);
      }
      grid.append(field);
    }
    return made;
  }

  /** What is wrong with an answer, or null. */
  problem(item) {
    const answer = this.answers[item.name];
    const none = answer === undefined || answer === null || answer === "" || answer.length === 0;
    if (none) return item.required ? text("question.unanswered") : null;
    if (item.form !== "number") return null;
    const steps = (answer - item.min) / item.step;
    const fits = typeof answer === "number" && answer >= item.min && answer <= item.max && Math.abs(steps - Math.round(steps)) < 1e-6;
    return fits ? null : text("question.number", { range: range(item) });
  }

  /** Mark the questions without a valid answer; return their number, with the focus in the first. */
  check() {
    const wrong = Object.values(this.items).map((item) => [item, this.problem(item)]).filter(([, problem]) => problem !== null);
    for (const [item, problem] of wrong) {
      const error = at(`error-${item.name}`);
      fieldset(item).classList.add("missing");
      error.textContent = problem;
      error.hidden = false;
    }
    if (wrong.length) first("input, textarea", fieldset(wrong[0][0])).focus();
    return wrong.length;
  }

  answer(item, value) {
    if (value === undefined) delete this.answers[item.name];
    else this.answers[item.name] = value;
    fieldset(item).classList.remove("missing");
    at(`error-${item.name}`).hidden = true;
    this.changed(this.answers);
  }

  field(item) {
    const form = LIKE[item.form] ?? item.form;
    const optional = !item.required && this.marksOptional;
    const clears = !item.required && ["choice", "likert", "slider"].includes(form);
    const made = element("fieldset", { id: `item ${item.name}`, class: "item", "aria-describedby": `error-${item.name}` },
      element("legend", {}, item.text, optional ? element("span", { class: "hint" }, ` ${text("question.optional")}`) : null),
      ...this[form](item),
      element("p", { class: "error", id: `error-${item.name}`, hidden: true }));
    if (clears) {
      const clear = element("button", { type: "button", class: "quiet", "aria-label": text("question.clear_of", { question: item.text }) }, text("question.clear"));
      clear.addEventListener("click", () => {
        this.answer(item, undefined);
        const again = this.field(item);
        fieldset(item).replaceWith(again);
        first("input", again).focus();
      });
      made.append(clear);
    }
    return made;
  }

  /** A scale. It is unmarked at first, so that the middle is never a default answer. */
  slider(item) {
    const { min, max, step } = item;
    const ends = item.low || item.high ? [item.low, item.high] : [figure(min), figure(max)];
    const input = element("input", {
      type: "range", min, max, step, "aria-label": text("question.scale", { question: item.text, low: figure(min), high: figure(max), low_label: ends[0], high_label: ends[1] }), class: "unmarked",
    });
    const output = element("output", {}, text("question.unmarked"));
    const show = () => {
      input.classList.remove("unmarked");
      output.textContent = figure(Number(input.value));
      input.setAttribute("aria-valuetext", text("question.marked", { n: figure(Number(input.value)), high: figure(max) }));
    };
    const mark = () => {
      show();
      this.answer(item, Number(input.value));
    };
    input.value = this.answers[item.name] ?? (min + max) / 2;
    input.setAttribute("aria-valuetext", text("question.unmarked"));
    if (item.name in this.answers) show();
    input.addEventListener("input", mark);
    input.addEventListener("click", mark);
    input.addEventListener("keydown", (event) => ["Enter", " "].includes(event.key) && (event.preventDefault(), mark()));
    return [
      element("div", { class: "scale", "aria-hidden": "true" }, ...ends.map((end) => element("span", {}, end))),
      input, element("p", { class: "marked" }, output),
    ];
  }

  /** A label for each point; empty between the ends unless the study has labels for all. */
  labels(item) {
    if (item.labels.length) return item.labels;
    return Array.from({ length: item.max }, (_, place) => (place === 0 ? item.low : place === item.max - 1 ? item.high : ""));
  }

  likert(item) {
    const labels = this.labels(item);
    const choices = labels.map((label, place) => {
      const value = place + 1;
      const input = element("input", { type: "radio", name: `item ${item.name}`, value, checked: this.answers[item.name] === value });
      input.addEventListener("change", () => this.answer(item, value));
      return element("label", { class: "point" }, input, element("span", {}, String(value), label ? element("span", { class: "unseen" }, `: ${label}`) : null));
    });
    return [element("div", { class: "points" }, ...choices), this.scale(item)];
  }

  /** The labels below the points; for the eye only, as each point has its label. */
  scale(item) {
    const every = item.labels.length > 0;
    return element("div", { class: every ? "scale every" : "scale", "aria-hidden": "true" },
      ...(every ? item.labels : [item.low, item.high]).map((label) => element("span", {}, label)));
  }

  /** The head of a grid: its labels once, above all rows. */
  head(item) {
    return element("div", { class: "head", "aria-hidden": "true" }, element("span", {}), this.scale(item));
  }

  boxes(item, type, isChecked, change) {
    return [element("div", { class: "options" }, ...item.options.map((option) => {
      const input = element("input", { type, name: `item ${item.name}`, value: option, checked: isChecked(option) });
      input.addEventListener("change", () => change(option, input.checked));
      return element("label", { class: "option" }, input, element("span", {}, option));
    }))];
  }

  choice(item) {
    return this.boxes(item, "radio", (option) => this.answers[item.name] === option, (option) => this.answer(item, option));
  }

  choices(item) {
    const chosen = () => this.answers[item.name] ?? [];
    return this.boxes(item, "checkbox", (option) => chosen().includes(option), (option, checked) => {
      const others = chosen().filter((other) => other !== option);
      this.answer(item, checked ? [...others, option] : others);
    });
  }

  number(item) {
    const input = element("input", { type: "text", inputmode: "decimal", autocomplete: "off", size: 12, "aria-label": text("question.a_number", { question: item.text, range: range(item) }) });
    input.value = this.answers[item.name] ?? "";
    input.addEventListener("input", () => this.answer(item, numberIn(input.value, item)));
    return [element("p", { class: "figure" }, input, element("span", { class: "hint", "aria-hidden": "true" }, ` ${range(item)}`))];
  }

  text(item) {
    const input = element("textarea", { rows: 4, maxlength: 4000, "aria-label": item.text });
    input.value = this.answers[item.name] ?? "";
    input.addEventListener("input", () => this.answer(item, input.value));
    return [input];
  }
}

const fieldset = (item) => at(`item ${item.name}`);
const range = (item) => text(item.step === 1 ? "question.range" : "question.range_steps", { low: figure(item.min), high: figure(item.max), step: figure(item.step) });
