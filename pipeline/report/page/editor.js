// The editor: a drawing, which may break the rules while it is being changed, and its text.

const editor = {
  labyrinth: openLabyrinth(5, 5), tool: "wall", cursor: null, solved: false, size: 0,
};
const TOOLS = {
  wall: ["Wall", null], start: ["Start", "start"], goal: ["Goal", "goal"], key: ["Key", "key"],
  door: ["Door", "door"], ice: ["Ice", "ice"],
};
const TASK_OF_TOOL = { key: "key_and_door", door: "key_and_door", ice: "icy_floor" };
const MOST_PIXELS = 640;
const UNREAD = "the text has a mistake, shown below it; the board shows the last text without one";

/** Edit another labyrinth; write its text, unless it was read from there. */
function edit(labyrinth, { keepText = false } = {}) {
  editor.labyrinth = { ...labyrinth, ice: [...labyrinth.ice] };
  const { task, height, width } = labyrinth;
  byId("edit-task").value = task;
  byId("edit-height").value = height;
  byId("edit-width").value = width;
  if (editor.cursor !== null && editor.cursor >= height * width) editor.cursor = null;
  for (const [tool, of] of Object.entries(TASK_OF_TOOL)) {
    byId(`tool-${tool}`).hidden = of !== task;
    if (of !== task && editor.tool === tool) chooseTool("wall");
  }
  if (!keepText) {
    byId("text").value = dump(editor.labyrinth);
    byId("mistake").hidden = true;
  }
  byId("copied").textContent = "";
  refreshEditor();
}

/** Show the board, and say below the button what the drawing is or lacks. */
function refreshEditor() {
  const { labyrinth } = editor;
  const unread = !byId("mistake").hidden;
  const problem = unread ? new LabyrinthError(UNREAD) : problemOf(labyrinth);
  const solve = byId("solve");
  solve.disabled = problem !== null;
  solve.setAttribute("aria-pressed", String(editor.solved && !problem));
  solve.textContent = editor.solved && !problem ? "Hide the solution" : "Solve";
  const view = { fault: problem?.cell };
  if (document.activeElement === byId("board")) view.cursor = editor.cursor;
  let said;
  if (problem) {
    said = sentence(problem.message);
  } else {
    const distance = distances(labyrinth);
    const moves = distance[initial(labyrinth)];
    said = `Solvable; the shortest route has ${plural(moves, "move")}.`;
    if (editor.solved) {
      const actions = shortestRoute(labyrinth, distance);
      const states = replay(labyrinth, actions);
      const cells = labyrinth.up.length;
      view.route = states.map((state) => state % cells);
      view.arrows = solvedArrows(labyrinth, distance, states);
      said = `${plural(moves, "move")}: ${actions.map((action) => ACTIONS[action]).join(" ")}`;
    }
  }
  byId("solution").textContent = said;
  byId("solution").classList.toggle("problem", problem !== null);
  const board = byId("board");
  const size = Math.min(board.parentElement.clientWidth, window.innerHeight * 0.62, MOST_PIXELS);
  if (size > 0) {
    editor.size = Math.max(220, Math.floor(size));
    paint(board, labyrinth, editor.size, view);
  }
}

/** Return the optimal actions of each cell; on the route, those of the state it has there. */
function solvedArrows(labyrinth, distance, states) {
  const cells = labyrinth.up.length;
  const arrows = new Map(arrowsOf(labyrinth, distance, initial(labyrinth)));
  for (const state of states) arrows.set(state % cells, optimalActions(labyrinth, distance, state));
  return arrows;
}

const sentence = (text) => `${text[0].toUpperCase()}${text.slice(1)}.`;

/** Return the LabyrinthError of a drawing that is no labyrinth; null if it is one. */
function problemOf(labyrinth) {
  try {
    checked(labyrinth);
    const missing = missingTiles(labyrinth);
    return missing && new LabyrinthError(missing);
  } catch (error) {
    if (!(error instanceof LabyrinthError)) throw error;
    return error;
  }
}

