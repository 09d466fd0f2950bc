// What became of the scenes of a batch: by status, by reason, by size, and one by one.
const COLUMNS = { // of the table and of the charts: name, and unit
  free_area: ["free area", "m\u00b2"], cells: ["cells", ""], levels: ["levels", ""], rooms: ["rooms", ""], doors: ["doors", ""], seconds: ["time", "s"],
};
const GROUPS = { status: "Status", failures: "Failures by reason", warnings: "Warnings", audit: "Remarks of the audit" };
const EXAMPLES = 2, ROWS = 100; // scenes that a group names; rows of a table at first
const NOTHING = { text: "", ranges: {}, ...Object.fromEntries(Object.keys(GROUPS).map((kind) => [kind, null])) };

let batch, scenes, shown = [], numRows = ROWS; // `shown`: the scenes that are chosen, in the table's order
// What is chosen; the address holds it, so that a reload or a copied link shows the same.
const state = { ...NOTHING, sort: null, down: false, scene: null };

const withUnit = (value, unit) => (value === null ? "" : `${rounded(value)}${unit ? `\u00a0${unit}` : ""}`);
const duration = (seconds) => (seconds < 120 ? withUnit(seconds, "s") : seconds < 7200 ? withUnit(seconds / 60, "min") : withUnit(seconds / 3600, "h"));
const moment = (text) => (text ? `${text.slice(0, 19).replace("T", " ")} UTC` : "");
const link = (scene) => button(scene.id, () => openScene(scene), { class: "link name" });
const sum = (some, value) => some.reduce((all, each) => all + (value(each) ?? 0), 0);
const hrefOf = (scene, file) => `${batch.base.startsWith("/") ? "" : "./"}${batch.base}/${`${scene.id}/${file}`.split("/").map(encodeURIComponent).join("/")}`;

const groupsOf = (kind, scene) => new Set([scene[kind]].flat().map((text) => batch.groups[kind][text]));
const without = (key) => Object.fromEntries(Object.entries(state.ranges).filter(([other]) => other !== key));
const inRange = (value, [from, to], last) => value !== null && value >= from && (value < to || to === last);

// Whether a scene is chosen; `but` names a choice that doesn't count.
function isChosen(scene, but) {
  scene.words ??= [scene.id, scene.source, ...Object.keys(GROUPS).flatMap((kind) => scene[kind])].join("\n").toLowerCase();
  return scene.words.includes(state.text.toLowerCase())
    && Object.entries(state.ranges).every(([key, range]) => key === but || inRange(scene[key], range, batch.edges[key].at(-1)))
    && Object.keys(GROUPS).every((kind) => state[kind] === null || kind === but || groupsOf(kind, scene).has(state[kind]));
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
  find("groups").replaceChildren(...Object.keys(GROUPS).map(showGroups));
  find("charts").replaceChildren(...Object.keys(batch.edges).filter((each) => batch.edges[each].length).map(chart));
  find("distributions").hidden = !find("charts").children.length;
  showChosen();
  showTable();
  showEpisodes();
}

const remember = () => history.replaceState(null, "", `#${encodeURIComponent(JSON.stringify(state))}`);

function recall() {
  let kept = {};
  try { kept = JSON.parse(decodeURIComponent(location.hash.slice(1))); } catch { /* another's address */ }
  const open = scenes.find((scene) => scene.id === kept.scene);
  choose({ ...NOTHING, sort: null, ...kept, scene: null });
  if (open) openScene(open);
}

function showGroups(kind) {
  const members = new Map(Object.values(batch.groups[kind]).map((group) => [group, []]));
  for (const scene of scenes) for (const group of groupsOf(kind, scene)) members.get(group).push(scene);
  const lines = [...members].filter(([, own]) => own.length).sort((a, b) => b[1].length - a[1].length).map(([group, own]) => {
    const isOn = state[kind] === group, more = own.length > EXAMPLES ? `and ${whole(own.length - EXAMPLES)} more` : "";
    const press = button([element("strong", whole(own.length)), " ", ...coded(group)], () => choose({ [kind]: isOn ? null : group }), { "aria-pressed": String(isOn), class: kind === "status" ? group : "" });
    return element("li", [press, ...own.slice(0, EXAMPLES).map(link), element("span", more, { class: "soft" })]);
  });
  return element("section", lines.length ? [element("h2", GROUPS[kind]), element("ul", lines, { class: "groups" })] : [], { id: kind });
}

// The range of some bars in words; a bar of whole numbers that is as wide as one has one number.
function rangeText(key, from, to) {
  const unit = COLUMNS[key][1], edges = batch.edges[key];
  if (edges.every(Number.isInteger) && to - from === 1) return withUnit(from, unit);
  return `${rounded(from)} to ${to === edges.at(-1) ? "" : "below "}${withUnit(to, unit)}`;
}

