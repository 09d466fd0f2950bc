// A map of each level, and tables.
const canvas = find("canvas"), pen = canvas.getContext("2d");
const GOLDEN = 137.5; // degrees of hue between the colours of kinds of marks
const NEAR = 9; // how near the pointer is to a mark that it points at [pixels]
const ABOVE = 14; // by which the name of a point stands over it [pixels]
const DOOR_COLOR = "#b02a1e", LINK_COLOR = "#ff3d78", CLOSED_COLOR = "#868e96", STAIRS_COLOR = "#222";
const BAR = 110; // longest bar of the scale [pixels]

const HINT = "Point at a cell to read what the grid knows of it. Drag to move, scroll to zoom.";
const state = { sheet: 0, level: 0, layer: "", hidden: new Set(), pointed: null };
const view = { x: 0, y: 0, scale: 1 }; // world x, y [m] of the canvas' middle, pixels a metre
let isFitted = false; // whether the view shows all of the level: until the reader moves or zooms it

const sheet = () => content.sheets[state.sheet];
const level = () => sheet().levels[state.level];
const layer = () => level().layers.find((each) => each.name === state.layer) || level().layers[0];
const shownMarks = () => level().marks.filter((mark) => !state.hidden.has(mark.kind));
const kindsOf = (levels) => [...new Set(levels.flatMap((each) => each.marks.map((mark) => mark.kind)))].sort();

// A row of buttons, of which one is pressed, or selected as a tab is.
function buttons(box, names, chosen, choose) {
  const on = find(box).role === "tablist" ? "aria-selected" : "aria-pressed";
  find(box).replaceChildren(...(names.length > 1 ? names.map((name, i) => button(name, () => choose(i), { role: find(box).role === "tablist" ? "tab" : "button", [on]: String(i === chosen) })) : []));
}

// --- cells ------------------------------------------------------------------------------------

// Unpack the cells of a level, once: it takes a moment, so it waits until the level is shown.
async function unpackLevel(shown) {
  if (shown.isAsked) return;
  shown.isAsked = true;
  shown.unpacked = await unpack(shown.cells);
  if (state.pointed) tell(...state.pointed);
}

// Row, column and place in what is unpacked; null beside the level.
function cellAt(shown, x, y) {
  const col = Math.floor((x - shown.xMin) / shown.cellSize), row = Math.floor((shown.yMax - y) / shown.cellSize), every = shown.every;
  const at = Math.floor(row / every) * Math.ceil(shown.width / every) + Math.floor(col / every);
  return row < 0 || col < 0 || row >= shown.height || col >= shown.width ? null : [row, col, at];
}

function describe(shown, x, y) {
  const found = cellAt(shown, x, y), { unpacked } = shown;
  if (!found) return "outside of the grid";
  const [row, col, at] = found, place = `row ${row}, col ${col}, cell ${col + row * shown.width}`;
  if (!unpacked) return place;
  const floor = unpacked.floor[at], weight = unpacked.weight[at], room = unpacked.room[at], free = weight !== null;
  const lines = [`${place}: ${floor === null ? "no floor" : `floor ${fixed(floor, 3)} m`}, ${free ? "free" : "blocked"}`], known = [];
  if (free && weight !== 1) known.push(`weight ${weight}`);
  if (free) known.push(`clearance ${unpacked.clearance[at].toFixed(2)} m`, `island ${unpacked.island[at]}`);
  if (room > 0) known.push(`room ${shown.rooms[room] || room}`);
  const names = unpacked.nameLists[unpacked.names[at]] || {}, standing = ["doors", "objects", "walls"].filter((key) => names[key]);
  const blockers = names.blockers || standing.flatMap((key) => names[key]);
  if (known.length) lines.push(known.join(", "));
  if (!free && blockers.length) lines.push(`blocked by ${blockers.join(", ")}`);
  else if (standing.length) lines.push(standing.map((key) => `${key}: ${names[key].join(", ")}`).join("; "));
  return lines.join("\n");
}

// The levels whose cells are read out: of a difference those of both grids.
const describedLevels = () => level().of?.map(([grid, number]) => [`${content.sheets[grid].name}: `, content.sheets[grid].levels[number]]) || [["", level()]];

