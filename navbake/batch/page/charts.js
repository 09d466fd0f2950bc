// --- distributions: how many scenes have which free area, cells, rooms and time ----------------

const CHARTS = ["freeArea", "cells", "rooms", "seconds"];
const MOST_BINS = 24;
const SKEWED = 20; // so many times the median at the most: then bars have equal ratios, not widths
const WIDE = 300, HIGH = 96, BASE = 78; // of a drawing, and where its bars stand
const SVG = "http://www.w3.org/2000/svg";
const charts = {}; // by column: edges, counts and elements

function drawn(tag, attributes) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}

// The smallest of 1, 2 or 5 times a power of ten that is no less.
function nice(step) {
  const power = 10 ** Math.floor(Math.log10(step));
  return [1, 2, 5, 10].map((n) => n * power).find((n) => n >= step * (1 - 1e-9));
}

const isLogarithmic = (sorted) => sorted[0] > 0 && sorted[sorted.length - 1] > SKEWED * sorted[sorted.length >> 1];

// The edges of bars for some sorted numbers: as wide as one another, or in equal ratios.
function edgesOf(sorted) {
  const least = sorted[0], most = sorted[sorted.length - 1];
  if (isLogarithmic(sorted)) {
    const ratio = Math.max((most / least) ** (1 / MOST_BINS), 1 + 1e-9);
    return Array.from({ length: MOST_BINS + 1 }, (_, k) => (k === MOST_BINS ? most : least * ratio ** k));
  }
  const isWhole = sorted.every(Number.isInteger);
  const step = Math.max(nice((most - least || Math.abs(most) || 1) / (MOST_BINS - 4)), isWhole ? 1 : 0);
  const from = Math.floor(least / step + 1e-9), count = Math.max(1, Math.floor(most / step + 1e-9) - from + 1);
  return Array.from({ length: count + 1 }, (_, k) => Number(((from + k) * step).toPrecision(12)));
}

function binOf(value, edges) {
  let low = 0, high = edges.length - 2;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (value >= edges[middle]) low = middle; else high = middle - 1;
  }
  return low;
}

function count(key, numbers, edges) {
  const counts = new Array(edges.length - 1).fill(0);
  for (const i of numbers) if (scenes[key][i] !== null) counts[binOf(scenes[key][i], edges)]++;
  return counts;
}

// Texts under a chart, each with its place in bars: of bars that have one number each, those, else edges.
function labelsOf(chart) {
  const last = chart.counts.length, half = last >> 1;
  if (chart.isWhole && chart.edges[1] - chart.edges[0] === 1) {
    return [...new Set([0, (last - 1) >> 1, last - 1])].map((k) => [k + 0.5, "middle", rounded(chart.edges[k])]);
  }
  const places = [[0, "start"], ...(last < 4 ? [] : [[half, "middle"]]), [last, "end"]];
  return places.map(([k, anchor]) => [k, anchor, rounded(chart.edges[k])]);
}

