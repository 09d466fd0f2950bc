// What became of the scenes of a batch: by status, by reason, by size, and one by one.
const COLUMNS = { // of the table and of the charts: name, and unit
  freeArea: ["free area", "m\u00b2"], cells: ["cells", ""], levels: ["levels", ""], rooms: ["rooms", ""], doors: ["doors", ""], seconds: ["time", "s"],
};
const MARKS = { ok: "\u2713", failed: "\u2715", left: "\u2013" };
const TITLES = { failures: "Failures by reason", warnings: "Warnings", remarks: "Remarks of the audit" };
const FEW = 6, EXAMPLES = 2, ROWS = 100; // groups shown unless all are asked for; scenes that a group names; rows of a table
const NOTHING = { status: null, text: "", ranges: {}, failures: null, warnings: null, remarks: null };

let batch, scenes, shown = []; // set when the content is unpacked; the scenes that are chosen, in the table's order
// What is chosen; the address holds it, so that a reload or a copied link shows the same.
const state = { ...NOTHING, sort: null, down: false, scene: null };
const opened = new Set(); // kinds of which all groups are shown
let numRows = ROWS;

// --- words ------------------------------------------------------------------------------------

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

// The page of a scene first, then pictures. A name with `:` or `..` stays one in its folder.
const rank = (file) => ["report.html", "picture.png"].indexOf(file) >>> 0;
function hrefOf(scene, file) {
  const parts = `${scene.id}/${file}`.split("/").map(encodeURIComponent);
  return [...(batch.base.startsWith("/") ? [] : ["."]), batch.base, ...parts].join("/");
}

// What a row says of its scene: why it failed, or how many warnings it has.
function summary(scene) {
  const words = [...scene.failures];
  if (scene.warnings.length) words.push(counted(scene.warnings.length, "warning"));
  if (scene.remarks.length) words.push(counted(scene.remarks.length, "remark"));
  return words.join(", ");
}

// --- what is chosen ---------------------------------------------------------------------------

const groupsOf = (kind, scene) => scene[kind].map((text) => batch.groups[kind][text]);
const inRange = (value, [from, to], last) => value !== null && value >= from && (value < to || to === last);

// Whether a scene is chosen; `but` names a choice that doesn't count.
function isChosen(scene, but) {
  if (state.status !== null && but !== "status" && scene.status !== state.status) return false;
  for (const [key, range] of Object.entries(state.ranges)) if (key !== but && !inRange(scene[key], range, batch.edges[key].at(-1))) return false;
  for (const kind of Object.keys(TITLES)) if (state[kind] !== null && kind !== but && !groupsOf(kind, scene).includes(state[kind])) return false;
  const words = [scene.id, scene.source, ...scene.failures, ...scene.warnings, ...scene.remarks];
  return !state.text || words.join("\n").toLowerCase().includes(state.text.toLowerCase());
}

function choose(changes) {
  Object.assign(state, changes);
  numRows = ROWS;
  shown = scenes.filter((scene) => isChosen(scene));
  const key = state.sort, sign = state.down ? -1 : 1, order = new Intl.Collator("en", { numeric: true }).compare;
  if (key) shown.sort((a, b) => { // scenes without a value come last
    const [one, other] = [a[key], b[key]];
    if (one === null || other === null) return (one === null) - (other === null);
    return sign * (typeof one === "string" ? order(one, other) : one - other);
  });
  remember();
  showStatuses();
  for (const kind of Object.keys(TITLES)) showGroups(kind);
  showCharts();
  showChosen();
  showTable();
}

function remember() {
  const kept = Object.entries(state).filter(([key, value]) => JSON.stringify(value) !== JSON.stringify(NOTHING[key] ?? null));
  history.replaceState(null, "", `#${encodeURIComponent(JSON.stringify(Object.fromEntries(kept)))}`);
}

function recall() {
  let kept = {};
  try { kept = JSON.parse(decodeURIComponent(location.hash.slice(1))); } catch { /* another's address */ }
  const known = Object.keys(COLUMNS), ranges = Object.entries(kept.ranges || {}).filter(([key, range]) => batch.edges[key]?.length && Array.isArray(range));
  Object.assign(state, NOTHING, kept, { ranges: Object.fromEntries(ranges), text: String(kept.text || ""), scene: null });
  if (!["id", "status", ...known].includes(state.sort)) state.sort = null;
  choose({});
  if (scenes.some((scene) => scene.id === kept.scene)) openScene(scenes.findIndex((scene) => scene.id === kept.scene));
}

