// --- the table: only rows that are in sight are elements ---------------------------------------

const ROW = 56, BEYOND = 6; // height of a row [pixels], as in the style, and rows kept above and below
const SETTLE = 60; // pictures are asked for when the table rests so long [ms]
const made = new Map(); // elements of rows, by the scene's number
let active = 0, waiting; // place in `shown` that the keys move; timer of pictures

// Where a file of a scene is. A name with `:` or `..` stays one in its folder.
function hrefOf(i, file) {
  const parts = `${scenes.id[i]}/${file}`.split("/").map(encodeURIComponent);
  return [...(content.base.startsWith("/") ? [] : ["."]), content.base, ...parts].join("/");
}

function makeHeads() {
  find("table").style.setProperty("--all", `${scenes.id.length * ROW}px`); // it isn't lower for what is chosen
  const heads = [["id", "scene", ""], ["status", "status", ""], ...Object.entries(COLUMNS).map(([key, [name, unit]]) => [key, name, unit])];
  find("heads").append(element("span", "", { role: "columnheader", "aria-label": "picture", class: "picture" }));
  for (const [key, name, unit] of heads) {
    const cell = element("span", undefined, { role: "columnheader", class: `c-${key}${key in COLUMNS ? " number" : ""}`, "data-key": key });
    cell.append(button(unit ? `${name} [${unit}]` : name, () => sortBy(key)));
    find("heads").append(cell);
  }
}

// Up, down, then in the batch's order again; numbers begin with the largest.
function sortBy(key) {
  const first = key in COLUMNS;
  if (state.sort !== key) choose({ sort: key, down: first });
  else if (state.down === first) choose({ down: !first });
  else choose({ sort: null, down: false });
}

function makeRow(i) {
  const row = element("div", undefined, { role: "row", class: `row ${STATUS[scenes.status[i]][0]}`, id: `row-${i}` });
  const picture = element("span", undefined, { role: "gridcell", class: "picture" });
  if (scenes.thumbnail[i]) picture.append(element("img", undefined, { alt: "", "data-src": hrefOf(i, "thumbnail.png") }));
  const name = element("span", undefined, { role: "gridcell", class: "c-id" });
  name.append(element("span", scenes.id[i], { class: "name", title: scenes.id[i] }), element("span", summary(i), { class: "says" }));
  const [status, mark] = STATUS[scenes.status[i]];
  row.append(picture, name, element("span", `${mark} ${status}`, { role: "gridcell", class: "c-status" }));
  for (const [key] of Object.entries(COLUMNS)) row.append(element("span", rounded(scenes[key][i]), { role: "gridcell", class: `c-${key} number` }));
  row.addEventListener("click", () => openScene(i));
  return row;
}

// What a row says of its scene: why it failed, or how many warnings it has.
function summary(i) {
  if (scenes.error[i] !== NEVER) return reasons.failures.texts[scenes.error[i]].filter(Boolean).join(": ");
  const words = [];
  if (scenes.warnings[i].length) words.push(counted(scenes.warnings[i].length, "warning"));
  if (scenes.remarks[i].length) words.push(counted(scenes.remarks[i].length, "remark"));
  return words.join(", ");
}

function showRows() {
  const box = find("table"), first = Math.max(0, Math.floor(box.scrollTop / ROW) - BEYOND);
  const last = Math.min(shown.length, Math.ceil((box.scrollTop + box.clientHeight) / ROW) + BEYOND);
  const seen = new Set(shown.slice(first, last));
  for (const [i, row] of made) if (!seen.has(i)) { row.remove(); made.delete(i); }
  for (let place = first; place < last; place++) {
    const i = shown[place];
    if (!made.has(i)) {
      made.set(i, makeRow(i));
      find("space").append(made.get(i));
    }
    const row = made.get(i);
    row.style.setProperty("transform", `translateY(${place * ROW}px)`);
    row.setAttribute("aria-rowindex", place + 2); // the heads are the first row
    row.classList.toggle("active", place === active);
  }
  if (seen.has(shown[active])) box.setAttribute("aria-activedescendant", `row-${shown[active]}`);
  else box.removeAttribute("aria-activedescendant");
  clearTimeout(waiting);
  waiting = setTimeout(() => {
    for (const image of box.querySelectorAll("img[data-src]")) {
      image.src = image.dataset.src;
      delete image.dataset.src;
    }
  }, SETTLE);
}

function showTable() {
  for (const cell of find("heads").querySelectorAll("[data-key]")) {
    const isSorted = cell.dataset.key === state.sort;
    if (isSorted) cell.setAttribute("aria-sort", state.down ? "descending" : "ascending");
    else cell.removeAttribute("aria-sort");
  }
  find("count").textContent = shown.length === scenes.id.length ? counted(shown.length, "scene") : `${whole(shown.length)} of ${counted(scenes.id.length, "scene")}`;
  find("table").setAttribute("aria-rowcount", shown.length + 1);
  find("space").style.setProperty("height", `${shown.length * ROW}px`);
  active = Math.max(0, Math.min(active, shown.length - 1));
  showRows();
}