function makeCharts() {
  const all = scenes.id.map((_, i) => i);
  for (const key of CHARTS) {
    const sorted = scenes[key].filter((value) => value !== null).sort((a, b) => a - b);
    if (!sorted.length) continue;
    const edges = edgesOf(sorted), counts = count(key, all, edges), [name, unit] = COLUMNS[key];
    const chart = charts[key] = { key, edges, counts, bars: [], active: 0, isWhole: sorted.every(Number.isInteger) };
    const box = element("figure"), svg = drawn("svg", { viewBox: `0 0 ${WIDE} ${HIGH}`, role: "group", "aria-label": `Scenes by ${name}` });
    const width = WIDE / counts.length, most = Math.max(...counts), height = (n) => (n ? Math.max(2, (n / most) * (BASE - 6)) : 0);
    chart.height = height;
    counts.forEach((n, k) => {
      const part = drawn("g", { class: "bar", role: "button", tabindex: k ? "-1" : "0", "aria-pressed": "false" });
      const x = k * width + (counts.length > 1 ? 0.5 : 0), wide = Math.max(width - 1, 0.5);
      const some = drawn("rect", { class: "some", x, width: wide });
      part.append(drawn("rect", { class: "hit", x: k * width, y: 0, width, height: BASE }), drawn("rect", { class: "all", x, width: wide, y: BASE - height(n), height: height(n) }), some);
      for (const event of ["pointerenter", "focus"]) part.addEventListener(event, () => tellBar(chart, k));
      for (const event of ["pointerleave", "blur"]) part.addEventListener(event, () => tellRange(chart));
      part.addEventListener("click", (event) => pressBar(chart, k, event.shiftKey));
      part.addEventListener("keydown", (event) => moveBar(chart, k, event));
      chart.bars.push({ part, some });
      svg.append(part);
    });
    for (const [x, anchor, text] of labelsOf(chart)) {
      const label = drawn("text", { x: x * width, y: HIGH - 4, "text-anchor": anchor });
      label.textContent = text;
      svg.append(label);
    }
    svg.append(drawn("line", { x1: 0, x2: WIDE, y1: BASE, y2: BASE }));
    chart.told = element("p", "", { role: "status" });
    const caption = element("figcaption");
    const notes = [`median ${withUnit(sorted[sorted.length >> 1], unit)}`, ...(isLogarithmic(sorted) ? ["logarithmic"] : [])];
    caption.append(element("strong", name), unit ? ` [${unit}]` : "", element("span", ` ${notes.join(", ")}`, { class: "soft" }));
    box.append(caption, svg, chart.told);
    find("charts").append(box);
  }
  find("distributions").hidden = !find("charts").childElementCount;
}

// The range of some bars in words. Of whole numbers, bars as wide as one have one number.
function rangeText(chart, from, to) {
  const [, unit] = COLUMNS[chart.key], isLast = to === chart.edges[chart.edges.length - 1];
  if (chart.isWhole && to - from === 1) return withUnit(from, unit);
  return `${rounded(from)} to ${isLast ? "" : "below "}${withUnit(to, unit)}`;
}

function tellBar(chart, k) {
  chart.told.textContent = barText(chart, k);
}

function barText(chart, k) {
  const some = chart.shown[k], all = chart.counts[k];
  return `${rangeText(chart, chart.edges[k], chart.edges[k + 1])}: ${counted(all, "scene")}${some === all ? "" : `, ${whole(some)} shown`}`;
}

function tellRange(chart) {
  const range = state.ranges[chart.key];
  chart.told.textContent = range ? `shown: ${rangeText(chart, range[0], range[1])}` : "";
}

function pressBar(chart, k, isMore) {
  const before = state.ranges[chart.key], ranges = { ...state.ranges }, last = chart.edges.length - 2;
  let [from, to] = [chart.edges[k], chart.edges[k + 1]];
  if (before && isMore) [from, to] = [Math.min(from, before[0]), Math.max(to, before[1])];
  if (before && !isMore && before[0] === from && before[1] === to) delete ranges[chart.key];
  else ranges[chart.key] = [from, to, to === chart.edges[last + 1]];
  choose({ ranges });
  tellBar(chart, k);
}

function moveBar(chart, k, event) {
  const to = { ArrowLeft: k - 1, ArrowRight: k + 1, Home: 0, End: chart.bars.length - 1 }[event.key];
  if (event.key === "Enter" || event.key === " ") pressBar(chart, k, event.shiftKey);
  else if (to === undefined || !chart.bars[to]) return;
  else {
    chart.bars[k].part.setAttribute("tabindex", "-1");
    chart.bars[to].part.setAttribute("tabindex", "0");
    chart.bars[to].part.focus();
  }
  event.preventDefault();
}

// Of each bar, the part of its scenes that all other choices leave.
function showCharts() {
  for (const chart of Object.values(charts)) {
    const range = state.ranges[chart.key], left = [];
    for (let i = 0; i < scenes.id.length; i++) if (isChosen(i, chart.key)) left.push(i);
    chart.shown = count(chart.key, left, chart.edges);
    chart.bars.forEach(({ part, some }, k) => {
      const high = chart.height(chart.shown[k]), isOn = Boolean(range) && chart.edges[k] >= range[0] && chart.edges[k + 1] <= range[1];
      some.setAttribute("y", BASE - high);
      some.setAttribute("height", high);
      part.setAttribute("aria-pressed", String(isOn));
      part.setAttribute("aria-label", barText(chart, k));
      part.classList.toggle("out", Boolean(range) && !isOn);
    });
    tellRange(chart);
  }
}