// --- the page ---------------------------------------------------------------------------------

function showStatuses() {
  const entries = [[null, "all", batch.total], ...Object.entries(batch.counts).filter(([, count]) => count).map(([name, count]) => [name, `${MARKS[name]} ${name}`, count])];
  find("statuses").replaceChildren(...entries.map(([status, text, count]) => button(`${whole(count)} ${text}`, () => choose({ status: state.status === status ? null : status }), { "aria-pressed": String(state.status === status), class: status })));
}

function showGroups(kind) {
  const box = find(kind), members = new Map(Object.values(batch.groups[kind]).map((group) => [group, []]));
  for (const scene of scenes) for (const group of new Set(groupsOf(kind, scene))) members.get(group).push(scene);
  const all = [...members].sort((a, b) => b[1].length - a[1].length), list = element("ul", undefined, { class: "groups" });
  box.hidden = !all.length;
  for (const [group, own] of opened.has(kind) ? all : all.filter(([name], k) => k < FEW || name === state[kind])) {
    const line = element("li"), isOn = state[kind] === group;
    const press = button("", () => choose({ [kind]: isOn ? null : group }), { "aria-pressed": String(isOn) });
    press.append(element("strong", whole(own.length)), ` ${group}`);
    line.append(press, ...own.slice(0, EXAMPLES).map((scene) => button(scene.id, () => openScene(scenes.indexOf(scene)), { class: "link" })));
    if (own.length > EXAMPLES) line.append(element("span", `and ${whole(own.length - EXAMPLES)} more`, { class: "soft" }));
    list.append(line);
  }
  const more = all.length <= FEW ? [] : [button(opened.has(kind) ? "Fewer" : `All ${whole(all.length)} reasons`, () => { opened.has(kind) ? opened.delete(kind) : opened.add(kind); showGroups(kind); })];
  box.replaceChildren(element("h2", TITLES[kind]), list, ...more);
}

// The range of some bars in words; a bar of whole numbers that is as wide as one has one number.
function rangeText(key, from, to) {
  const unit = COLUMNS[key][1], edges = batch.edges[key], isWhole = edges.every(Number.isInteger);
  if (isWhole && to - from === 1) return withUnit(from, unit);
  return `${rounded(from)} to ${to === edges.at(-1) ? "" : "below "}${withUnit(to, unit)}`;
}

function showCharts() {
  find("distributions").hidden = !Object.values(batch.edges).some((edges) => edges.length);
  find("charts").replaceChildren(...Object.keys(batch.edges).filter((key) => batch.edges[key].length).map(chart));
}

// Of each bar all its scenes, and the part of them that all other choices leave.
function chart(key) {
  const edges = batch.edges[key], range = state.ranges[key], [name, unit] = COLUMNS[key];
  const box = element("figure"), bars = element("div", undefined, { class: "bars" }), told = element("p", "", { role: "status" });
  const counts = edges.slice(1).map(() => [0, 0]);
  for (const scene of scenes) {
    if (scene[key] === null) continue;
    const above = edges.findIndex((edge) => edge > scene[key]), bin = counts[(above < 0 ? edges.length - 1 : above) - 1];
    bin[0]++;
    if (isChosen(scene, key)) bin[1]++;
  }
  const most = Math.max(...counts.map(([all]) => all));
  const tell = (text) => { told.textContent = text; };
  const chosen = range ? `shown: ${rangeText(key, ...range)}` : "";
  counts.forEach(([all, some], k) => {
    const [from, to] = [edges[k], edges[k + 1]], isOn = Boolean(range) && from >= range[0] && to <= range[1];
    const text = `${rangeText(key, from, to)}: ${counted(all, "scene")}${some === all ? "" : `, ${whole(some)} shown`}`;
    const bar = button("", (event) => pressBar(key, from, to, event.shiftKey), { "aria-pressed": String(isOn), "aria-label": text, class: range && !isOn ? "out" : "" });
    for (const [number, kind] of [[all, "all"], [some, "some"]]) {
      const part = element("span", "", { class: kind });
      part.style.setProperty("height", number ? `max(2px, ${(100 * number) / most}%)` : "0");
      bar.append(part);
    }
    for (const event of ["pointerenter", "focus"]) bar.addEventListener(event, () => tell(text));
    for (const event of ["pointerleave", "blur"]) bar.addEventListener(event, () => tell(chosen));
    bars.append(bar);
  });
  const ends = element("div", undefined, { class: "ends soft" });
  ends.append(element("span", rounded(edges[0])), element("span", rounded(edges.at(-1))));
  tell(chosen);
  box.append(element("strong", name), unit ? ` [${unit}]` : "", bars, ends, told);
  return box;
}

