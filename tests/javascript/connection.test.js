import assert from "node:assert/strict";
import { afterEach, test } from "node:test";
import { leave, open, stream } from "./browser.js";

afterEach(leave);

const json = (content, status = 200) => new Response(JSON.stringify(content), { status });
const until = async (holds) => {
  while (!holds()) await new Promise((resolve) => setTimeout(resolve, 5));
};
const noted = () => {
  const told = [];
  const note = (kind) => (...what) => told.push([kind, ...what]);
  return { told, answered: note("answered"), refused: note("refused"), waiting: note("waiting") };
};

test("the token of a link becomes a cookie and leaves the address", async () => {
  const { ask, asked } = await open("/join/ann%20b#secret).");
  await until(() => !location.hash);
  assert.deepEqual(asked.map((one) => one.path), ["/api/session", "/api/me"]);
  assert.equal(asked[0].headers.Authorization, "Bearer secret"); // a full stop that was copied is no part of it
  await ask("/api/me");
  assert.deepEqual(asked[2].headers, { "Kitassist-Caller": "person%20ann%20b" });
});

test("parameters may stand before the token or behind it, and stay in the address", async () => {
  const token = "t".repeat(32);
  for (const link of [`/study?participant=7&signature=s#${token}`, `/study#${token}?participant=7&signature=s`, `/study#${token}&participant=7&signature=s`,
    `/study?participant=7#${token}?signature=s`, `/study#${token}%3Fparticipant=7&signature=s`, `/study#${token}x?participant=7&signature=s`]) {
    const { asked, parameters } = await open(link);
    assert.deepEqual([parameters.get("participant"), parameters.get("signature")], ["7", "s"], link);
    await until(() => !location.hash);
    assert.equal(asked[0].headers.Authorization, `Bearer ${token}`);
    assert.equal(location.search, "?participant=7&signature=s", link);
  }
  const { parameters } = await open(`/study?withdraw#${token}`);
  await until(() => !location.hash);
  assert.deepEqual([parameters.has("withdraw"), location.search], [true, "?withdraw"]);
});