function tell(x, y) {
  state.pointed = [x, y];
  const own = level(), near = shownMarks().filter((mark) => Math.hypot(mark.x - x, mark.y - y) * view.scale < NEAR), cell = cellAt(own, x, y);
  const change = own.kinds && own.unpacked && cell ? [own.kinds[own.unpacked.change[cell[2]]]] : [];
  const cells = describedLevels().map(([name, shown]) => name + describe(shown, x, y));
  find("pointed").textContent = [`x ${fixed(x, 3)}, y ${fixed(y, 3)} m`, ...near.map((mark) => `${mark.kind}: ${mark.text}`), ...change, ...cells].join("\n");
}

// --- drawing ----------------------------------------------------------------------------------

function pictureOf(drawn) {
  if (!drawn.image) {
    drawn.image = new Image();
    drawn.image.onload = draw;
    drawn.image.src = drawn.png;
  }
  return drawn.image;
}

const toPixels = (x, y) => [(x - view.x) * view.scale + canvas.clientWidth / 2, (view.y - y) * view.scale + canvas.clientHeight / 2];
const toWorld = (px, py) => [view.x + (px - canvas.clientWidth / 2) / view.scale, view.y - (py - canvas.clientHeight / 2) / view.scale];

function draw() {
  if (!level()) return; // two grids may have no level in common
  const ratio = window.devicePixelRatio || 1, own = level(), drawn = layer(), image = pictureOf(drawn);
  const size = [canvas.clientWidth, canvas.clientHeight].map((each) => Math.round(each * ratio));
  if (String(size) !== String([canvas.width, canvas.height])) [canvas.width, canvas.height] = size;
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, ...size);
  if (image.complete && image.naturalWidth) {
    // a picture of every n-th cell is n times as large; the last row and column may reach beyond
    const pixel = own.cellSize * own.every * view.scale;
    pen.imageSmoothingEnabled = pixel < 1;
    pen.drawImage(image, ...toPixels(own.xMin, own.yMax), image.naturalWidth * pixel, image.naturalHeight * pixel);
  }
  for (const door of drawn.doors) { // closed from jamb to jamb; one that lets through is dashed
    const closed = door.state === "closed";
    pen.setLineDash(closed ? [] : [3, 3]);
    stroke([[toPixels(...door.start), toPixels(...door.end)]], [["#fff", 4], [DOOR_COLOR, closed ? 3 : 2]]);
  }
  for (const way of drawn.ways) { // on this level; names say where else it stops
    pen.setLineDash(way.closed ? [4, 3] : []);
    const stops = way.stops.map((stop) => stop && toPixels(...stop)), color = way.link ? (way.closed ? CLOSED_COLOR : LINK_COLOR) : STAIRS_COLOR;
    stroke(stops.slice(1).flatMap((to, i) => (stops[i] && to ? [[stops[i], to]] : [])), [["#fff", 4], [color, 2]]);
    stops.forEach((stop, i) => { if (stop && way.link) drawStop(stop, color, way.oneWay && i > 0); });
  }
  pen.setLineDash([]);
  drawLabels(drawn);
  for (const mark of shownMarks()) {
    const [px, py] = toPixels(mark.x, mark.y);
    Object.assign(pen, { lineWidth: 2, strokeStyle: colorOf(mark.kind) });
    pen.strokeRect(px - 5, py - 5, 10, 10);
  }
  if (state.pointed) {
    const [px, py] = toPixels(...state.pointed);
    stroke([[[px - 8, py], [px + 8, py]], [[px, py - 8], [px, py + 8]]], [["#fff", 3], ["#000", 1]]);
  }
  const most = BAR / view.scale, power = 10 ** Math.floor(Math.log10(most)), metres = [5, 2, 1].map((n) => n * power).find((n) => n <= most);
  find("barline").style.setProperty("width", `${metres * view.scale}px`);
  find("bartext").textContent = metres >= 1 ? `${metres} m` : `${+(metres * 100).toPrecision(1)} cm`;
}

// Lines, each in several colours and widths over each other.
function stroke(lines, strokes) {
  for (const [color, width] of strokes) {
    Object.assign(pen, { strokeStyle: color, lineWidth: width });
    pen.beginPath();
    for (const [from, to] of lines) { pen.moveTo(...from); pen.lineTo(...to); }
    pen.stroke();
  }
}

// Where a link stops: a disc, or a square where one only arrives.
function drawStop([px, py], color, arrives) {
  Object.assign(pen, { fillStyle: color, strokeStyle: "#fff", lineWidth: 1.5 });
  pen.setLineDash([]);
  pen.beginPath();
  if (arrives) pen.rect(px - 4, py - 4, 8, 8); else pen.arc(px, py, 5, 0, 2 * Math.PI);
  pen.fill();
  pen.stroke();
}

