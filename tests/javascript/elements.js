// Writes `elements.d.ts`: the type of the element that each id names in the pages, so that `at("undo")` is a button.

import { readFileSync, readdirSync, writeFileSync } from "node:fs";

const web = new URL("../../assist/web/", import.meta.url);
const found = {};
for (const folder of ["pages/", "user_study/pages/"]) {
  for (const file of readdirSync(new URL(folder, web)).filter((name) => name.endsWith(".html"))) {
    const page = readFileSync(new URL(folder + file, web), "utf8");
    for (const [, tag, id] of page.matchAll(/<(\w+)[^>]*?\bid="([^"]+)"/g)) (found[id] ??= new Set()).add(`HTMLElementTagNameMap["${tag}"]`);
  }
}
const lines = Object.entries(found).map(([id, types]) => `  "${id}": ${[...types].join(" | ")};`);
writeFileSync(new URL("elements.d.ts", import.meta.url), `interface Elements {\n${lines.join("\n")}\n}\n`);