function pressBar(key, from, to, isMore) {
  const { [key]: before, ...ranges } = state.ranges;
  if (before && isMore) ranges[key] = [Math.min(from, before[0]), Math.max(to, before[1])];
  else if (!before || before[0] !== from || before[1] !== to) ranges[key] = [from, to];
  choose({ ranges });
}

function showChosen() {
  const chips = [], chip = (text, changes) => chips.push(button(`${text} \u2715`, () => choose(changes), { "aria-label": `${text}: don't choose by it` }));
  if (state.status !== null) chip(state.status, { status: null });
  if (state.text) chip(`\u201c${state.text}\u201d`, { text: "" });
  for (const [key, range] of Object.entries(state.ranges)) {
    const { [key]: out, ...ranges } = state.ranges;
    chip(`${COLUMNS[key][0]} ${rangeText(key, ...range)}`, { ranges });
  }
  for (const kind of Object.keys(TITLES)) if (state[kind] !== null) chip(state[kind], { [kind]: null });
  if (chips.length > 1) chips.push(button("Show all", () => choose(NOTHING), { class: "link" }));
  find("chosen").replaceChildren(...chips);
  if (find("text").value !== state.text) find("text").value = state.text;
}

// Up, down, then in the batch's order again; numbers begin with the largest.
function sortBy(key) {
  const first = key in COLUMNS;
  if (state.sort !== key) choose({ sort: key, down: first });
  else choose(state.down === first ? { down: !first } : { sort: null, down: false });
}

function showTable() {
  find("count").textContent = shown.length === scenes.length ? counted(shown.length, "scene") : `${whole(shown.length)} of ${counted(scenes.length, "scene")}`;
  const keys = Object.keys(COLUMNS), heads = [["id", "scene"], ["status", "status"], ...keys.map((key) => [key, COLUMNS[key].filter(Boolean).join(" in ")])];
  const made = table(
    ["", ...heads.map(([key, text]) => button(text + (state.sort === key ? (state.down ? " \u2193" : " \u2191") : ""), () => sortBy(key), { class: "link" }))],
    shown.slice(0, numRows).map((scene) => {
      const name = element("div");
      name.append(button(scene.id, () => openScene(scenes.indexOf(scene)), { class: "link name" }), element("p", summary(scene), { class: "soft" }));
      const picture = scene.thumbnail ? element("img", undefined, { alt: "", loading: "lazy", src: hrefOf(scene, "thumbnail.png") }) : "";
      return [picture, name, element("span", `${MARKS[scene.status]} ${scene.status}`, { class: scene.status }), ...keys.map((key) => rounded(scene[key]))];
    }),
    keys.map((_, k) => k + 3),
  );
  const left = shown.length - numRows;
  find("table").replaceChildren(made, ...(left > 0 ? [button(`Show more: ${whole(left)} left`, () => { numRows *= 10; showTable(); })] : []));
}

// --- a scene by itself ------------------------------------------------------------------------

function openScene(i) {
  const scene = scenes[i], box = find("scene"), place = shown.indexOf(scene);
  state.scene = scene.id;
  remember();
  const step = (by) => openScene(scenes.indexOf(shown[place + by])), head = element("div", undefined, { class: "buttons" });
  head.append(
    element("h2", scene.id, { id: "scene-name" }),
    button("\u2190", () => step(-1), { id: "before", "aria-label": "Scene before, arrow key left" }),
    button("\u2192", () => step(1), { id: "after", "aria-label": "Scene after, arrow key right" }),
    button("\u2715", () => box.close(), { id: "close", "aria-label": "Close" }),
  );
  box.replaceChildren(head, ...sceneParts(scene));
  find("before").disabled = place <= 0;
  find("after").disabled = place < 0 || place + 1 >= shown.length;
  if (!box.open) box.showModal();
}

