// Pictures of labyrinths on a canvas, laid out and coloured as by labyrinth_core.pictures.renderer.

const ROUTE_COLOUR = "rgb(204 121 167)";
const [MARK_COLOUR, PALE_MARK] = ["rgb(196 40 140)", "rgb(196 40 140 / 0.3)"];
const rgb = ([red, green, blue], alpha = 1) => `rgb(${red} ${green} ${blue} / ${alpha})`;
const isDark = () => document.documentElement.dataset.theme === "dark";

/** Return the colours of the datasets' pictures, with a dark floor in the dark theme. */
function palette() {
  const { floor, wall } = DATA.colours;
  return isDark()
    ? { ...DATA.colours, floor: [38, 43, 48], wall: [222, 226, 230] }
    : { ...DATA.colours, floor, wall };
}

/** Return the layout of the grid, in device pixels, for a picture of `size` CSS pixels. */
function layout({ height, width }, size) {
  const most = Math.max(height, width);
  const side = Math.max(2 * most + 1, Math.round(size * window.devicePixelRatio));
  const thick = Math.max(1, Math.floor(side / (12 * most)));
  const line = (count) => Math.floor((count * (side - thick)) / most);
  return {
    thick, line, scale: size / side, pitch: (side - thick) / most,
    left: (cell) => line(cell % width),
    top: (cell) => line(height - 1 - Math.floor(cell / width)),
    /** The rectangle between the walls of a cell: left, top, width and height. */
    inner(cell) {
      const [row, column] = [height - 1 - Math.floor(cell / width), cell % width];
      const [left, top] = [line(column) + thick, line(row) + thick];
      return [left, top, line(column + 1) - left, line(row + 1) - top];
    },
    middle(cell) {
      const row = height - 1 - Math.floor(cell / width);
      const column = cell % width;
      return [
        (line(column) + line(column + 1) + thick) / 2, (line(row) + line(row + 1) + thick) / 2,
      ];
    },
  };
}

/**
 * Draw a labyrinth.
 *
 * `view` may have: `state` (number of the state that the agent is in), `route` (cells), `arrows`
 * (pairs of a cell and its optimal actions), `seen` (the cells that are not hidden), `posts` (false
 * leaves out the posts between cells that touch no wall, which look like dirt in a small picture),
 * `marked` (pairs of neighbouring cells: a wall between them is coloured, a passage pale).
 */
function paint(canvas, labyrinth, size, view = {}) {
  const { height, width } = labyrinth;
  const grid = layout(labyrinth, size);
  canvas.width = grid.line(width) + grid.thick;
  canvas.height = grid.line(height) + grid.thick;
  canvas.style.width = `${canvas.width * grid.scale}px`;
  canvas.style.height = `${canvas.height * grid.scale}px`;
  const pencil = canvas.getContext("2d");
  const colours = palette();
  pencil.fillStyle = rgb(colours.floor);
  pencil.fillRect(0, 0, canvas.width, canvas.height);
  paintTiles(pencil, labyrinth, grid, colours, view.state ?? null);
  paintWalls(pencil, labyrinth, grid, colours, view.posts ?? true);
  if (view.seen) veil(pencil, labyrinth, grid, colours, view.seen);
  for (const pair of view.marked ?? []) paintMark(pencil, labyrinth, grid, pair);
  if (view.route) paintRoute(pencil, view.route.map(grid.middle), grid);
  if (view.state !== undefined) paintAgent(pencil, labyrinth, grid, colours, view.state);
  for (const [cell, actions] of view.arrows ?? []) {
    const here = cell === view.state % labyrinth.up.length;
    for (const action of actions) paintArrow(pencil, grid, cell, action, here);
  }
}

function square(pencil, grid, cell, colour, twelfths = 0) {
  const [left, top, wide, tall] = grid.inner(cell);
  const [across, down] = [wide, tall].map((side) => Math.floor((side * twelfths) / 12));
  pencil.fillStyle = colour;
  pencil.fillRect(left + across, top + down, wide - 2 * across, tall - 2 * down);
}

function paintTiles(pencil, labyrinth, grid, colours, state) {
  const phase = state === null ? 0 : Math.floor(state / labyrinth.up.length);
  for (const tile of TILES.filter(({ many }) => many)) {
    for (const cell of labyrinth[tile.name]) square(pencil, grid, cell, rgb(colours[tile.name]));
  }
  square(pencil, grid, labyrinth.start, rgb(colours.start));
  square(pencil, grid, labyrinth.goal, rgb(colours.goal));
  if (labyrinth.key !== null && phase === 0) {
    square(pencil, grid, labyrinth.key, rgb(DATA.colours.wall), 3);
    square(pencil, grid, labyrinth.key, rgb(colours.key), 4);
  }
  if (labyrinth.door !== null) {
    square(pencil, grid, labyrinth.door, rgb(colours.door));
    if (phase === 2) square(pencil, grid, labyrinth.door, rgb(colours.floor), 1);
  }
}

