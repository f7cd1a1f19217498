// The world, as in labyrinth_core: cells, moves, the rules of the tasks, and the solver.
// A cell is row * width + column, row 0 at the bottom; `up` and `right` hold 1 for a passage.

const ACTIONS = ["up", "right", "down", "left"];
const TASKS = ["navigation", "partial_observability", "key_and_door", "icy_floor"];
const MIN_SIDE = 2;
const MAX_SIDE = 1000;
const UNREACHABLE = -1;

/** A labyrinth that breaks a rule of its task; `cell` is the cell at fault, if it is one. */
class LabyrinthError extends Error {
  constructor(message, cell = null) {
    super(message);
    this.cell = cell;
  }
}

/** Return a labyrinth without inner walls, with start and goal in its corners. */
function openLabyrinth(height, width) {
  const cells = height * width;
  const up = new Uint8Array(cells).fill(1, 0, cells - width);
  const right = new Uint8Array(cells).map((_, cell) => ((cell + 1) % width ? 1 : 0));
  return {
    height, width, up, right, start: 0, goal: cells - 1,
    task: "navigation", key: null, door: null, ice: [],
  };
}

/** Return the cell that an action leads to in a grid without walls; null if it is outside. */
function beside({ height, width }, cell, action) {
  const column = cell % width;
  if (action === 0) return cell + width < height * width ? cell + width : null;
  if (action === 1) return column + 1 < width ? cell + 1 : null;
  if (action === 2) return cell >= width ? cell - width : null;
  return column > 0 ? cell - 1 : null;
}

/** Return whether there is a passage from a cell in the direction of an action. */
function isOpen({ up, right, width }, cell, action) {
  if (action === 0) return up[cell] === 1;
  if (action === 1) return right[cell] === 1;
  if (action === 2) return cell >= width && up[cell - width] === 1;
  return cell % width > 0 && right[cell - 1] === 1;
}

/** Return the cell that an action leads to; at a wall, it is the same cell. */
function move(labyrinth, cell, action) {
  return isOpen(labyrinth, cell, action) ? beside(labyrinth, cell, action) : cell;
}

/** Return the number of moves from `source` to each cell without entering `blocked` cells. */
function cellDistances(labyrinth, source, blocked = []) {
  const distance = new Int32Array(labyrinth.up.length).fill(UNREACHABLE);
  for (const cell of blocked) distance[cell] = 0; // As if visited already; undone at the end.
  distance[source] = 0;
  const queue = [source];
  for (const cell of queue) {
    for (let action = 0; action < 4; action++) {
      const after = move(labyrinth, cell, action);
      if (distance[after] < 0) {
        distance[after] = distance[cell] + 1;
        queue.push(after);
      }
    }
  }
  for (const cell of blocked) distance[cell] = UNREACHABLE;
  return distance;
}

/** Return a message on the tiles of its task that a drawing lacks; null if it has them all. */
function missingTiles({ task, key, door, ice }) {
  if (task === "icy_floor" && !ice.length) {
    return "icy floor needs ice, at least one I: the drawing has none";
  }
  if (task !== "key_and_door" || (key !== null && door !== null)) return null;
  const lacks = key !== null ? "no D" : door !== null ? "no K" : "neither";
  return `key and door needs a key K and a door D: the drawing has ${lacks}`;
}

/**
 * Return the labyrinth; throw LabyrinthError if it breaks a rule.
 *
 * While tiles of its task are missing, only the rules on start and goal are checked.
 */
