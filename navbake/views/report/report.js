// A map of each level, and tables.
const canvas = find("canvas"), pen = canvas.getContext("2d");
const GOLDEN = 137.5; // degrees of hue between the colours of kinds of marks
const NEAR = 9; // how near the pointer is to a mark that it points at [pixels]
const ABOVE = 14; // by which the name of a point stands over it [pixels]
const BAR = 110; // longest bar of the scale [pixels]

const HINT = "Point at a cell to read what the grid knows of it. Drag to move, scroll to zoom.";
const state = { sheet: 0, level: 0, layer: "", hidden: new Set(), pointed: null };
const view = { x: 0, y: 0, scale: 1 }; // world x, y [m] of the canvas' middle, pixels a metre
let isFitted = false; // whether the view shows all of the level: until the reader moves or zooms it
const pictures = new Map(), unpacked = new Map();

const sheet = () => content.sheets[state.sheet];
const level = () => sheet().levels[state.level];
const layers = () => level().layers;
const layer = () => layers().find((each) => each.name === state.layer) || layers()[0];

// --- cells ------------------------------------------------------------------------------------

// The cells of a level, unpacked once: it takes a moment, so it waits until the level is shown.
function cellsOf(shown) {
  if (!unpacked.has(shown)) unpacked.set(shown, unpackCells(shown));
  return unpacked.get(shown);
}

async function unpackCells(shown) {
  const cells = shown.cells, made = { cols: Math.ceil(shown.width / cells.every) };
  for (const key of ["floor", "clearance", "room", "island", "weight", "names"]) made[key] = await unpack(cells[key]);
  made.nameLists = await inflate(cells.nameLists).json();
  shown.unpacked = made;
  return made;
}

// Row and column of a place, null beside the level.
function cellAt(shown, x, y) {
  const col = Math.floor((x - shown.xMin) / shown.cellSize), row = Math.floor((shown.yMax - y) / shown.cellSize);
  return row < 0 || col < 0 || row >= shown.height || col >= shown.width ? null : [row, col];
}

function describe(shown, x, y) {
  const [row, col] = cellAt(shown, x, y) || [];
  if (row === undefined) return "outside of the grid";
  const lines = [`row ${row}, col ${col}, cell ${col + row * shown.width}`];
  const cells = shown.cells, arrays = shown.unpacked;
  if (!arrays) return lines[0];
  const at = Math.floor(row / cells.every) * arrays.cols + Math.floor(col / cells.every);
  const floor = arrays.floor[at], weight = cells.weights[arrays.weight[at]], free = weight !== null;
  const height = floor < 0 ? "no floor" : `floor ${fixed(cells.floorFrom + floor * cells.floorStep, 3)} m`;
  lines[0] += `: ${height}, ${free ? "free" : "blocked"}`;
  const known = [];
  if (free && weight !== 1) known.push(`weight ${weight}`);
  if (free) known.push(`clearance ${(arrays.clearance[at] / 1000).toFixed(2)} m`, `island ${arrays.island[at]}`);
  const room = arrays.room[at];
  if (room > 0) known.push(`room ${shown.rooms[room] || room}`);
  if (known.length) lines.push(known.join(", "));
  const names = arrays.names[at] < 0 ? {} : arrays.nameLists[arrays.names[at]];
  const standing = ["doors", "objects", "walls"].filter((key) => names[key]).map((key) => `${key}: ${names[key].join(", ")}`);
  const all = ["doors", "objects", "walls"].flatMap((key) => names[key] || []);
  const blockers = names.blockers || all;
  if (!free && blockers.length) lines.push(`blocked by ${blockers.join(", ")}`);
  else if (standing.length) lines.push(standing.join("; "));
  return lines.join("\n");
}

function forget() {
  state.pointed = null;
  find("pointed").textContent = HINT;
}