function moveRow(to) {
  const box = find("table"), inSight = box.clientHeight - find("heads").offsetHeight;
  active = Math.max(0, Math.min(shown.length - 1, to));
  const top = active * ROW;
  if (top < box.scrollTop) box.scrollTop = top;
  else if (top + ROW > box.scrollTop + inSight) box.scrollTop = top + ROW - inSight;
  showRows();
}

function listenToTable() {
  const box = find("table"), page = () => Math.max(1, Math.floor(box.clientHeight / ROW) - 2);
  let asked = false;
  box.addEventListener("scroll", () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => { asked = false; showRows(); });
  });
  box.addEventListener("keydown", (event) => {
    if (event.target !== box || event.ctrlKey || event.metaKey || event.altKey) return;
    const to = { ArrowDown: active + 1, ArrowUp: active - 1, PageDown: active + page(), PageUp: active - page(), Home: 0, End: shown.length - 1 }[event.key];
    if (to !== undefined) moveRow(to);
    else if (event.key === "Enter" && shown.length) openScene(shown[active]);
    else return;
    event.preventDefault();
  });
  new ResizeObserver(showRows).observe(box);
}

// --- a scene by itself ------------------------------------------------------------------------

function openScene(i) {
  if (shown.includes(i)) moveRow(shown.indexOf(i));
  state.scene = i;
  remember();
  showScene();
}

function showScene() {
  const box = find("scene"), i = state.scene;
  if (i === null) {
    if (box.open) box.close();
    return;
  }
  find("scene-name").textContent = scenes.id[i];
  find("scene-body").replaceChildren(...sceneParts(i));
  const place = shown.indexOf(i);
  find("before").disabled = place <= 0;
  find("after").disabled = place < 0 || place + 1 >= shown.length;
  if (!box.open) box.showModal();
  find("scene-body").scrollTop = 0;
}

function sceneParts(i) {
  const [status, mark] = STATUS[scenes.status[i]], parts = [];
  if (scenes.thumbnail[i]) parts.push(element("img", undefined, { src: hrefOf(i, "thumbnail.png"), alt: `The levels of ${scenes.id[i]}, coloured by rooms`, class: "large" }));
  const files = content.fileLists[scenes.files[i]];
  if (files.length) {
    const links = element("p", undefined, { class: "links" });
    for (const file of [...files].sort((a, b) => rank(a) - rank(b))) links.append(element("a", file, { href: hrefOf(i, file) }));
    parts.push(links);
  }
  if (scenes.error[i] !== NEVER) parts.push(element("p", summary(i), { class: "reason" }));
  const facts = element("dl"), ended = moment(scenes.ended[i]);
  const rows = [["status", `${mark} ${status}`], ...Object.entries(COLUMNS).map(([key, [name, unit]]) => [name, withUnit(scenes[key][i], unit)])];
  rows.push(["ended", ended], ["version", scenes.version[i]], ["source", scenes.source[i]]);
  for (const [name, value] of rows) if (value) facts.append(fact(name, value, name === "source" ? "whole" : ""));
  parts.push(facts);
  for (const [kind, title] of [["warnings", "Warnings"], ["remarks", "Audit"]]) {
    if (!scenes[kind][i].length) continue;
    const list = element("ul", undefined, { class: kind });
    for (const text of scenes[kind][i]) list.append(element("li", reasons[kind].texts[text][1]));
    parts.push(element("h3", title), list);
  }
  if (scenes.stages[i].some((seconds) => seconds > 0)) parts.push(element("h3", "Where its time went"), stageBars(scenes.stages[i], scenes.seconds[i]));
  return parts;
}

// The page of a scene first, then pictures.
const rank = (file) => ["report.html", "picture.png"].indexOf(file) >>> 0;

function fact(name, value, kind = "") {
  const box = element("div", undefined, { class: kind });
  box.append(element("dt", name), element("dd", value));
  return box;
}

// Stages of the bake, and what else the whole time went into: products, the audit, files.
function stageBars(seconds, whole) {
  const baked = seconds.reduce((all, each) => all + (each || 0), 0), total = Math.max(whole || 0, baked), list = element("ul", undefined, { class: "stages" });
  [...content.stageNames.map((name, k) => [name, seconds[k] || 0]), ["besides the bake", total - baked]].filter(([, each]) => each > 0).sort((a, b) => b[1] - a[1]).forEach(([name, each]) => {
    const line = element("li"), bar = element("span", "", { class: "share" });
    bar.style.setProperty("width", `${(100 * each) / total}%`);
    line.append(element("span", name), element("span", `${withUnit(each, "s")}, ${Math.round((100 * each) / total)} %`, { class: "number" }), bar);
    list.append(line);
  });
  return list;
}

function step(by) {
  const place = shown.indexOf(state.scene) + by;
  if (shown[place] !== undefined) openScene(shown[place]);
}

function listenToScene() {
  const box = find("scene");
  find("before").addEventListener("click", () => step(-1));
  find("after").addEventListener("click", () => step(1));
  find("close").addEventListener("click", () => box.close());
  box.addEventListener("click", (event) => { if (event.target === box) box.close(); }); // beside it
  box.addEventListener("close", () => { state.scene = null; remember(); });
  box.addEventListener("keydown", (event) => {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (by === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
    step(by);
    event.preventDefault();
  });
}
