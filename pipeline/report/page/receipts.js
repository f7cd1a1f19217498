// Receipts of memorising: the states in which a policy acted as its own train shows.

const COPY_SIZE = 168;

/** Return the labyrinth with an id in a split of a dataset; null if it is not in this file. */
function labyrinthOf(config, split, id) {
  const digits = Array.from(id, (digit) => parseInt(digit, 16));
  for (const block of BLOCKS) {
    if (block.dataset.name !== config || block.split.name !== split || !block.count) continue;
    const ids = block.column("id");
    for (let index = 0; index < block.count; index++) {
      if (idBegins(ids, index, digits)) return block.labyrinth(index);
    }
  }
  return null;
}

/** Return the details on whether the runs of a method follow their own train; null if unknown. */
function receiptsOf({ name, config, runs }) {
  const asked = runs.filter(({ memorised }) => memorised);
  if (!asked.length) return null;
  const rows = asked.map(({ name: run, memorised: { own_way: way, ...all } }) => [
    run, all.split, inPoints(all), all.most.toFixed(1), all.controls[1].toFixed(2),
    `${all.p.toFixed(3)} of ${grouped(all.drawn)}`, inPoints(way), way.p.toFixed(3),
    grouped(all.states), grouped(all.without_twin),
  ]);
  const headings = [
    "run", ["split", "text"], "excess in points", "if it always copied", "sd of controls",
    "p, and controls", "excess on its own way", "its p", "states", "without a twin",
  ];
  const { memorised } = asked[0];
  const copies = memorised.copies.map((copy) => copyFigure(config, memorised.split, copy));
  return element(
    "details", { open: DATA.results.length === 1 },
    element("summary", {}, `${name}: does it follow its own train?`),
    table(`${name}: excess over other training sets`, headings, rows),
    element(
      "p", { class: "muted" },
      "The twin of a state is the demonstrated state of train that looks most like it. Excess: how " +
      "much more often the policy acts as its twins do than as those of other training sets, in " +
      "points. p: the rank of its own train among others of the same distribution.",
    ),
    element("h3", {}, `The clearest copies of ${asked[0].name}`),
    element(
      "p", { class: "muted" },
      "Left: the policy's action. Right: its twin in train. Purple: a wall that only this one " +
      "has; pale: the other one has it.",
    ),
    element("div", { class: "copies" }, ...copies.filter(Boolean)),
  );
}

const inPoints = ({ excess, interval: [low, high] }) =>
  `${signed(excess)} [${signed(low)}, ${signed(high)}]`;
const signed = (points) => (points <= -0.005 ? "−" : "+") + Math.abs(points).toFixed(2);
const most = (shares) => shares.indexOf(Math.max(...shares));

/** Return a state and its twin side by side; null if this file lacks one of the labyrinths. */
function copyFigure(config, split, copy) {
  const pair = [labyrinthOf(config, split, copy.labyrinth), labyrinthOf(config, "train", copy.train_labyrinth)];
  if (pair.includes(null)) return null;
  const [did, shown, usual] = [copy.did, copy.shown, copy.consensus].map(most);
  const state = copy.agent + pair[0].up.length * (copy.has_key + copy.door_open);
  const canvases = pair.map((labyrinth, side) => {
    const canvas = element("canvas", {
      role: "img", "aria-label": `Cell ${copy.agent}: ${ACTIONS[side ? shown : did]}`,
    });
    const arrows = [[copy.agent, [side ? shown : did]]];
    paint(canvas, labyrinth, COPY_SIZE, { state, arrows, marked: copy.passages });
    return element(
      "div", {}, canvas,
      element("small", {}, side ? "train " : `${split} `, idButton(side ? copy.train_labyrinth : copy.labyrinth)),
    );
  });
  const best = ACTIONS.filter((_, action) => copy.optimal[action]).join(" or ");
  const verdict = copy.optimal[did] ? "optimal" : `optimal is ${best}`;
  const twins = copy.twins > 1 ? `, ${copy.twins} equally near twins` : "";
  return element(
    "figure", {}, element("div", { class: "pair" }, ...canvases),
    element(
      "figcaption", {}, `${ACTIONS[did]} (${verdict})`,
      element(
        "span", {}, ` train shows ${ACTIONS[shown]} in ${percent(copy.shown[shown], 0)}; other ` +
        `training sets ${ACTIONS[usual]} in ${percent(copy.consensus[usual], 0)}. ` +
        `${plural(copy.differences, "difference")}${twins}.`,
      ),
    ),
  );
}