function tell(x, y) {
  state.pointed = [x, y];
  const words = [`x ${fixed(x, 3)}, y ${fixed(y, 3)} m`];
  const marks = shownMarks().filter((mark) => Math.hypot(mark.x - x, mark.y - y) * view.scale < NEAR);
  for (const mark of marks) words.push(`${mark.kind}: ${mark.text}`);
  const change = changeAt(x, y);
  if (change) words.push(change);
  for (const [name, shown] of describedLevels()) words.push(`${name}${describe(shown, x, y)}`);
  find("pointed").textContent = words.join("\n");
}

// The levels whose cells are read out: of a difference those of both grids.
function describedLevels() {
  const own = level();
  if (!own.of) return [["", own]];
  return own.of.map(([grid, number]) => [`${content.sheets[grid].name}: `, content.sheets[grid].levels[number]]);
}

function changeAt(x, y) {
  const own = level(), cell = cellAt(own, x, y);
  if (!own.changes?.length || !cell) return "";
  const [row, col] = cell.map((each) => Math.floor(each / own.every));
  return own.kinds[own.changes[row * Math.ceil(own.width / own.every) + col]];
}

// --- drawing ----------------------------------------------------------------------------------

function pictureOf(drawn) {
  if (!pictures.has(drawn)) {
    const image = new Image();
    image.onload = draw;
    image.src = drawn.png;
    pictures.set(drawn, image);
  }
  return pictures.get(drawn);
}

const toPixels = (x, y) => [(x - view.x) * view.scale + canvas.clientWidth / 2, (view.y - y) * view.scale + canvas.clientHeight / 2];
const toWorld = (px, py) => [view.x + (px - canvas.clientWidth / 2) / view.scale, view.y - (py - canvas.clientHeight / 2) / view.scale];
const shownMarks = () => (level().marks || []).filter((mark) => !state.hidden.has(mark.kind));

function draw() {
  if (!level()) return; // two grids may have no level in common
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  const own = level(), drawn = layer(), image = pictureOf(drawn);
  if (image.complete && image.naturalWidth) {
    // a picture of every n-th cell is n times as large; the last row and column may reach beyond
    const pixel = own.cellSize * (own.every || own.cells.every) * view.scale;
    pen.imageSmoothingEnabled = pixel < 1;
    pen.drawImage(image, ...toPixels(own.xMin, own.yMax), image.naturalWidth * pixel, image.naturalHeight * pixel);
  }
  for (const door of drawn.doors) drawDoor(door);
  drawLabels(drawn);
  for (const mark of shownMarks()) {
    const [px, py] = toPixels(mark.x, mark.y);
    pen.lineWidth = 2;
    pen.strokeStyle = colorOf(mark.kind);
    pen.strokeRect(px - 5, py - 5, 10, 10);
  }
  if (state.pointed) drawPointer(...state.pointed);
  drawBar();
}

// A closed door is a line from jamb to jamb; one that lets through is a dashed line.
function drawDoor(door) {
  const closed = door.state === "closed";
  pen.setLineDash(closed ? [] : [3, 3]);
  stroke([[toPixels(...door.start), toPixels(...door.end)]], [["#fff", 4], ["#b02a1e", closed ? 3 : 2]]);
  pen.setLineDash([]);
}