function sceneParts(scene) {
  const parts = [], rows = [["status", `${MARKS[scene.status]} ${scene.status}`], ...Object.entries(COLUMNS).map(([key, [name, unit]]) => [name, withUnit(scene[key], unit)])];
  rows.push(["ended", moment(scene.ended)], ["version", scene.version], ["source", scene.source]);
  if (scene.thumbnail) parts.push(element("img", undefined, { src: hrefOf(scene, "thumbnail.png"), alt: `The levels of ${scene.id}, coloured by rooms` }));
  const links = element("p"), box = element("dl"), files = [...scene.files].sort((a, b) => rank(a) - rank(b));
  links.append(...files.map((file) => element("a", file, { href: hrefOf(scene, file) })));
  box.append(...facts(rows.filter(([, value]) => value)));
  parts.push(links, ...scene.failures.map((text) => element("p", text, { class: "reason" })), box);
  for (const [kind, title] of [["warnings", "Warnings"], ["remarks", "Audit"]]) {
    const list = element("ul");
    list.append(...scene[kind].map((text) => element("li", text)));
    if (scene[kind].length) parts.push(element("h3", title), list);
  }
  if (Object.keys(scene.stages).length) parts.push(element("h3", "Where its time went"), stageTable(scene.stages, scene.seconds));
  return parts;
}

// Stages of the bake, and what else the whole time went into: products, the audit, files.
function stageTable(stages, seconds) {
  const baked = Object.values(stages).reduce((all, each) => all + each, 0), total = Math.max(seconds || 0, baked);
  const rows = [...Object.entries(stages), ["besides the bake", total - baked]].filter(([, each]) => each > 0).sort((a, b) => b[1] - a[1]);
  return table(["stage", "time", "share"], rows.map(([name, each]) => [name, withUnit(each, "s"), `${Math.round((100 * each) / total)} %`]), [1, 2]);
}

// --- what doesn't follow from choices ------------------------------------------------------------

function showFacts() {
  const { ok, failed } = batch.counts, sums = batch.sums, entries = [], notes = [];
  if (batch.work > 0) entries.push(["time baking", duration(batch.work)], ["rate", `${rounded(((ok + failed) / batch.work) * 60)} a minute`]);
  if (sums.seconds > 0) entries.push(["time of all scenes", duration(sums.seconds)]);
  if (ok) entries.push(["free area", withUnit(sums.freeArea, "m\u00b2")], ["cells", whole(sums.cells)], ["rooms", whole(sums.rooms)]);
  if (sums.warnings) entries.push(["with warnings", counted(sums.warnings, "scene")]);
  if (sums.remarks) entries.push(["with remarks of the audit", counted(sums.remarks, "scene")]);
  if (sums.versions.length) entries.push(["navbake", sums.versions.join(", ")]);
  find("facts").replaceChildren(...facts(entries));
  if (batch.total > scenes.length) notes.push(`These are sums of all ${counted(batch.total, "scene")}. Below, the page shows ${whole(scenes.length)} of them, those that failed first.`);
  if (batch.noRows) notes.push(`${counted(batch.noRows, "line")} of the index ${batch.noRows === 1 ? "is" : "are"} none of a batch's.`);
  find("notes").textContent = notes.join(" ");
  find("title").textContent = batch.title;
  find("made").textContent = `as of ${moment(batch.made)}`;
  if (Object.keys(sums.stages).length) find("times").append(folder("Where the time went", "", stageTable(sums.stages, sums.staged), false));
  if (!batch.progress) return;
  const [value, max] = batch.progress;
  find("progress").hidden = false;
  find("progress").append(element("progress", "", { value, max, "aria-label": "Scenes that ended" }), `It still runs: ${whole(value)} of ${counted(max, "scene")}`, button("Reload", () => location.reload()));
}

async function begin() {
  batch = await inflate(content.packed).json();
  scenes = batch.scenes;
  showFacts();
  const box = find("scene");
  box.addEventListener("click", (event) => { if (event.target === box) box.close(); }); // beside it
  box.addEventListener("close", () => { state.scene = null; remember(); });
  box.addEventListener("keydown", (event) => {
    const press = { ArrowRight: "after", ArrowLeft: "before" }[event.key];
    if (press && !event.ctrlKey && !event.metaKey && !event.altKey) find(press).click();
  });
  find("text").addEventListener("input", () => choose({ text: find("text").value }));
  window.addEventListener("hashchange", recall);
  recall();
  document.body.dataset.ready = "yes";
}

begin();