function chooseTool(tool) {
  editor.tool = tool;
  byId(`tool-${tool}`).firstElementChild.checked = true;
}

/** Open or shut the wall of a cell in the direction of an action. */
function toggleWall(cell, action) {
  const { labyrinth } = editor;
  const other = beside(labyrinth, cell, action);
  if (other === null) return;
  const [up, right] = [labyrinth.up.slice(), labyrinth.right.slice()];
  const bits = action % 2 ? right : up;
  const low = Math.min(cell, other);
  bits[low] = bits[low] ? 0 : 1;
  edit({ ...labyrinth, up, right });
  const [row, column] = [Math.floor(cell / labyrinth.width), cell % labyrinth.width];
  say(`wall ${ACTIONS[action]} of row ${row}, column ${column} ${bits[low] ? "open" : "shut"}`);
}

/** Place a tile on a cell; it replaces another tile, but changes places with start or goal. */
function placeTile(tool, cell) {
  const before = editor.labyrinth;
  if (TASK_OF_TOOL[tool] && TASK_OF_TOOL[tool] !== before.task) return;
  const after = { ...before, ice: before.ice.filter((each) => each !== cell) };
  if (tool === "ice") {
    if (cell === before.start || cell === before.goal) return;
    if (!before.ice.includes(cell)) after.ice.push(cell);
    after.ice.sort((a, b) => a - b);
  } else {
    const other = ["start", "goal", "key", "door"].find((name) => before[name] === cell);
    if (other === tool) return;
    // There must be a start and a goal: it moves to where the new tile was.
    if (other === "start" || other === "goal") {
      if (before[tool] === null) return;
      after[other] = before[tool];
    } else if (other) after[other] = null;
    after[tool] = cell;
  }
  edit(after);
  say(`${tool} at row ${Math.floor(cell / before.width)}, column ${cell % before.width}`);
}

const say = (text) => { byId("board-status").textContent = text; };

/** Return the cell at a point of the board, and the direction of its nearest wall, an action. */
function targetAt(x, y) {
  const { labyrinth, size } = editor;
  const grid = layout(labyrinth, size);
  const inside = (at, count) => Math.max(0, Math.min(count - 1e-9, at));
  const across = inside(x / grid.scale / grid.pitch, labyrinth.width);
  const down = inside(y / grid.scale / grid.pitch, labyrinth.height);
  const [column, fromTop] = [Math.floor(across), Math.floor(down)];
  const cell = (labyrinth.height - 1 - fromTop) * labyrinth.width + column;
  const [right, below] = [across - column, down - fromTop];
  const gaps = [below, 1 - right, 1 - below, right];
  return { cell, action: gaps.indexOf(Math.min(...gaps)) };
}

function boardClick(event) {
  const box = byId("board").getBoundingClientRect();
  const { cell, action } = targetAt(event.clientX - box.left, event.clientY - box.top);
  editor.cursor = cell;
  if (editor.tool === "wall") toggleWall(cell, action);
  else placeTile(editor.tool, cell);
}

function boardKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const action = ["ArrowUp", "ArrowRight", "ArrowDown", "ArrowLeft"].indexOf(event.key);
  const tiles = { s: "start", e: "goal", k: "key", d: "door", i: "ice" };
  const tile = tiles[event.key.toLowerCase()];
  if (action < 0 && !tile) return;
  event.preventDefault();
  editor.cursor ??= editor.labyrinth.start;
  if (tile) placeTile(tile, editor.cursor);
  else if (event.shiftKey) toggleWall(editor.cursor, action);
  else {
    editor.cursor = beside(editor.labyrinth, editor.cursor, action) ?? editor.cursor;
    const { width } = editor.labyrinth;
    say(`row ${Math.floor(editor.cursor / width)}, column ${editor.cursor % width}`);
    refreshEditor();
  }
}