// Names of rooms: those that fit into their rooms, in full or as their number; none over another.
// A name without a width is that of a point, and stands beside it, off what has to be kept clear.
function drawLabels(drawn) {
  Object.assign(pen, { font: "600 13px system-ui, sans-serif", textAlign: "center", textBaseline: "middle", lineWidth: 3, lineJoin: "round", strokeStyle: "rgba(255, 255, 255, 0.85)", fillStyle: "#111" });
  // left, top, right and bottom [pixels]
  const boxAt = (px, py, half) => [px - half, py - 8, px + half, py + 8];
  const overlaps = ([left, top, right, bottom], other) => left < other[2] && right > other[0] && top < other[3] && bottom > other[1];
  const taken = [], clear = (drawn.keepClear || []).map(([xMin, yMin, xMax, yMax]) => [...toPixels(xMin, yMax), ...toPixels(xMax, yMin)]);
  for (const label of [...drawn.labels].sort((a, b) => b.width - a.width)) {
    const [px, py] = toPixels(label.x, label.y), room = label.width ? label.width * view.scale : Infinity;
    const text = [label.text, label.fallback].find((each) => pen.measureText(each).width < room) || "", half = pen.measureText(text).width / 2 + 2;
    const places = label.width ? [[px, py]] : [1, 2, 3].flatMap((n) => [[px, py - n * ABOVE], [px, py + n * ABOVE], [px + half + n * ABOVE, py], [px - half - n * ABOVE, py]]);
    const place = text && places.find(([x, y]) => ![...taken, ...(label.width ? [] : clear)].some((other) => overlaps(boxAt(x, y, half), other)));
    if (!place) continue;
    taken.push(boxAt(...place, half));
    pen.strokeText(text, ...place);
    pen.fillText(text, ...place);
  }
}

const colorOf = (kind) => `hsl(${(330 + kindsOf(content.sheets.flatMap((each) => each.levels)).indexOf(kind) * GOLDEN) % 360} 85% 45%)`;

function fit() {
  const own = level(), width = own.width * own.cellSize, height = own.height * own.cellSize;
  Object.assign(view, { x: own.xMin + width / 2, y: own.yMax - height / 2, scale: 0.96 * Math.min(canvas.clientWidth / width, canvas.clientHeight / height) });
  isFitted = true;
  draw();
}

// Zoom so that what is at the pixel stays there.
function zoom(factor, px = canvas.clientWidth / 2, py = canvas.clientHeight / 2) {
  const [x, y] = toWorld(px, py);
  view.scale = Math.min(1e5, Math.max(1e-3, view.scale * factor));
  const [nx, ny] = toWorld(px, py);
  move(x - nx, y - ny);
}

function move(x, y) {
  view.x += x;
  view.y += y;
  isFitted = false;
  draw();
}

// --- the page ---------------------------------------------------------------------------------

function showSheet() {
  const own = sheet();
  buttons("grids", content.sheets.map((each) => each.name), state.sheet, (i) => {
    Object.assign(state, { sheet: i, level: Math.max(0, Math.min(state.level, content.sheets[i].levels.length - 1)) });
    showSheet();
  });
  find("facts").replaceChildren(...facts(own.facts));
  find("warnings").replaceChildren(...own.warnings.map((text) => element("li", coded(text))));
  find("tables").replaceChildren(...own.tables.map((made) => {
    const rows = [table(made.columns, made.rows, made.numbers), ...(made.more ? [element("p", `and ${made.more} more`)] : [])], count = made.rows.length + made.more;
    const box = element("details", [
      element("summary", [element("h2", made.title), element("span", ` ${count}`, { class: "soft" })]),
      element("div", rows, { class: "scroll", tabindex: "0", role: "group", "aria-label": made.title }),
    ]);
    box.open = count <= 40 && !made.folded;
    return box;
  }));
  document.querySelector(".map").hidden = own.levels.length === 0;
  if (!own.levels.length) return;
  showLevel();
  fit();
}