function drawPointer(x, y) {
  const [px, py] = toPixels(x, y);
  stroke([[[px - 8, py], [px + 8, py]], [[px, py - 8], [px, py + 8]]], [["#fff", 3], ["#000", 1]]);
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

// Names of rooms: those that fit into their rooms, in full or as their number; none over another.
// A name without a width is that of a point, and stands over it.
function drawLabels(drawn) {
  pen.font = "600 13px system-ui, sans-serif";
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  const taken = [];
  for (const label of [...drawn.labels].sort((a, b) => b.width - a.width)) {
    const [px, middle] = toPixels(label.x, label.y), py = label.width ? middle : middle - ABOVE;
    const room = label.width ? label.width * view.scale : Infinity;
    const text = [label.text, label.fallback].find((each) => pen.measureText(each).width < room);
    if (!text) continue;
    const half = pen.measureText(text).width / 2 + 2;
    if (taken.some((other) => Math.abs(other.px - px) < other.half + half && Math.abs(other.py - py) < 16)) continue;
    taken.push({ px, py, half });
    pen.lineWidth = 3;
    pen.lineJoin = "round";
    pen.strokeStyle = "rgba(255, 255, 255, 0.85)";
    pen.strokeText(text, px, py);
    pen.fillStyle = "#111";
    pen.fillText(text, px, py);
  }
}

function drawBar() {
  const most = BAR / view.scale, power = 10 ** Math.floor(Math.log10(most));
  const metres = [5, 2, 1].map((n) => n * power).find((n) => n <= most);
  find("barline").style.setProperty("width", `${metres * view.scale}px`);
  find("bartext").textContent = metres >= 1 ? `${metres} m` : `${+(metres * 100).toPrecision(1)} cm`;
}

function colorOf(kind) {
  const kinds = [...new Set(content.sheets.flatMap((each) => each.levels.flatMap((one) => (one.marks || []).map((mark) => mark.kind))))].sort();
  return `hsl(${(330 + kinds.indexOf(kind) * GOLDEN) % 360} 85% 45%)`;
}

function fit() {
  const own = level(), width = own.width * own.cellSize, height = own.height * own.cellSize;
  view.x = own.xMin + width / 2;
  view.y = own.yMax - height / 2;
  view.scale = 0.96 * Math.min(canvas.clientWidth / width, canvas.clientHeight / height);
  isFitted = true;
}

// Zoom so that what is at the pixel stays there.
function zoom(factor, px = canvas.clientWidth / 2, py = canvas.clientHeight / 2) {
  const [x, y] = toWorld(px, py);
  view.scale = Math.min(1e5, Math.max(1e-3, view.scale * factor));
  const [nx, ny] = toWorld(px, py);
  view.x += x - nx;
  view.y += y - ny;
  isFitted = false;
  draw();
}

// --- the page ---------------------------------------------------------------------------------

function showSheet() {
  const own = sheet();
  buttons("grids", content.sheets.length > 1 ? content.sheets.map((each, i) => [i, each.name]) : [], (i) => i === state.sheet, (i) => {
    Object.assign(state, { sheet: i, level: Math.max(0, Math.min(state.level, content.sheets[i].levels.length - 1)) });
    forget();
    showSheet();
  });
  find("facts").replaceChildren(...facts(own.facts));
  find("warnings").replaceChildren(...own.warnings.map((text) => element("li", text)));
  find("tables").replaceChildren(...own.tables.map(showTable));
  document.querySelector(".map").hidden = own.levels.length === 0;
  if (!own.levels.length) return;
  showLevel();
  fit();
  draw();
}

function showLevel() {
  const own = sheet(), shown = level();
  buttons("levels", own.levels.length > 1 ? own.levels.map((each, i) => [i, each.name]) : [], (i) => i === state.level, (i) => {
    state.level = i;
    forget();
    showLevel();
    draw();
  });
  if (!layers().some((each) => each.name === state.layer)) state.layer = layers()[0].name;
  buttons("layers", layers().map((each) => [each.name, each.name]), (name) => name === state.layer, (name) => {
    state.layer = name;
    showLevel();
    draw();
  });
  const every = shown.every || shown.cells.every;
  find("note").textContent = every > 1 ? `There are many cells: the map shows one of ${every} rows and one of ${every} columns.` : "";
  showLegend();
  showMarks();
  for (const [, each] of describedLevels()) cellsOf(each).then(retell);
  if (shown.change && !shown.changes) {
    shown.changes = [];
    unpack(shown.change).then((values) => { shown.changes = values; retell(); });
  }
}

function retell() {
  if (state.pointed) tell(...state.pointed);
}

function swatch(color) {
  const box = element("span", "", { class: "swatch" });
  box.style.setProperty("background", color);
  return box;
}

function showLegend() {
  const drawn = layer(), parts = [];
  if (drawn.title) parts.push(element("strong", drawn.title));
  if (drawn.scale) {
    const box = element("span", "", { class: "scale" }), strip = element("canvas", "", { width: drawn.scale.colors.length, height: 1 });
    const ink = strip.getContext("2d"), ticks = element("span", "", { class: "ticks" });
    drawn.scale.colors.forEach((color, i) => { ink.fillStyle = color; ink.fillRect(i, 0, 1, 1); });
    for (const tick of drawn.scale.ticks) {
      const text = element("span", tick.text);
      text.style.setProperty("left", `${100 * tick.position}%`);
      ticks.append(text);
    }
    box.append(strip, ticks);
    parts.push(element("span", drawn.scale.label), box);
  }
  for (const [text, color] of drawn.legend) {
    const box = element("span");
    box.append(swatch(color), text);
    parts.push(box);
  }
  find("legend").replaceChildren(...parts);
}

function showMarks() {
  const kinds = [...new Set((level().marks || []).map((mark) => mark.kind))].sort();
  find("marks").replaceChildren(...kinds.map((kind) => {
    const box = element("label"), tick = element("input", undefined, { type: "checkbox" });
    tick.checked = !state.hidden.has(kind);
    tick.addEventListener("change", () => { tick.checked ? state.hidden.delete(kind) : state.hidden.add(kind); draw(); });
    const count = level().marks.filter((mark) => mark.kind === kind).length;
    box.append(tick, swatch(colorOf(kind)), `${kind} (${count})`);
    return box;
  }));
}

function showTable(made) {
  const box = element("div", undefined, { class: "scroll", tabindex: "0", role: "group", "aria-label": made.title });
  box.append(table(made.columns, made.rows, made.numbers));
  if (made.more) box.append(element("p", `and ${made.more} more`));
  return folder(made.title, made.rows.length + made.more, box, made.rows.length <= 40);
}

// --- the pointer and the keys -----------------------------------------------------------------

const held = new Map(); // pointers that are down, and where they are [pixels]

const place = (event) => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };

