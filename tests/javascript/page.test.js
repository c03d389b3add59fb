import assert from "node:assert/strict";
import { test } from "node:test";
import { open } from "./browser.js";

test("a text has its values, and its own form for one", async () => {
  const { text } = await open("/join/ann");
  assert.equal(text("a.of", { done: 0, all: 3 }), "0 of 3");
  assert.equal(text("a.step", { n: 2 }), "2 steps");
  assert.equal(text("a.step", { n: 1 }), "1 step");
});

test("numbers are written as in the page's language", async () => {
  const { figure } = await open("/join/ann", { language: "de" });
  assert.deepEqual([figure(0.5), figure(1234.5, 2), figure(2, 0), figure(2)], ["0,5", "1234,50", "2", "2"]);
});

test("a refusal is a sentence", async () => {
  const { sentence } = await open("/join/ann");
  assert.deepEqual(["no such task", "Is it?", "x"].map(sentence), ["No such task.", "Is it?", "X."]);
});

test("a clock has minutes and two digits of seconds", async () => {
  const { clock } = await open("/join/ann");
  assert.deepEqual([0, 9.9, 60, 3661].map(clock), ["0:00", "0:09", "1:00", "61:01"]);
});

test("a complaint is shown until there is none", async () => {
  const { complain, elements } = await open("/join/ann");
  complain("This is wrong.");
  assert.deepEqual([elements.problem.textContent, elements.problem.hidden], ["This is wrong.", false]);
  complain(null);
  assert.deepEqual([elements.problem.textContent, elements.problem.hidden], ["", true]);
});

test("the second click of a double click does nothing, and a key does what a click does", async () => {
  const { single } = await open("/join/ann");
  let clicks = 0;
  const click = single(() => (clicks += 1));
  for (const detail of [1, 2, 3]) click({ detail });
  assert.equal(clicks, 1);
  click({ detail: 0 }); // a key
  assert.equal(clicks, 2);
});

test("a page has a line for each field and each kind of event that has a value, with a button that takes the event back", async () => {
  const { lines } = await open("/join/ann", { lines: { person: [{ paused: "Paused." }, { rested: "Breaks: {value}." }] } });
  document.createElement = (name) => ({ name, parts: [], setAttribute() {}, append(...more) { this.parts.push(...more); } });
  const shown = (view) => lines("person", view, (kind) => kind).map(({ parts }) => parts.join(""));
  assert.deepEqual(shown({ paused: false }), []);
  assert.deepEqual(shown({ paused: true, done: {} }), ["Paused."]);
  assert.deepEqual(shown({ paused: false, done: { rested: 2 } }), ["Breaks: 2. rested"]);
});
