"use strict";
// What the page shows is in #content. Names and reasons come from files: they are only ever set as text.
const find = (id) => document.getElementById(id);
const KINDS = ["failures", "warnings", "remarks"]; // of reasons, see reasons.py
const COLUMNS = { // of the table and of the charts: name, and unit
  freeArea: ["free area", "m\u00b2"], cells: ["cells", ""], levels: ["levels", ""], rooms: ["rooms", ""], doors: ["doors", ""], seconds: ["time", "s"],
};
const STATUS = [["ok", "\u2713"], ["failed", "\u2715"], ["left", "\u2013"]]; // as content.py numbers them
const NEVER = -1; // no error

let content, scenes, reasons; // set when the content is unpacked
// What is chosen. A range is [from, to], and takes in `to` where it is the last of its chart.
const state = { status: null, text: "", ranges: {}, failures: null, warnings: null, remarks: null, sort: null, down: false, scene: null };
let shown = []; // numbers of the scenes that are chosen, in the order of the table

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

// Undo packing.to_text.
async function unpack(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).json();
}

// --- words ------------------------------------------------------------------------------------

const whole = (value) => Math.round(value).toLocaleString("en");
const counted = (count, noun) => `${whole(count)} ${noun}${count === 1 ? "" : "s"}`;

function rounded(value) {
  if (value === null || value === undefined) return "";
  if (Number.isInteger(value) || Math.abs(value) >= 1000) return whole(value);
  return String(Number(value.toPrecision(3)));
}

const withUnit = (value, unit) => (value === null || value === undefined ? "" : `${rounded(value)}${unit ? `\u00a0${unit}` : ""}`);

function duration(seconds) {
  if (seconds < 60) return `${rounded(seconds)} s`;
  const minutes = Math.round(seconds / 60), hours = Math.floor(minutes / 60);
  return hours ? `${whole(hours)} h ${minutes % 60} min` : `${Math.floor(seconds / 60)} min ${Math.round(seconds % 60)} s`;
}

// A time of the index, as UTC; empty where it is none.
function moment(text) {
  const time = new Date(text);
  return Number.isNaN(time.getTime()) ? "" : `${time.toISOString().slice(0, 19).replace("T", " ")} UTC`;
}

function rate(count, seconds) {
  const each = count / seconds;
  if (each >= 1) return `${rounded(each)} a second`;
  return each * 60 >= 1 ? `${rounded(each * 60)} a minute` : `${rounded(each * 3600)} an hour`;
}

// --- what is chosen ---------------------------------------------------------------------------

// The numbers of the texts of a kind that a scene has.
const textsOf = (kind, i) => (kind === "failures" ? (scenes.error[i] === NEVER ? [] : [scenes.error[i]]) : scenes[kind][i]);
const groupsOf = (kind, i) => textsOf(kind, i).map((text) => reasons[kind].group[text]);
const nameOf = (kind, group) => reasons[kind].groups[group].filter(Boolean).join(": ");

function inRange(value, [from, to, isLast]) {
  return value !== null && value >= from && (value < to || (isLast && value <= to));
}

// Whether a scene is chosen; `but` names a choice that doesn't count.
function isChosen(i, but) {
  if (state.status !== null && but !== "status" && scenes.status[i] !== state.status) return false;
  for (const [key, range] of Object.entries(state.ranges)) if (key !== but && !inRange(scenes[key][i], range)) return false;
  for (const kind of KINDS) if (state[kind] !== null && kind !== but && !groupsOf(kind, i).includes(state[kind])) return false;
  return !state.text || searched(i).includes(state.text.toLowerCase());
}

const lowered = [];
function searched(i) {
  if (lowered[i] === undefined) {
    const words = [scenes.id[i], scenes.source[i]];
    for (const kind of KINDS) for (const text of textsOf(kind, i)) words.push(...reasons[kind].texts[text]);
    lowered[i] = words.join("\n").toLowerCase();
  }
  return lowered[i];
}

function choose(changes) {
  Object.assign(state, changes);
  update();
}

function update() {
  shown = [];
  for (let i = 0; i < scenes.id.length; i++) if (isChosen(i)) shown.push(i);
  sortShown();
  remember();
  showAll();
}

function sortShown() {
  const key = state.sort;
  if (!key) {
    if (state.down) shown.reverse();
    return;
  }
  const values = scenes[key], sign = state.down ? -1 : 1, isText = key === "id";
  const order = new Intl.Collator("en", { numeric: true }).compare;
  shown.sort((a, b) => { // scenes without a value come last
    const one = values[a], other = values[b];
    if (one === null || other === null) return (one === null) - (other === null) || a - b;
    return sign * (isText ? order(one, other) : one - other) || a - b;
  });
}

// --- the choice in the address, so that a reload or a copied link shows the same ---------------

function remember() {
  const words = new URLSearchParams();
  if (state.status !== null) words.set("status", STATUS[state.status][0]);
  if (state.text) words.set("text", state.text);
  for (const [key, range] of Object.entries(state.ranges)) words.set(key, range.map(Number).join(","));
  for (const kind of KINDS) if (state[kind] !== null) words.set(kind, nameOf(kind, state[kind]));
  if (state.sort || state.down) words.set("sort", (state.down ? "-" : "") + (state.sort || ""));
  if (state.scene !== null) words.set("scene", scenes.id[state.scene]);
  const hash = String(words);
  if (hash !== location.hash.slice(1)) history.replaceState(null, "", `#${hash}`);
}

function recall() {
  const words = new URLSearchParams(location.hash.slice(1)), status = STATUS.findIndex(([name]) => name === words.get("status"));
  const sort = words.get("sort") || "", key = sort.replace(/^-/, ""), ranges = {};
  for (const name of Object.keys(COLUMNS)) {
    const range = (words.get(name) || "").split(",").map(Number);
    if (range.length === 3 && range.every(Number.isFinite)) ranges[name] = [range[0], range[1], Boolean(range[2])];
  }
  Object.assign(state, {
    status: status < 0 ? null : status, text: words.get("text") || "", ranges,
    sort: Object.hasOwn(COLUMNS, key) || ["id", "status"].includes(key) ? key : null, down: sort.startsWith("-"), scene: null,
  });
  for (const kind of KINDS) {
    const group = reasons[kind].groups.findIndex((_, g) => nameOf(kind, g) === words.get(kind));
    state[kind] = group < 0 ? null : group;
  }
  const scene = words.has("scene") ? scenes.id.indexOf(words.get("scene")) : -1;
  state.scene = scene < 0 ? null : scene;
  find("text").value = state.text;
}
