import assert from "node:assert/strict";
import { test } from "node:test";
import { open } from "./browser.js";

test("a number with a separator that may be one of thousands is refused", async () => {
  const { numberIn } = await open("/part/ann");
  const read = (item, ...texts) => texts.map((one) => numberIn(one, item));
  assert.deepEqual(read({ min: 0, step: 1 }, "", " 10000 ", "10,000", "10.000", "1,5", "-3", "ten"), [undefined, 10000, "10,000", "10.000", "1,5", -3, "ten"]);
  assert.deepEqual(read({ min: 0, step: 0.01 }, "1,75", "1.5", "10,000", "10.000", "1,234.5"), [1.75, 1.5, "10,000", "10.000", "1,234.5"]);
  assert.deepEqual(read({ min: 0.5, step: 0.001 }, "1,755", "0.125"), [1.755, 0.125]);
});