function paintWalls(pencil, { height, width, up, right }, grid, colours, posts) {
  const { thick, line } = grid;
  pencil.fillStyle = rgb(colours.wall);
  const [wide, tall] = [line(width) + thick, line(height) + thick];
  pencil.fillRect(0, 0, wide, thick);
  pencil.fillRect(0, tall - thick, wide, thick);
  pencil.fillRect(0, 0, thick, tall);
  pencil.fillRect(wide - thick, 0, thick, tall);
  for (let cell = 0; cell < up.length; cell++) {
    const [left, top] = [grid.left(cell), grid.top(cell)];
    const beyond = line((cell % width) + 1);
    const below = line(height - Math.floor(cell / width));
    if (!up[cell]) pencil.fillRect(left, top, beyond - left + thick, thick);
    if (!right[cell]) pencil.fillRect(beyond, top, thick, below - top + thick);
    if (posts) pencil.fillRect(beyond, top, thick, thick);
  }
}

/** Darken what the agent does not see: cells but start and goal, and passages between two cells. */
function veil(pencil, { width, start, goal, up, right }, grid, colours, seen) {
  const { thick } = grid;
  pencil.fillStyle = rgb(colours.wall, 0.82);
  for (let cell = 0; cell < up.length; cell++) {
    if (seen.has(cell)) continue;
    const [x, y, wide, tall] = grid.inner(cell);
    if (cell !== start && cell !== goal) pencil.fillRect(x, y, wide, tall);
    if (up[cell] && !seen.has(cell + width)) pencil.fillRect(x, y - thick, wide, thick);
    if (right[cell] && !seen.has(cell + 1)) pencil.fillRect(x + wide, y, thick, tall);
  }
}

function paintMark(pencil, { width, up, right }, grid, [low, high]) {
  const [x, y, wide, tall] = grid.inner(low);
  const above = high - low === width;
  pencil.fillStyle = (above ? up[low] : right[low]) ? PALE_MARK : MARK_COLOUR;
  if (above) pencil.fillRect(x, y - grid.thick, wide, grid.thick);
  else pencil.fillRect(x + wide, y, grid.thick, tall);
}

function paintRoute(pencil, places, grid) {
  pencil.strokeStyle = ROUTE_COLOUR;
  pencil.lineWidth = Math.max(1, grid.pitch / 14);
  pencil.lineJoin = "round";
  pencil.lineCap = "round";
  pencil.beginPath();
  for (const [x, y] of places) pencil.lineTo(x, y);
  pencil.stroke();
}

function paintAgent(pencil, labyrinth, grid, colours, state) {
  const cell = state % labyrinth.up.length;
  square(pencil, grid, cell, rgb(colours.agent), 2);
  const hasKey = Math.floor(state / labyrinth.up.length) === 1;
  if (hasKey) square(pencil, grid, cell, rgb(colours.key), 4);
}

function paintArrow(pencil, grid, cell, action, here) {
  const [x, y] = grid.middle(cell);
  const long = grid.pitch * (here ? 0.36 : 0.26);
  const wide = grid.pitch * (here ? 0.13 : 0.08);
  const [across, along] = [[0, -1], [1, 0], [0, 1], [-1, 0]][action];
  const tip = [x + across * long, y + along * long];
  const foot = [x + across * (long - 1.6 * wide), y + along * (long - 1.6 * wide)];
  pencil.fillStyle = here ? "#000" : isDark() ? "#b4bcc4" : "#5f656b";
  pencil.strokeStyle = pencil.fillStyle;
  pencil.lineWidth = Math.max(1, wide * 0.5);
  pencil.beginPath();
  pencil.moveTo(x, y);
  pencil.lineTo(...foot);
  pencil.stroke();
  pencil.beginPath();
  pencil.moveTo(...tip);
  pencil.lineTo(foot[0] + along * wide, foot[1] + across * wide);
  pencil.lineTo(foot[0] - along * wide, foot[1] - across * wide);
  pencil.fill();
}

/** Return pairs of a cell and its optimal actions, with key and door as they are in `state`. */
function arrowsOf(labyrinth, distance, state) {
  const cells = labyrinth.up.length;
  const phase = Math.floor(state / cells);
  return Array.from({ length: cells }, (_, cell) => [
    cell, optimalActions(labyrinth, distance, phase * cells + cell),
  ]);
}
