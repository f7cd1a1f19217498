// The findings of other stages: leakage and shift between splits, and the results of policies.

const runName = ({ config }, { name }) => `${config} ${name}`;
const methodName = ({ config, name }) => `${config} ${name}, every seed`;

/** Name of a run, or method -> the labyrinths that it, or all its runs, did not solve. */
const ATTEMPTS = new Map(
  DATA.results.flatMap((method) => {
    const attempt = (name, splits) => [name, { config: method.config, splits }];
    const runs = method.runs.map((run) => attempt(runName(method, run), run.splits));
    return runs.length > 1 ? [attempt(methodName(method), method.splits), ...runs] : runs;
  }),
);

/** Return the keys of the labyrinths that a run or method did not solve; null for other names. */
function failuresOf(name) {
  const attempt = ATTEMPTS.get(name);
  if (!attempt) return null;
  const keys = ([split, { failed }]) => failed.map((id) => `${attempt.config} ${split} ${id}`);
  return new Set(Object.entries(attempt.splits).flatMap(keys));
}

/** Return the names of the runs and methods that did not solve a labyrinth. */
function whoFailed({ dataset, split }, id) {
  const failed = ([, { config, splits }]) =>
    config === dataset.name && splits[split.name]?.failed.includes(id);
  return [...ATTEMPTS].filter(failed).map(([name]) => name);
}

const COMMON = {
  equal: "same structure",
  mirrored: "mirrored",
  symmetric: "turned",
  same_route: "shared optimal route",
};

function showLeakage() {
  const dataset = DATA.datasets[byId("leakage-dataset").selectedIndex];
  byId("analysis").replaceChildren(...leakageOf(dataset));
}

function leakageOf(dataset) {
  const { analysis } = dataset;
  if (!analysis) {
    const task = dataset.task === "navigation" ? "" : ` task=${dataset.task}`;
    const command = `labyrinth-datasets size=${sizeOf(dataset)}${task} 'stages=[analyse,report]'`;
    return [notice("This dataset was not analysed, or has changed since. To analyse it, run ",
      code(command), " with the options that the dataset was built with.")];
  }
  const walls = Object.keys(analysis.pairs[0]?.within ?? {});
  const rows = analysis.pairs.map(({ first, second, counts, within, spread }) => [
    `${first}, ${second}`,
    grouped(analysis.labyrinths[second]),
    ...Object.keys(COMMON).map((kind) =>
      // No structure may be in two splits, nor its mirror image.
      [grouped(counts[kind]), counts[kind] && /equal|mirrored/.test(kind) ? "bad" : null],
    ),
    ...walls.map((count) => grouped(within[count])),
    spread,
  ]);
  const headings = [
    "splits", "labyrinths", ...Object.values(COMMON), ...walls.map((count) => `at most ${plural(+count, "wall")} away`),
    "walls to the nearest: minimum, median",
  ];
  return [
    element("h2", {}, "Leakage"),
    verdict(analysis),
    table("Labyrinths of the second split with a match in the first, by kind", headings, rows),
    element(
      "p", { class: "muted" },
      "Mirrored: same structure, also after a rotation or reflection that maps start to start " +
      "and goal to goal. Turned: also after any other. Shared optimal route: a route that is " +
      "optimal in both labyrinths.",
    ),
    ...analysis.pairs.map(examplesOf).filter(Boolean),
    element("h2", {}, "Shift between splits"),
    shiftTable(analysis),
    element(
      "p", { class: "muted" },
      "Distance: Jensen-Shannon for actions (0 to 1), Wasserstein for the others. Effect size: " +
      `Cohen's d. p-values from ${grouped(analysis.permutations)} label permutations over ` +
      "labyrinths; Holm's method corrects them for the number of tests.",
    ),
  ];
}

