// Where missing tiles of a task are placed: labyrinth_core.world.tasks.place with the seed 0, so that
// the page completes a text as `labyrinth check` does. The draws are numpy's PCG64.

/** The stream of numpy.random.default_rng(0): PCG XSL RR 128/64 (https://www.pcg-random.org). */
class Generator {
  constructor() {
    // numpy.random.PCG64(0).state
    this.state = 35399562948360463058890781895381311971n;
    this.increment = 87136372517582989555478159403783844777n;
    this.half = null;
  }

  next32() {
    if (this.half !== null) {
      const high = this.half;
      this.half = null;
      return high;
    }
    const multiplier = 47026247687942121848144207491837523525n;
    this.state = BigInt.asUintN(128, this.state * multiplier + this.increment);
    const word = BigInt.asUintN(64, (this.state >> 64n) ^ this.state);
    const turn = this.state >> 122n;
    const turned = BigInt.asUintN(64, (word >> turn) | (word << (64n - turn)));
    this.half = turned >> 32n;
    return turned & 0xffffffffn;
  }

  /** Return a whole number from 0 to `bound` - 1, by Lemire's method. */
  integer(bound) {
    if (bound === 1) return 0;
    const range = BigInt(bound);
    const threshold = 0x100000000n % range;
    for (;;) {
      const product = this.next32() * range;
      if ((product & 0xffffffffn) >= threshold) return Number(product >> 32n);
    }
  }

  permutation(count) {
    const order = Array.from({ length: count }, (_, place) => place);
    for (let place = count - 1; place > 0; place--) {
      const mask = BigInt(2 ** (32 - Math.clz32(place)) - 1);
      let other;
      do other = Number(this.next32() & mask);
      while (other > place);
      [order[place], order[other]] = [order[other], order[place]];
    }
    return order;
  }
}

const ICE_SEARCH = 500_000;

/** Return the labyrinth with what its task lacks; throw LabyrinthError if it cannot hold it. */
function place(labyrinth) {
  const random = new Generator();
  checked({ ...labyrinth, key: null, door: null, ice: [] });
  if (labyrinth.task === "icy_floor") {
    return checked({ ...labyrinth, ice: placeIce(labyrinth, random) });
  }
  return checked({ ...labyrinth, ...placeKeyAndDoor(labyrinth, random) });
}

function placeKeyAndDoor(labyrinth, random) {
  const { start, goal, key, door } = labyrinth;
  let [doors, found] = unavoidable(labyrinth);
  if (door !== null) doors = doors.filter(([cell]) => cell === door);
  if (!doors.length) {
    throw new LabyrinthError(
      "no place for the door: no cell lies on every route from S to E", door,
    );
  }
  const fromStart = cellDistances(labyrinth, start);
  const fromGoal = cellDistances(labyrinth, goal);
  const keys = found.filter(
    ([cell]) =>
      fromStart[cell] + fromGoal[cell] > fromStart[goal] && (key === null || key === cell),
  );
  const first = Math.min(labyrinth.up.length, ...keys.slice(0, 1).map(([, at]) => at));
  doors = doors.filter(([, at]) => at > first);
  if (!doors.length && key !== null) {
    throw new LabyrinthError("no place for the door that fits the key", key);
  }
  if (!doors.length) {
    throw new LabyrinthError("no place for the key: none is off the route and before the door");
  }
  const [chosen, limit] = doors[random.integer(doors.length)];
  const before = keys.filter(([, at]) => at < limit);
  return { door: chosen, key: before[random.integer(before.length)][0] };
}

/**
 * Return what lies on every route and what lies off the one that is walked: pairs of a cell and
 * the place along that route from which it was found, in the order of that place.
 */
function unavoidable(labyrinth) {
  const distance = cellDistances(labyrinth, labyrinth.goal);
  const route = [labyrinth.start];
  while (route.at(-1) !== labyrinth.goal) {
    const at = route.at(-1);
    const nearer = [0, 1, 2, 3].map((action) => move(labyrinth, at, action));
    route.push(nearer.find((cell) => distance[cell] === distance[at] - 1));
  }
  const placeOnRoute = new Map(route.map((cell, at) => [cell, at]));
  const doors = [];
  const found = new Map();
  let farthest = 0;
  for (let at = 0; at < route.length - 1; at++) {
    if (at && at === farthest) doors.push([route[at], at]);
    const stack = [route[at]];
    while (stack.length) {
      const cell = stack.pop();
      for (let action = 0; action < 4; action++) {
        const after = move(labyrinth, cell, action);
        if (placeOnRoute.has(after)) {
          farthest = Math.max(farthest, placeOnRoute.get(after));
        } else if (!found.has(after)) {
          found.set(after, at);
          stack.push(after);
        }
      }
    }
  }
  return [doors, [...found]];
}

function placeIce(labyrinth, random) {
  const { start, goal } = labyrinth;
  const fromStart = cellDistances(labyrinth, start);
  const fromGoal = cellDistances(labyrinth, goal);
  const closed = closedUntilLonger(labyrinth, random);
  const longer = new Set(
    randomShortest(labyrinth, cellDistances(labyrinth, goal, closed), random),
  );
  return [...fromStart.keys()].filter(
    (cell) =>
      fromStart[cell] !== UNREACHABLE &&
      fromStart[cell] + fromGoal[cell] === fromStart[goal] &&
      !longer.has(cell),
  );
}

/** Return cells of shortest routes without which the goal is farther, but within reach. */
function closedUntilLonger(labyrinth, random) {
  const { start, goal } = labyrinth;
  const shortest = cellDistances(labyrinth, goal)[start];
  const closed = [];
  const choices = [];
  const openForGood = [new Set([start, goal])];
  for (let left = Math.max(20, Math.floor(ICE_SEARCH / labyrinth.up.length)); left; left--) {
    const distance = cellDistances(labyrinth, goal, closed);
    if (distance[start] > shortest) return closed;
    if (distance[start] === UNREACHABLE) {
      openForGood.at(-1).add(closed.pop());
    } else {
      const route = randomShortest(labyrinth, distance, random);
      choices.push(random.permutation(route.length).map((at) => route[at]));
      openForGood.push(new Set(openForGood.at(-1)));
    }
    while (choices.length && choices.at(-1).every((cell) => openForGood.at(-1).has(cell))) {
      choices.pop();
      openForGood.pop();
      if (closed.length) openForGood.at(-1).add(closed.pop());
    }
    if (!choices.length) {
      throw new LabyrinthError("ice would not matter: no longer route avoids a shortest one");
    }
    let cell = choices.at(-1).pop();
    while (openForGood.at(-1).has(cell)) cell = choices.at(-1).pop();
    closed.push(cell);
  }
  throw new LabyrinthError("no place was found for ice that would leave a longer route open");
}

function randomShortest(labyrinth, distance, random) {
  const route = [labyrinth.start];
  while (distance[route.at(-1)]) {
    const at = route.at(-1);
    const cells = [0, 1, 2, 3]
      .map((action) => move(labyrinth, at, action))
      .filter((cell) => distance[cell] === distance[at] - 1);
    route.push(cells[random.integer(cells.length)]);
  }
  return route;
}
