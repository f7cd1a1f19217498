// The world, as in labyrinth_core: cells, moves, the rules of the tasks, and the solver.
// A cell is row * width + column, row 0 at the bottom; `up` and `right` hold 1 for a passage.

const ACTIONS = ["up", "right", "down", "left"];
const UNREACHABLE = -1;

/** Return whether there is a passage from a cell in the direction of an action. */
function isOpen({ up, right, width }, cell, action) {
  if (action === 0) return up[cell] === 1;
  if (action === 1) return right[cell] === 1;
  if (action === 2) return cell >= width && up[cell - width] === 1;
  return cell % width > 0 && right[cell - 1] === 1;
}

/** Return the cell that an action leads to; at a wall, it is the same cell. */
function move(labyrinth, cell, action) {
  const { width } = labyrinth;
  return isOpen(labyrinth, cell, action) ? cell + [width, 1, -width, -1][action] : cell;
}

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
  const states = DATA.tasks[labyrinth.task].phases * cells;
  // The agent cannot leave ice, nor be on the door before it is open.
  const blocked = new Set(door === null ? ice : [door, door + cells]);
  const predecessors = Array.from({ length: states }, () => []);
  for (let state = 0; state < states; state++) {
    if (blocked.has(state)) continue;
    for (let action = 0; action < 4; action++) {
      predecessors[transition(labyrinth, state, action)].push(state);
    }
  }
  const distance = new Int32Array(states).fill(UNREACHABLE);
  const queue = [];
  for (let state = goal; state < states; state += cells) queue.push(state);
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

/** Return the states that actions lead through, from the start on. */
function replay(labyrinth, actions) {
  const states = [labyrinth.start];
  for (const action of actions) states.push(transition(labyrinth, states.at(-1), action));
  return states;
}

/** Return the cells that the agent sees from a cell: straight rays and exact diagonals. */
function visibleFrom(labyrinth, cell) {
  const seen = new Set([cell]);
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