/** Return one sentence on whether the splits are disjoint. */
function verdict({ pairs, repeated, strangers }) {
  const shared = pairs.reduce((sum, { counts }) => sum + counts.equal + counts.mirrored, 0);
  const again = Object.entries(repeated)
    .filter(([split, count]) => count && !(split in strangers))
    .map(([split, count]) => `${split} repeats ${plural(count, "structure")}`);
  const strange = Object.entries(strangers).filter(([, count]) => count)
    .map(([split, count]) => `${split} has ${plural(count, "structure")} that its parent lacks`);
  const broken = [...again, ...strange];
  if (shared) broken.unshift("splits share structures");
  return notice(
    broken.length
      ? sentence(broken.join("; "))
      : "No structure is in two splits, and none is repeated. Mirrored with start and goal kept: " +
        `none. Turned: ${turned(pairs)}.`,
  );
}

/** Say how many structures of each split are rotated or reflected ones of another split. */
function turned(pairs) {
  const found = pairs.filter(({ counts }) => counts.symmetric);
  const told = found.map(({ first, second, counts }) =>
    `${grouped(counts.symmetric)} of ${second} in ${first}`);
  return told.join(", ") || "none";
}

function examplesOf({ first, second, counts, examples }) {
  const rows = Object.entries(examples).flatMap(([kind, found]) =>
    found.map(([id, other]) => [idButton(id), idButton(other), [COMMON[kind], "text"]]),
  );
  if (!rows.length) return null;
  const total = Object.values(counts).reduce((sum, count) => sum + count, 0);
  const title = `${first}, ${second}: ids of ${grouped(rows.length)} of ${grouped(total)} matches`;
  return element(
    "details", {}, element("summary", {}, title),
    table(title, [second, first, ["in common", "text"]], rows),
  );
}

/** Return a button that shows a labyrinth in the gallery. */
function idButton(id) {
  return element(
    "button", { type: "button", class: "quiet id", click: () => showInGallery({ id }) }, id,
  );
}

/** Show the gallery with only these filters. */
function showInGallery(filters) {
  const form = byId("filters");
  form.reset();
  for (const [name, value] of Object.entries(filters)) form.elements[name].value = value;
  showPart("gallery");
  filterGallery();
  byId("list").focus();
}

function shiftTable({ shift }) {
  const rows = shift.map((each) => [
    `${each.first}, ${each.second}`,
    [each.measure.replaceAll("_", " "), "text"],
    each.labyrinths.map(grouped).join(", "),
    each.distance.toFixed(3),
    each.effect === null ? "∞" : each.effect.toFixed(2),
    each.p_value.toFixed(3),
    `${each.corrected.toFixed(3)}${each.corrected <= 0.05 ? " *" : ""}`,
  ]);
  const headings = [
    "splits", ["measure", "text"], "labyrinths of each", "distance", "effect size",
    "p-value", "corrected p-value",
  ];
  return table("Differences between splits; * corrected p-value of 0.05 or less", headings, rows);
}

function showResults() {
  const configs = [...new Set(DATA.results.map(({ config }) => config))];
  byId("runs").replaceChildren(
    ...(configs.length ? configs.flatMap(resultsOf) : [noResults()]),
  );
}

function noResults() {
  return notice(
    "No policy was evaluated on these datasets. To train and evaluate one and show it here, run ",
    code("labyrinth-datasets 'stages=[train,evaluate,report]' method=bc"),
    " with the options of the dataset.",
  );
}

function resultsOf(config) {
  const methods = DATA.results.filter((method) => method.config === config);
  const splits = [...new Set(methods.flatMap((method) => Object.keys(method.splits)))];
  const baselines = Object.assign({}, ...methods.map((method) => method.baselines).reverse());
  const bars = (split) => methods.filter((method) => split in method.splits)
    .map(({ name, splits: { [split]: { spl, spl_interval } } }) => ({
      name, share: spl, interval: spl_interval, colour: DATA.colours.goal,
    }));
  const panels = splits.map((split) =>
    panel(split, "", barPicture(bars(split), 1, `SPL on ${split}`)),
  );
  const row = (method) => [
    named(method), method.submitted ? "" : grouped(method.runs.length),
    ...splits.map((split) => ratesOf(method.splits[split])),
  ];
  const rows = (submitted) => methods.filter((each) => each.submitted === submitted).map(row);
  const others = Object.keys(baselines[splits[0]] ?? {}).map((name) => [
    [name.replaceAll("_", " "), "muted"], "",
    ...splits.map((split) => ratesOf(baselines[split]?.[name])),
  ]);
  const results = figure(
    `SPL, ${config}`,
    `${DATA.whySpl} Bars: mean SPL over the seeds of a method. ` +
    "Lines: 95% interval over seeds and labyrinths. The table has SPL and, below it, " +
    "the success rate and the average return ± its standard deviation; baselines without " +
    "learning are grey, and submitted results come last.",
    panels,
    table("SPL; below it success rate (SR) and average return", ["method", "seeds", ...splits], [...rows(false), ...others, ...rows(true)]),
  );
  results.querySelector("details").open = true;
  return [results, ...methods.flatMap((each) => [methodDetails(each), receiptsOf(each)]).filter(Boolean)];
}

