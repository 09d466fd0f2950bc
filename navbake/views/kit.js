"use strict";
// What the page shows is in #content. Names come from files: they are only ever set as text.
const find = (id) => document.getElementById(id);
const content = JSON.parse(find("content").textContent);
find("title").textContent = content.title;

// An element around a text, another element, or a list of these.
function element(tag, inner = "", attributes = {}) {
  const made = document.createElement(tag);
  made.append(...[inner].flat());
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}

function button(inner, press, attributes = {}) {
  const made = element("button", inner, { type: "button", ...attributes });
  made.addEventListener("click", press);
  return made;
}

const facts = (entries) => entries.map(([name, value]) => element("div", [element("dt", name), element("dd", value)]));

// A table: texts or elements, and which columns hold numbers.
function table(columns, rows, numbers) {
  // on a narrow page each row is a block, whose cells need their columns' names
  const names = columns.map((column) => column.textContent ?? column);
  const line = (tag, row) => element("tr", row.map((inner, i) => element(tag, inner, { "data-column": names[i], ...(numbers.includes(i) ? { class: "number" } : {}) })));
  return element("table", [element("thead", line("th", columns)), element("tbody", rows.map((row) => line("td", row)))]);
}

// A text whose settings, between backticks, are code.
const coded = (text) => text.split(/`([^`]+)`/).map((part, i) => (i % 2 ? element("code", part) : part));

const fixed = (value, digits) => (Number(value.toFixed(digits)) + 0).toFixed(digits); // never -0
const whole = (value) => Math.round(value).toLocaleString("en");
const counted = (count, noun) => `${whole(count)} ${noun}${count === 1 ? "" : "s"}`;

function rounded(value) {
  if (value === null) return "";
  return Number.isInteger(value) || Math.abs(value) >= 1000 ? whole(value) : String(Number(value.toPrecision(3)));
}

// Undo `pack` of page.py.
function unpack(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).json();
}