function showLevel(pointed = null) {
  const own = sheet(), shown = level(), drawn = layer();
  Object.assign(state, { layer: drawn.name, pointed });
  if (!pointed) find("pointed").textContent = HINT;
  buttons("levels", own.levels.map((each) => each.name), state.level, (i) => { state.level = i; showLevel(); });
  buttons("layers", shown.layers.map((each) => each.name), shown.layers.indexOf(drawn), (i) => { state.layer = shown.layers[i].name; showLevel(state.pointed); });
  find("note").textContent = shown.every > 1 ? `There are many cells: the map shows one of ${shown.every} rows and one of ${shown.every} columns.` : "";
  find("legend").replaceChildren(...(drawn.title ? [element("strong", drawn.title)] : []), ...(drawn.scale ? showScale(drawn.scale) : []), ...drawn.legend.map(([text, color]) => element("span", [swatch(color), text])), ...lineKinds(drawn).map(([text, color, dashed]) => element("span", [strokeSample(color, dashed), text])));
  find("marks").replaceChildren(...kindsOf([shown]).map((kind) => {
    const tick = element("input", "", { type: "checkbox" });
    tick.checked = !state.hidden.has(kind);
    tick.addEventListener("change", () => { tick.checked ? state.hidden.delete(kind) : state.hidden.add(kind); draw(); });
    return element("label", [tick, swatch(colorOf(kind)), `${kind} (${shown.marks.filter((mark) => mark.kind === kind).length})`]);
  }));
  for (const [, each] of [["", shown], ...describedLevels()]) unpackLevel(each);
  draw();
}

// The kinds of lines on a layer: name, colour, and whether they are dashed.
function lineKinds({ doors, ways }) {
  const kinds = [
    [doors.some((door) => door.state === "closed"), "door, closed", DOOR_COLOR, false],
    [doors.some((door) => door.state !== "closed"), "door, open", DOOR_COLOR, true],
    [ways.some((way) => way.link && !way.closed), "link", LINK_COLOR, false],
    [ways.some((way) => way.link && way.closed), "link, closed", CLOSED_COLOR, true],
    [ways.some((way) => !way.link), "stairs", STAIRS_COLOR, false],
  ];
  return kinds.filter(([isDrawn]) => isDrawn).map(([, ...kind]) => kind);
}

function strokeSample(color, dashed) {
  const line = element("span");
  line.style.setProperty("border-top", `3px ${dashed ? "dashed" : "solid"} ${color}`);
  return element("span", line, { class: "stroke" });
}

function swatch(color) {
  const box = element("span", "", { class: "swatch" });
  box.style.setProperty("background", color);
  return box;
}

function showScale(scale) {
  const strip = element("span", "", { class: "strip" });
  strip.style.setProperty("background", `linear-gradient(to right, ${scale.colors.join(", ")})`);
  const ticks = scale.ticks.map((tick) => {
    const text = element("span", tick.text);
    text.style.setProperty("left", `${100 * tick.position}%`);
    return text;
  });
  return [element("span", scale.label), element("span", [strip, element("span", ticks, { class: "ticks" })], { class: "scale" })];
}

// --- the pointer and the keys -----------------------------------------------------------------

const held = new Map(); // pointers that are down, and where they are [pixels]

const place = (event) => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };

canvas.addEventListener("pointerdown", (event) => { held.set(event.pointerId, place(event)); canvas.setPointerCapture(event.pointerId); });
for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => held.delete(event.pointerId));
canvas.addEventListener("pointermove", (event) => {
  const [px, py] = place(event), before = held.get(event.pointerId), others = [...held].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
  if (before) held.set(event.pointerId, [px, py]);
  if (before && others.length === 1) { // two fingers: their distance is the scale
    const [ox, oy] = others[0];
    zoom(Math.hypot(px - ox, py - oy) / Math.max(1, Math.hypot(before[0] - ox, before[1] - oy)), ox, oy);
    return;
  }
  if (before) move((before[0] - px) / view.scale, (py - before[1]) / view.scale);
  tell(...toWorld(px, py));
  draw();
});
canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(-event.deltaY * 0.0015), ...place(event)); }, { passive: false });
canvas.addEventListener("keydown", (event) => {
  const [x, y] = state.pointed || [view.x, view.y], step = (right, up) => () => { tell(x + right * level().cellSize, y + up * level().cellSize); draw(); };
  const act = { ArrowLeft: step(-1, 0), ArrowRight: step(1, 0), ArrowUp: step(0, 1), ArrowDown: step(0, -1), "+": () => zoom(1.25), "=": () => zoom(1.25), "-": () => zoom(0.8), 0: fit }[event.key];
  if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
  act();
  event.preventDefault();
});

find("zoom").append(...[["+", () => zoom(1.5), "zoom in"], ["\u2212", () => zoom(1 / 1.5), "zoom out"], ["all", fit, "show all"]].map(([text, act, label]) => button(text, act, { "aria-label": label })));
new ResizeObserver(() => { if (isFitted && level()) fit(); else draw(); }).observe(canvas);
showSheet();