function checked(labyrinth) {
  const { start, goal } = labyrinth;
  const none = { key: null, door: null, ice: [] };
  const { key, door, ice } = missingTiles(labyrinth) ? none : labyrinth;
  const tiles = [["start", start], ["goal", goal]];
  if (key !== null) tiles.push(["key", key], ["door", door]);
  for (const cell of ice) tiles.push(["ice", cell]);
  const taken = new Map();
  for (const [name, cell] of tiles) {
    if (taken.has(cell)) {
      throw new LabyrinthError(`the ${taken.get(cell)} and the ${name} share a cell`, cell);
    }
    taken.set(cell, name);
  }
  if (cellDistances(labyrinth, start, ice)[goal] === UNREACHABLE) {
    const without = ice.length ? " without ice" : "";
    throw new LabyrinthError(`no route${without} leads from start to goal`, goal);
  }
  if (door !== null) {
    const before = cellDistances(labyrinth, start, [door]);
    if (before[goal] !== UNREACHABLE) {
      throw new LabyrinthError("a route from start to goal avoids the door", door);
    }
    if (before[key] === UNREACHABLE) {
      throw new LabyrinthError("the key cannot be reached without passing the door", key);
    }
  }
  return labyrinth;
}

/** Return the number of the state that episodes begin in. */
const initial = (labyrinth) => labyrinth.start;

/** Return whether an episode ends in a state. */
const isTerminal = ({ goal, ice, up }, state) =>
  state % up.length === goal || ice.includes(state % up.length);

// The number of a state is its cell, plus the number of cells if the agent has the key, and once
// more if the door is open.

/** Return the number of the state after an action; a wall or a locked door changes nothing. */
function transition(labyrinth, state, action) {
  const cells = labyrinth.up.length;
  const target = move(labyrinth, state % cells, action);
  let phase = Math.floor(state / cells);
  if (target === labyrinth.door && phase < 2) {
    if (phase === 0) return state;
    phase = 2;
  }
  if (target === labyrinth.key) phase = Math.max(phase, 1);
  return target + phase * cells;
}

/** Return the least number of moves from each state to the goal; UNREACHABLE without a route. */
function distances(labyrinth) {
  const { goal, door, ice } = labyrinth;
  const cells = labyrinth.up.length;
  if (door === null) return cellDistances(labyrinth, goal, ice);
  const predecessors = Array.from({ length: 3 * cells }, () => []);
  for (let state = 0; state < 3 * cells; state++) {
    // The agent cannot be on the door before it is open.
    if (state === door || state === door + cells) continue;
    for (let action = 0; action < 4; action++) {
      predecessors[transition(labyrinth, state, action)].push(state);
    }
  }
  const distance = new Int32Array(3 * cells).fill(UNREACHABLE);
  const queue = [goal, goal + cells, goal + 2 * cells];
  for (const state of queue) distance[state] = 0;
  for (const state of queue) {
    for (const before of predecessors[state]) {
      if (distance[before] < 0) {
        distance[before] = distance[state] + 1;
        queue.push(before);
      }
    }
  }
  return distance;
}

/** Return the actions that begin a shortest route from a state, given all distances. */
function optimalActions(labyrinth, distance, state) {
  if (distance[state] <= 0) return [];
  return [0, 1, 2, 3].filter(
    (action) => distance[transition(labyrinth, state, action)] === distance[state] - 1,
  );
}

/** Return the actions of a shortest route: in each state the first optimal one. */
function shortestRoute(labyrinth, distance) {
  const actions = [];
  let state = initial(labyrinth);
  while (distance[state] > 0) {
    const [action] = optimalActions(labyrinth, distance, state);
    actions.push(action);
    state = transition(labyrinth, state, action);
  }
  return actions;
}

/** Return the states that actions lead through, beginning with the first one. */
function replay(labyrinth, actions, first = initial(labyrinth)) {
  const states = [first];
  for (const action of actions) states.push(transition(labyrinth, states.at(-1), action));
  return states;
}

/** Return the cells that the agent sees from a cell: straight rays and exact diagonals. */
function visibleFrom(labyrinth, cell) {
  const seen = new Set([cell, labyrinth.start, labyrinth.goal]);
  for (const ray of [[0], [1], [2], [3], [1, 0], [1, 2], [3, 0], [3, 2]]) {
    let at = cell;
    for (;;) {
      let onward = at;
      const unbroken = ray.every((action) => {
        const after = move(labyrinth, onward, action);
        if (after === onward) return false;
        onward = after;
        return true;
      });
      if (!unbroken) break;
      at = onward;
      seen.add(at);
    }
  }
  return seen;
}