// Of each bar all its scenes, and the part of them that all other choices leave.
function chart(key) {
  const edges = batch.edges[key], range = state.ranges[key], [name, unit] = COLUMNS[key];
  const members = edges.slice(1).map((to, k) => scenes.filter((scene) => inRange(scene[key], [edges[k], to], edges.at(-1))));
  const most = Math.max(...members.map((own) => own.length));
  const bars = members.map((own, k) => {
    const [from, to] = [edges[k], edges[k + 1]], isOn = Boolean(range) && from >= range[0] && to <= range[1], some = own.filter((scene) => isChosen(scene, key)).length;
    const text = `${rangeText(key, from, to)}: ${counted(own.length, "scene")}${some === own.length ? "" : `, ${whole(some)} shown`}`;
    const bar = button("", (event) => choose({ ranges: range && event.shiftKey
      ? { ...state.ranges, [key]: [Math.min(from, range[0]), Math.max(to, range[1])] }
      : String(range) === String([from, to]) ? without(key) : { ...state.ranges, [key]: [from, to] } }), { "aria-pressed": String(isOn), "aria-label": text, title: text, class: range && !isOn ? "out" : "" });
    for (const [part, count] of [["--all", own.length], ["--some", some]]) bar.style.setProperty(part, `${(100 * count) / most}%`);
    return bar;
  });
  const ends = [edges[0], edges.at(-1)].map((edge) => element("span", rounded(edge)));
  return element("figure", [element("strong", name), unit ? ` [${unit}]` : "", element("div", bars, { class: "bars" }), element("div", ends, { class: "ends soft" })]);
}

function showChosen() {
  const chips = Object.entries(state.ranges).map(([key, range]) => [`${COLUMNS[key][0]} ${rangeText(key, ...range)}`, { ranges: without(key) }]);
  if (state.text) chips.push([`\u201c${state.text}\u201d`, { text: "" }]);
  for (const kind of Object.keys(GROUPS)) if (state[kind] !== null) chips.push([state[kind], { [kind]: null }]);
  const made = chips.map(([text, changes]) => button(`${text} \u2715`, () => choose(changes), { "aria-label": `${text}: don't choose by it` }));
  find("chosen").replaceChildren(...made, chips.length > 1 ? button("Show all", () => choose(NOTHING), { class: "link" }) : "");
  if (find("text").value !== state.text) find("text").value = state.text;
}

function showTable() {
  const keys = Object.keys(COLUMNS), heads = [["id", "scene"], ["status", "status"], ...keys.map((key) => [key, COLUMNS[key].filter(Boolean).join(" in ")])];
  const notes = ({ failures, warnings, audit }) => [...failures, warnings.length ? counted(warnings.length, "warning") : "", audit.length ? counted(audit.length, "remark") : ""].filter(Boolean);
  const made = table(
    ["", ...heads.map(([key, text]) => button(text + (state.sort === key ? (state.down ? " \u2193" : " \u2191") : ""), () => choose(state.sort === key ? { down: !state.down } : { sort: key, down: key in COLUMNS }), { class: "link" }))],
    shown.slice(0, numRows).map((scene) => [
      scene.thumbnail ? element("img", "", { alt: "", loading: "lazy", src: hrefOf(scene, "thumbnail.png") }) : "",
      element("div", [link(scene), element("p", notes(scene).join(", "), { class: "soft" })]), element("span", scene.status, { class: scene.status }), ...keys.map((key) => rounded(scene[key])),
    ]),
    keys.map((_, k) => k + 3),
  );
  const left = shown.length - numRows;
  find("table").replaceChildren(made, left > 0 ? button(`Show more: ${whole(left)} left`, () => { numRows *= 10; showTable(); }) : "");
  find("count").textContent = shown.length === scenes.length ? counted(shown.length, "scene") : `${whole(shown.length)} of ${counted(scenes.length, "scene")}`;
}

// How many episodes of the scenes that are chosen are in each class of a measure.
function showEpisodes() {
  const drawn = shown.filter((scene) => scene.episodes), names = { distance: "length in m", ratio: "length over straight line", levels: "levels crossed" };
  const classOf = (from, to) => (to === undefined ? `${rounded(from)} and more` : to - from === 1 ? rounded(from) : `${rounded(from)} to below ${rounded(to)}`);
  const tables = Object.entries(batch.classes).map(([key, edges]) => table([names[key], "episodes"],
    edges.map((from, k) => [classOf(from, edges[k + 1]), whole(sum(drawn, (scene) => scene.episodes[key][k]))]), [1]));
  find("episodes").replaceChildren(...(drawn.length ? [element("h2", "Episodes"), element("div", tables, { class: "charts" })] : []));
}