/** Return the name of a method, and who submitted it. */
function named({ name, submitted, author }) {
  if (!submitted) return name;
  const by = author ? `submitted by ${author}` : "submitted";
  return element("span", {}, name, element("br"), element("small", {}, by));
}

/** Return a table's cell with SPL, success rate and average return, empty if there are none. */
function ratesOf(figures) {
  if (!figures) return "";
  const { spl, sr, aer, aer_std: deviation } = figures;
  const below = `SR ${percent(sr)}, ${aer.toFixed(2)} ± ${deviation.toFixed(2)}`;
  return element("span", {}, percent(spl), element("br"), element("small", {}, below));
}

/** Return the details of a method: what none of its seeds solved, and each run. */
function methodDetails(method) {
  const { name, runs, splits, submitted } = method;
  const rows = Object.entries(splits).map(([split, scores]) => [
    split,
    percent(scores.spl),
    percent(scores.sr_within_cells),
    percent(scores.sr),
    intervalOf(scores),
    failedButton(methodName(method), split, scores),
    `${scores.aer.toFixed(3)} ± ${scores.aer_std.toFixed(2)}`,
  ]);
  const headings = [
    "split", "SPL", "solved in n x n steps", "success rate", "its 95% interval",
    "not solved by any seed", "average return",
  ];
  const what = submitted ? "submitted" : plural(runs.length, "run");
  return element(
    "details", { open: DATA.results.length === 1 },
    element("summary", {}, `${name}: ${what}, with failures`),
    runs.length > 1 ? table(`${name}, mean of ${runs.length} seeds`, headings, rows) : null,
    ...runs.map((run) => runTable(run, runName(method, run))),
    element(
      "p", { class: "muted" },
      "n x n steps: as many steps as there are cells. Failures: a loop between cells, the same " +
      "wall for ever, ice. Path efficiency: moves of a shortest route divided by moves taken, in " +
      "solved labyrinths. Optimal actions: their share in states in which demonstrations act, " +
      "and in other states.",
    ),
  );
}

const intervalOf = ({ sr_interval: bounds }) =>
  bounds.map((bound) => percent(bound, 0)).join(" to ");

function runTable({ name, splits }, label) {
  const share = (value) => (value === null ? "" : percent(value));
  const rows = Object.entries(splits).map(([split, scores]) => [
    split,
    share(scores.spl),
    share(scores.sr_within_cells),
    share(scores.sr),
    intervalOf(scores),
    failedButton(label, split, scores),
    [Object.entries(scores.failures).map(([kind, count]) => `${count} ${kind}`).join(", "), "text"],
    `${scores.aer.toFixed(3)} ± ${scores.aer_std.toFixed(2)}`,
    share(scores.path_efficiency),
    share(scores.accuracy_on_demonstrations),
    share(scores.accuracy_elsewhere),
    grouped(scores.labyrinths),
  ]);
  const headings = [
    "split", "SPL", "solved in n x n steps", "success rate", "its 95% interval", "not solved",
    ["failures", "text"], "average return", "path efficiency", "optimal actions where demonstrated",
    "optimal actions elsewhere", "labyrinths",
  ];
  return table(name, headings, rows);
}

function failedButton(failedWith, split, { failed, unsolved }) {
  if (!unsolved) return "none";
  const more = unsolved > failed.length ? `first ${grouped(failed.length)} of ` : "";
  const show = () => showInGallery({ split, failed: failedWith });
  return element(
    "button", { type: "button", class: "quiet", click: show }, `${more}${grouped(unsolved)}: show`,
  );
}