test("without cookies the page goes on with the token", async () => {
  const { ask, asked, pageOf, person } = await open("/join/ann#secret", { fetch: ({ path }) => json({}, path === "/api/me" ? 401 : 200) });
  await until(() => asked.length === 2);
  await assert.rejects(ask("/api/me"), { status: 401, message: "Use the complete link." });
  assert.equal(asked[2].headers.Authorization, "Bearer secret");
  assert.equal(person, "ann");
  assert.match(pageOf("part", "?leave"), /\/part\/ann\?leave#secret$/);
});

test("the operator of a study is no participant", async () => {
  const { ask, asked, person } = await open("/study/operator");
  await ask("/api/study");
  assert.equal(person, "");
  assert.deepEqual(asked[0].headers, { "Kitassist-Caller": "operator" });
});

test("a refusal has the reason, or the status where no JSON comes", async () => {
  const { ask, passes } = await open("/join/ann", { fetch: (_, n) => (n === 1 ? json({ detail: "no" }, 409) : new Response("<html>", { status: 502, statusText: "Bad Gateway" })) });
  await assert.rejects(ask("/x"), { status: 409, message: "no" });
  const error = await ask("/x").catch((one) => one);
  assert.equal(error.message, "502 Bad Gateway");
  assert.equal(passes(error), true);
});

test("a request that takes long may wait longer", async (context) => {
  const { LONG, ask } = await open("/join/ann");
  const limits = context.mock.method(AbortSignal, "timeout").mock;
  await ask("/x");
  await ask("/x", { silence: LONG });
  assert.deepEqual(limits.calls.map((one) => one.arguments), [[10000], [600000]]);
});

test("an action survives bad gateways and lost answers under one id, and is answered once", async () => {
  const { Outbox, asked } = await open("/join/ann", {
    fetch: (_, n) => {
      if (n === 1) throw new TypeError("network");
      return n === 2 ? new Response("", { status: 502 }) : json({ seq: 7 });
    },
  });
  const { told, ...tells } = noted();
  const outbox = new Outbox("actions", tells);
  assert.equal(outbox.send("/act", { action: "(a)" }), true);
  assert.equal(outbox.send("/act", { action: "(b)" }), false); // one at a time
  await until(() => !outbox.busy);
  assert.equal(new Set(asked.map((one) => one.body)).size, 1);
  assert.deepEqual(told.map(([kind]) => kind), ["waiting", "waiting", "answered"]);
  assert.deepEqual(told[2][1], { seq: 7 });
  assert.equal(outbox.send("/act", { action: "(b)" }), true);
});

test("an unanswered action is sent again after a reload", async () => {
  const lost = await open("/join/ann", { fetch: () => new Promise(() => {}) });
  new lost.Outbox("actions", noted()).send("/act", { action: "(a)" });
  const { Outbox, asked } = await open("/join/ann", { stored: lost.stored });
  const { told, ...tells } = noted();
  const outbox = new Outbox("actions", tells);
  assert.equal(outbox.busy, true);
  await outbox.resume();
  assert.equal(asked[0].body, lost.asked[0].body);
  assert.deepEqual(told.map(([kind]) => kind), ["answered"]);
  assert.equal(lost.stored.size, 0);
});

test("a refused action is not sent again", async () => {
  const { Outbox, asked } = await open("/join/ann", { fetch: () => json({ detail: "not applicable" }, 409) });
  const { told, ...tells } = noted();
  const outbox = new Outbox("actions", tells);
  outbox.send("/act", {});
  await until(() => !outbox.busy);
  assert.equal(told[0][1].message, "not applicable");
  assert.equal(told[0][2], "/act");
  assert.equal(asked.length, 1);
});

test("a fault of the page after an answer is no lost request", async () => {
  const { Outbox } = await open("/join/ann");
  const { told, ...tells } = noted();
  const outbox = new Outbox("actions", { ...tells, answered: () => { throw new Error("a fault"); } });
  outbox.keep({ path: "/act", body: {} });
  await assert.rejects(outbox.resume(), /a fault/);
  assert.deepEqual([told, outbox.busy], [[], false]);
});

/** A page whose requests of streams are answered by those given, in their order; others are refused. */
async function streaming(...answers) {
  const page = await open("/join/ann", { fetch: () => answers.shift() ?? json({ detail: "not in the team" }, 404) });
  const [states, told] = [[], []];
  const tells = { message: (kind, data) => told.push([kind, data]), state: (one) => states.push(one) };
  return { ...page, states, told, tells, channel: new page.Channel("/events", tells) };
}

test("a stream that ends or breaks is opened again; a person who has left is told so", async () => {
  const [first, second] = [stream(), stream()];
  const { asked, states, told } = await streaming(first.answer, json({}, 502), second.answer);
  first.piece('event: ping\ndata: {"seconds": 15}\n\neve'); // an event may come in pieces
  first.piece('nt: view\ndata: {"seq": 1}\n\n');
  await until(() => told.length === 1);
  first.ends();
  await until(() => asked.length === 3);
  second.tell("view", { seq: 2 });
  await until(() => told.length === 2);
  second.breaks();
  await until(() => states.at(-1) === "over");
  assert.deepEqual(told, [["view", { seq: 1 }], ["view", { seq: 2 }]]);
  assert.deepEqual(states, ["connected", "lost", "connected", "over"]);
  assert.deepEqual(asked[0].headers, { "Kitassist-Caller": "person%20ann" });
});

test("a stream of which nothing is heard is lost, and opened again", async () => {
  const [silent, next] = [stream(), stream()];
  const { states } = await streaming(silent.answer, next.answer);
  silent.tell("ping", { seconds: 0.01 });
  await until(() => states.length === 2);
  next.tell("ping", { seconds: 15 });
  await until(() => states.length === 3);
  assert.deepEqual(states, ["connected", "lost", "connected"]);
});

test("a hidden page closes its stream and opens it when it is shown", async () => {
  const { asked, happens, tells, Channel } = await streaming(stream().answer, stream().answer, stream().answer);
  await until(() => asked.length === 1);
  document.hidden = true;
  happens("visibilitychange");
  assert.equal(asked[0].signal.aborted, true);
  new Channel("/kept", { ...tells, stays: () => true });
  document.hidden = false;
  happens("visibilitychange");
  await until(() => asked.length === 3);
  assert.deepEqual(asked.map((one) => one.path), ["/events", "/kept", "/events"]);
  assert.equal(asked[1].signal.aborted, false);
});

test("of many windows the one that was not used for longest rests until it is used", async () => {
  const answers = Array.from({ length: 6 }, () => stream().answer);
  const { asked, states, tells, happens, Channel } = await streaming(...answers);
  const another = () => new Channel("/events", { ...tells, state() {} });
  for (let windows = 2; windows <= 4; windows += 1) another();
  assert.deepEqual(states, []);
  another();
  assert.deepEqual([states, asked[0].signal.aborted], [["resting"], true]);
  happens("focus", 1); // of the first window
  await until(() => asked.length === 6);
  assert.deepEqual(asked.map((one) => one.signal.aborted), [true, true, false, false, false, false]);
});

test("where cookies of other programs are too large, the token goes without them, or the page says so", async () => {
  const large = (asked) => (asked.credentials === "omit" ? json({ seq: 1 }) : new Response("<h1>Bad Request</h1>", { status: 400 }));
  const { askJson, asked } = await open("/join/ann#secret", { fetch: large });
  assert.deepEqual(await askJson("/x"), { seq: 1 });
  assert.equal(asked.at(-1).headers.Authorization, "Bearer secret");
  const kept = await open("/join/ann", { fetch: large });
  await assert.rejects(kept.ask("/x"), { status: 400, message: "The cookies are too large." });
});

test("what comes while a button is pressed is shown after its click", async () => {
  const { happens, released } = await open("/join/ann");
  const shown = [];
  released(() => shown.push(1));
  happens("pointerdown");
  released(() => shown.push(2));
  assert.deepEqual(shown, [1]);
  happens("pointerup");
  assert.deepEqual(shown, [1]); // the click comes first
  await until(() => shown.length === 2);
});