/** Give the drawing another size; keep what fits. */
function resize() {
  const bounded = (id, now) => {
    const value = Math.round(+byId(id).value);
    return value >= MIN_SIDE && value <= MAX_SIDE ? value : now;
  };
  const before = editor.labyrinth;
  const height = bounded("edit-height", before.height);
  const width = bounded("edit-width", before.width);
  const after = { ...openLabyrinth(height, width), task: before.task };
  const moved = (cell) => {
    const [row, column] = [Math.floor(cell / before.width), cell % before.width];
    return row < height && column < width ? row * width + column : null;
  };
  for (let cell = 0; cell < before.up.length; cell++) {
    const now = moved(cell);
    if (now === null) continue;
    if (beside(before, cell, 0) !== null && beside(after, now, 0) !== null) {
      after.up[now] = before.up[cell];
    }
    if (beside(before, cell, 1) !== null && beside(after, now, 1) !== null) {
      after.right[now] = before.right[cell];
    }
  }
  // A goal in the corner stays in the corner.
  const corner = before.goal === before.up.length - 1;
  after.start = moved(before.start) ?? 0;
  after.goal = (corner ? null : moved(before.goal)) ?? height * width - 1;
  if (after.start === after.goal) after.start = 0;
  for (const name of ["key", "door"]) {
    const now = before[name] === null ? null : moved(before[name]);
    after[name] = now === after.start || now === after.goal ? null : now;
  }
  after.ice = before.ice.map(moved)
    .filter((cell) => cell !== null && cell !== after.start && cell !== after.goal);
  edit(after);
}

/** Read the text that a person has changed. */
function readText() {
  takeText(() => parse(byId("text").value));
}

function takeText(read) {
  const mistake = byId("mistake");
  try {
    const labyrinth = read();
    mistake.hidden = true;
    edit(labyrinth, { keepText: true });
  } catch (error) {
    if (!(error instanceof LabyrinthSyntaxError)) throw error;
    const place = `Line ${error.line}, column ${error.column}`;
    mistake.replaceChildren(element("span", {}, `${place}: ${error.what}\n`), error.shown);
    mistake.hidden = false;
    refreshEditor();
  }
}

async function openFile(event) {
  const [file] = event.target.files;
  if (!file) return;
  const bytes = new Uint8Array(await file.slice(0, MAX_TEXT + 1).arrayBuffer());
  event.target.value = "";
  takeText(() => {
    byId("text").value = decode(bytes);
    return parse(byId("text").value);
  });
}

function saveFile() {
  saveAs("edited.labyrinth", byId("text").value, "text/plain");
}

function setUpEditor() {
  fill(byId("edit-task"), TASKS.map((task) => [task, task.replaceAll("_", " ")]));
  for (const [tool, [label, colour]] of Object.entries(TOOLS)) {
    const swatch = element("i", { class: "swatch" });
    if (colour) swatch.style.background = rgb(DATA.colours[colour]);
    byId("tools").append(
      element(
        "label", { id: `tool-${tool}`, class: "segment" },
        element("input", { type: "radio", name: "tool", change: () => chooseTool(tool) }),
        element("span", {}, colour ? swatch : null, label),
      ),
    );
  }
  chooseTool("wall");
  byId("edit-task").addEventListener("change", (event) => {
    const none = { key: null, door: null, ice: [] };
    edit({ ...editor.labyrinth, task: event.target.value, ...none });
  });
  for (const id of ["edit-height", "edit-width"]) byId(id).addEventListener("change", resize);
  const board = byId("board");
  board.addEventListener("click", boardClick);
  board.addEventListener("keydown", boardKey);
  for (const type of ["focus", "blur"]) board.addEventListener(type, refreshEditor);
  byId("solve").addEventListener("click", () => {
    editor.solved = !editor.solved;
    refreshEditor();
  });
  byId("text").addEventListener("input", readText);
  byId("copy").addEventListener("click", () => copyText(byId("text").value, byId("copied")));
  byId("save").addEventListener("click", saveFile);
  byId("open").addEventListener("change", openFile);
  window.addEventListener("resize", refreshEditor);
  const [block] = BLOCKS.filter((each) => each.count);
  edit(block ? block.labyrinth(0) : editor.labyrinth);
}
