// --- the rest of the page ---------------------------------------------------------------------

const FEW = 6; // groups of reasons that are shown unless all are asked for
const EXAMPLES = 2; // scenes that a group names
const TITLES = { failures: "Failures by reason", warnings: "Warnings", remarks: "Remarks of the audit" };
const groups = {}; // by kind: the scenes of each group
const opened = new Set(); // kinds of which all groups are shown

function gatherGroups() {
  for (const kind of KINDS) {
    const lists = reasons[kind].groups.map(() => []);
    for (let i = 0; i < scenes.id.length; i++) for (const group of new Set(groupsOf(kind, i))) lists[group].push(i);
    groups[kind] = lists.map((numbers, group) => ({ group, numbers })).sort((a, b) => b.numbers.length - a.numbers.length || a.group - b.group);
  }
}

function showGroups(kind) {
  const box = find(kind), all = groups[kind], list = element("ul", undefined, { class: "groups" });
  box.hidden = !all.length;
  if (box.hidden) return;
  const held = document.activeElement && document.activeElement.dataset.group; // by the keyboard
  for (const { group, numbers } of opened.has(kind) ? all : all.filter((each, k) => k < FEW || each.group === state[kind])) {
    const line = element("li"), isOn = state[kind] === group;
    const press = button("", () => choose({ [kind]: isOn ? null : group }), { "aria-pressed": String(isOn), "data-group": `${kind} ${group}` });
    press.append(element("span", whole(numbers.length), { class: "much" }), element("span", nameOf(kind, group)));
    const some = element("span", undefined, { class: "some" });
    for (const i of numbers.slice(0, EXAMPLES)) some.append(button(scenes.id[i], () => openScene(i), { class: "link" }));
    if (numbers.length > EXAMPLES) some.append(element("span", `and ${whole(numbers.length - EXAMPLES)} more`));
    line.append(press, some);
    list.append(line);
  }
  const title = element("h2", TITLES[kind], { id: `${kind}-title` });
  const parts = [title, list];
  if (all.length > FEW) parts.push(button(opened.has(kind) ? "Fewer" : `All ${whole(all.length)} reasons`, () => { opened.has(kind) ? opened.delete(kind) : opened.add(kind); showGroups(kind); }));
  box.replaceChildren(...parts);
  const again = held && [...box.querySelectorAll("[data-group]")].find((each) => each.dataset.group === held);
  if (again) again.focus();
}

function showStatuses() {
  const box = find("statuses"), held = box.contains(document.activeElement) ? [...box.children].indexOf(document.activeElement) : -1;
  const entries = [[null, "all", "", content.total], ...STATUS.map(([name, mark], k) => [k, name, mark, content.counts[k]])];
  box.replaceChildren(...entries.filter(([key, , , count]) => key === null || count).map(([key, name, mark, count]) => {
    const press = button("", () => choose({ status: state.status === key ? null : key }), { "aria-pressed": String(state.status === key), class: name });
    press.append(element("strong", whole(count)), ` ${mark} ${name}`);
    return press;
  }));
  if (held >= 0 && box.children[held]) box.children[held].focus();
}

function showChosen() {
  const chips = [];
  const chip = (text, changes) => chips.push(button(`${text} \u2715`, () => choose(changes), { "aria-label": `${text}: don't choose by it` }));
  if (state.status !== null) chip(STATUS[state.status][0], { status: null });
  if (state.text) chip(`\u201c${state.text}\u201d`, { text: "" });
  for (const [key, range] of Object.entries(state.ranges)) {
    const { [key]: out, ...ranges } = state.ranges;
    chip(`${COLUMNS[key][0]} ${charts[key] ? rangeText(charts[key], range[0], range[1]) : ""}`, { ranges });
  }
  for (const kind of KINDS) if (state[kind] !== null) chip(nameOf(kind, state[kind]), { [kind]: null });
  if (chips.length > 1) chips.push(button("Show all", () => choose({ status: null, text: "", ranges: {}, failures: null, warnings: null, remarks: null }), { class: "link" }));
  find("chosen").replaceChildren(...chips);
  if (find("text").value !== state.text) find("text").value = state.text;
}

function showAll() {
  showStatuses();
  for (const kind of KINDS) showGroups(kind);
  showCharts();
  showChosen();
  showTable();
}

function showFacts() {
  const [ok, failed] = content.counts, sums = content.sums, facts = [], ended = ok + failed;
  if (content.work > 0) facts.push(["time baking", duration(content.work)], ["rate", rate(ended, content.work)]);
  if (sums.seconds > 0) facts.push(["time of all scenes", duration(sums.seconds)]);
  if (ok) facts.push(["free area", withUnit(sums.freeArea, "m\u00b2")], ["cells", whole(sums.cells)], ["rooms", whole(sums.rooms)]);
  if (sums.warned) facts.push(["with warnings", counted(sums.warned, "scene")]);
  if (sums.remarked) facts.push(["with remarks of the audit", counted(sums.remarked, "scene")]);
  if (sums.versions.length) facts.push(["navbake", sums.versions.join(", ")]);
  find("facts").replaceChildren(...facts.map(([name, value]) => fact(name, value)));
  const notes = [];
  if (content.total > scenes.id.length) notes.push(`These are sums of all ${counted(content.total, "scene")}. Below, the page shows ${whole(scenes.id.length)} of them, those that failed first.`);
  if (content.noRows) notes.push(`${counted(content.noRows, "line")} of the index ${content.noRows === 1 ? "is" : "are"} none of a batch's.`);
  find("notes").textContent = notes.join(" ");
}

function showProgress() {
  find("made").textContent = `as of ${moment(content.made)}`;
  if (!content.progress) return;
  const [done, total] = content.progress;
  find("progress").hidden = false;
  Object.assign(find("progressbar"), { max: total, value: done });
  find("progresstext").textContent = `It still runs: ${whole(done)} of ${counted(total, "scene")}`;
}

function showTimes() {
  const { stages, staged } = content.sums;
  if (!stages.some((seconds) => seconds > 0)) return;
  const box = element("details"), head = element("summary");
  head.append(element("h2", "Where the time went"));
  box.append(head, stageBars(stages, staged));
  find("times").append(box);
}

async function begin() {
  content = await unpack(JSON.parse(find("content").textContent).packed);
  scenes = content.scenes;
  reasons = { failures: content.errors, warnings: content.warnings, remarks: content.remarks };
  find("title").textContent = content.title;
  showProgress();
  showFacts();
  showTimes();
  gatherGroups();
  makeCharts();
  makeHeads();
  listenToTable();
  listenToScene();
  recall();
  find("reload").addEventListener("click", () => location.reload());
  find("text").addEventListener("input", () => choose({ text: find("text").value }));
  window.addEventListener("hashchange", () => { recall(); update(); showScene(); });
  update();
  showScene();
  document.body.dataset.ready = "yes";
}

begin();