function openScene(scene) {
  const box = find("scene"), place = shown.indexOf(scene);
  state.scene = scene.id;
  remember();
  const step = (text, by, name) => {
    const made = button(text, () => openScene(shown[place + by]), { "aria-label": `Scene ${name}` });
    made.disabled = place < 0 || !shown[place + by];
    return made;
  };
  const steps = { ArrowLeft: step("\u2190", -1, "before"), ArrowRight: step("\u2192", 1, "after") };
  box.onkeydown = (event) => { if (!event.ctrlKey && !event.metaKey && !event.altKey) steps[event.key]?.click(); };
  // the page of a scene first, then pictures
  const rank = (file) => ["report.html", "picture.png"].indexOf(file) >>> 0, files = [...scene.files].sort((a, b) => rank(a) - rank(b));
  const rows = [["status", scene.status], ...Object.entries(COLUMNS).map(([key, [name, unit]]) => [name, withUnit(scene[key], unit)]), ["ended", moment(scene.ended)], ["version", scene.version], ["source", scene.source]];
  const lists = [["Warnings", scene.warnings], ["Audit", scene.audit]].filter(([, texts]) => texts.length);
  box.replaceChildren(
    element("div", [element("h2", scene.id, { id: "scene-name" }), ...Object.values(steps), button("\u2715", () => box.close(), { "aria-label": "Close" })], { class: "buttons" }),
    ...(scene.thumbnail ? [element("img", "", { src: hrefOf(scene, "thumbnail.png"), alt: `The levels of ${scene.id}, coloured by rooms` })] : []),
    element("p", files.map((file) => element("a", file, { href: hrefOf(scene, file) }))),
    ...scene.failures.map((text) => element("p", coded(text), { class: "reason" })), element("dl", facts(rows.filter(([, value]) => value))),
    ...lists.flatMap(([title, texts]) => [element("h3", title), element("ul", texts.map((text) => element("li", coded(text))))]), ...stageTable([scene], "Where its time went"),
  );
  if (!box.open) box.showModal();
}

// Stages of some scenes' bakes, and what else their time went into: products, the audit, files.
function stageTable(some, title) {
  const timed = some.filter((scene) => Object.keys(scene.stages).length), total = sum(timed, (scene) => scene.seconds), spent = {};
  for (const scene of timed) for (const [name, seconds] of Object.entries(scene.stages)) spent[name] = (spent[name] || 0) + seconds;
  spent["besides the bake"] = total - sum(Object.values(spent), (each) => each);
  const rows = Object.entries(spent).filter(([, each]) => each > 0).sort((a, b) => b[1] - a[1]);
  return timed.length ? [element("h3", title), table(["stage", "time", "share"], rows.map(([name, each]) => [name, withUnit(each, "s"), `${Math.round((100 * each) / total)} %`]), [1, 2])] : [];
}

unpack(content.packed).then((unpacked) => {
  batch = unpacked;
  scenes = batch.scenes;
  const tried = scenes.filter((scene) => scene.status !== "left").length, { work } = batch, box = find("scene");
  find("facts").replaceChildren(...facts([
    ["time baking", work ? duration(work) : ""], ["rate", work ? `${rounded((tried / work) * 60)} a minute` : ""], ["time of all scenes", duration(sum(scenes, (scene) => scene.seconds))],
    ...["free_area", "cells", "rooms"].map((key) => [COLUMNS[key][0], withUnit(sum(scenes, (scene) => scene[key]), COLUMNS[key][1])]),
    ["navbake", [...new Set(scenes.map((scene) => scene.version).filter(Boolean))].join(", ")],
  ].filter(([, text]) => text)));
  find("made").textContent = `as of ${moment(batch.made)}`;
  find("times").append(...stageTable(scenes, "Where the time went"));
  find("progress").hidden = !batch.progress;
  const [value, max] = batch.progress || [0, 0];
  find("progress").append(element("progress", "", { value, max, "aria-label": "Scenes that ended" }), `It still runs: ${whole(value)} of ${counted(max, "scene")}`, button("Reload", () => location.reload()));
  box.addEventListener("click", (event) => { if (event.target === box) box.close(); }); // beside it
  box.addEventListener("close", () => { state.scene = null; remember(); });
  find("text").addEventListener("input", () => choose({ text: find("text").value }));
  window.addEventListener("hashchange", recall);
  recall();
  document.body.dataset.ready = "yes";
});
