"use strict";
// What the page shows is in #content. Names come from files: they are only ever set as text.
const find = (id) => document.getElementById(id);
const content = JSON.parse(find("content").textContent);

function element(tag, text, attributes = {}) {
  const made = document.createElement(tag);
  if (text !== undefined) made.textContent = text;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}

function button(text, press, attributes = {}) {
  const made = element("button", text, { type: "button", ...attributes });
  made.addEventListener("click", press);
  return made;
}

// A row of buttons for [value, text]; the one that is chosen is pressed, or selected as a tab is.
function buttons(box, entries, isOn, choose) {
  const isTabs = find(box).getAttribute("role") === "tablist";
  find(box).replaceChildren(...entries.map(([value, text]) => {
    const on = String(isOn(value));
    return button(text, () => choose(value), isTabs ? { role: "tab", "aria-selected": on } : { "aria-pressed": on });
  }));
}

// Names and values of a list of facts.
function facts(entries) {
  return entries.map(([name, value]) => {
    const box = element("div");
    box.append(element("dt", name), element("dd", value));
    return box;
  });
}

// A part that can be folded: its title, how much is in it, and what.
function folder(title, count, inner, open) {
  const box = element("details"), head = element("summary");
  head.append(element("h2", title), element("span", ` ${count}`, { class: "soft" }));
  box.append(head, inner);
  box.open = open;
  return box;
}

// A table: texts or elements, and which columns hold numbers.
function table(columns, rows, numbers) {
  const made = element("table"), head = element("thead"), body = element("tbody"), top = element("tr");
  const kind = (i) => (numbers.includes(i) ? { class: "number" } : {});
  const cell = (tag, inner, attributes) => {
    const box = element(tag, undefined, attributes);
    box.append(inner);
    return box;
  };
  top.append(...columns.map((inner, i) => cell("th", inner, { scope: "col", ...kind(i) })));
  for (const row of rows) {
    const line = element("tr");
    line.append(...row.map((inner, i) => cell("td", inner, kind(i))));
    body.append(line);
  }
  head.append(top);
  made.append(head, body);
  return made;
}

// --- numbers and arrays -----------------------------------------------------------------------

const fixed = (value, digits) => (Number(value.toFixed(digits)) + 0).toFixed(digits); // never -0
const whole = (value) => Math.round(value).toLocaleString("en");
const counted = (count, noun) => `${whole(count)} ${noun}${count === 1 ? "" : "s"}`;

function rounded(value) {
  if (value === null || value === undefined) return "";
  return Number.isInteger(value) || Math.abs(value) >= 1000 ? whole(value) : String(Number(value.toPrecision(3)));
}

// Undo `to_text` of page.py.
function inflate(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate")));
}

// Undo `pack` of page.py. An array of unsigned numbers adds modulo what it holds.
async function unpack(packed) {
  const buffer = await inflate(packed.data).arrayBuffer();
  const stored = new { 1: Uint8Array, 2: Uint16Array, 4: Uint32Array }[packed.bytes](buffer);
  for (let i = 1; i < stored.length; i++) stored[i] += stored[i - 1];
  return Float64Array.from(stored, (value) => value - 1);
}