canvas.addEventListener("pointerdown", (event) => { held.set(event.pointerId, place(event)); canvas.setPointerCapture(event.pointerId); });
for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => held.delete(event.pointerId));
canvas.addEventListener("pointermove", (event) => {
  const [px, py] = place(event), before = held.get(event.pointerId);
  if (before) {
    const others = [...held].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    held.set(event.pointerId, [px, py]);
    if (others.length === 1) { // two fingers: their distance is the scale
      const [ox, oy] = others[0];
      zoom(Math.hypot(px - ox, py - oy) / Math.max(1, Math.hypot(before[0] - ox, before[1] - oy)), ox, oy);
      return;
    }
    view.x -= (px - before[0]) / view.scale;
    view.y += (py - before[1]) / view.scale;
    isFitted = false;
  }
  tell(...toWorld(px, py));
  draw();
});
canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(-event.deltaY * 0.0015), ...place(event)); }, { passive: false });
canvas.addEventListener("keydown", (event) => {
  const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (steps) {
    const size = level().cellSize, [x, y] = state.pointed || [view.x, view.y];
    tell(x + steps[0] * size, y + steps[1] * size);
    draw();
  } else if (event.key === "+" || event.key === "=") zoom(1.25);
  else if (event.key === "-") zoom(0.8);
  else if (event.key === "0") { fit(); draw(); }
  else return;
  event.preventDefault();
});

find("title").textContent = content.title;
forget();
find("zoom").append(
  button("+", () => zoom(1.5), { "aria-label": "zoom in" }),
  button("\u2212", () => zoom(1 / 1.5), { "aria-label": "zoom out" }),
  button("all", () => { fit(); draw(); }, { "aria-label": "show all" }),
);
new ResizeObserver(() => {
  if (isFitted && level()) fit(); // two grids may have no level in common
  draw();
}).observe(canvas);
showSheet();
