// What was found out elsewhere: the certificate of leakage, the shift between splits, and the
// results of training.

let failuresByRun = null;

const runLabel = ({ config, name }) => `${config} ${name}`;

/** Return run -> the labyrinths that it failed on, by their keys. */
function failures() {
  failuresByRun ??= new Map(
    DATA.results.map((run) => [
      runLabel(run),
      new Set(
        Object.entries(run.splits).flatMap(([split, { failed }]) =>
          failed.map((id) => `${run.config} ${split} ${id}`),
        ),
      ),
    ]),
  );
  return failuresByRun;
}

const COMMON = {
  equal: "the same",
  mirrored: "mirrored",
  symmetric: "turned",
  same_route: "same route",
};

function showCertificate() {
  const dataset = DATA.datasets[byId("certificate-dataset").selectedIndex];
  byId("analysis").replaceChildren(...certificateOf(dataset));
}

function certificateOf(dataset) {
  const { analysis } = dataset;
  if (!analysis) {
    const task = dataset.task === "navigation" ? "" : ` task=${dataset.task}`;
    const command = `python run.py size=${sizeOf(dataset)}${task} stages=[analyse,report]`;
    return [notice("This dataset was not analysed, or has changed since. ", code(command),
      " (with the options that it was built with) makes the certificate and writes it here.")];
  }
  const walls = Object.keys(analysis.pairs[0]?.within ?? {});
  const rows = analysis.pairs.map(({ first, second, counts, within, walls: apart }) => [
    `${first}, ${second}`,
    grouped(analysis.labyrinths[second]),
    ...Object.keys(COMMON).map((kind) =>
      // A structure, or its mirror image, in two splits is what must not be.
      [grouped(counts[kind]), counts[kind] && /equal|mirrored/.test(kind) ? "bad" : null],
    ),
    ...walls.map((count) => grouped(within[count])),
    apart ? `${apart[0]}, ${apart[1]}` : "",
  ]);
  const headings = [
    "splits", "labyrinths", ...Object.values(COMMON), ...walls.map((count) => `≤ ${count} walls`),
    "walls to the nearest",
  ];
  return [
    element("h2", {}, "Leakage"),
    verdict(analysis),
    table("Labyrinths of the second split that have in the first …", headings, rows),
    element(
      "p", { class: "muted" },
      "The same: an equal structure. Mirrored: also one that a rotation or reflection makes the " +
      "same with start and goal. Turned: wherever start and goal are. Same route: an optimal " +
      "route that is optimal there, too. Walls to the nearest structure: the least and the median.",
    ),
    ...analysis.pairs.map(examplesOf).filter(Boolean),
    element("h2", {}, "Shift between splits"),
    shiftTable(analysis),
    element(
      "p", { class: "muted" },
      `p comes of ${grouped(analysis.permutations)} permutations of whole labyrinths, and is ` +
      "corrected for the number of tests by Holm's method.",
    ),
  ];
}

/** Return one sentence on whether the promise is kept: no structure in two splits. */
function verdict({ pairs, repeated, strangers }) {
  const shared = pairs.reduce((sum, { counts }) => sum + counts.equal + counts.mirrored, 0);
  const again = Object.entries(repeated)
    .filter(([split, count]) => count && !(split in strangers))
    .map(([split, count]) => `${split} repeats ${plural(count, "structure")}`);
  const strange = Object.entries(strangers).filter(([, count]) => count)
    .map(([split, count]) => `${split} has ${plural(count, "structure")} that train has not`);
  const broken = [...again, ...strange];
  if (shared) broken.unshift("splits share structures");
  return notice(
    broken.length
      ? sentence(broken.join("; "))
      : "No structure is in two splits, not even mirrored, and none is repeated.",
  );
}

function examplesOf({ first, second, counts, examples }) {
  const rows = Object.entries(examples).flatMap(([kind, found]) =>
    found.map(([id, other]) => [idButton(id), idButton(other), [COMMON[kind], "text"]]),
  );
  if (!rows.length) return null;
  const total = Object.values(counts).reduce((sum, count) => sum + count, 0);
  const title = `${first}, ${second}: ${grouped(rows.length)} of ${grouped(total)} by id`;
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

/** Show the gallery with these filters and no others. */
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
    "splits", ["measure", "text"], "labyrinths", "distance", "effect d", "p alone", "p",
  ];
  return table("How the splits differ; * p of 0.05 or less", headings, rows);
}

function showResults() {
  const configs = [...new Set(DATA.results.map(({ config }) => config))];
  byId("runs").replaceChildren(
    ...(configs.length ? configs.flatMap(resultsOf) : [noResults()]),
  );
}

function noResults() {
  return notice(
    "There are no results of training on these datasets in the folder of runs. ",
    code("python run.py stages=[train,evaluate,report] method=bc"),
    " (with the options of the dataset) makes some and writes them here.",
  );
}

function resultsOf(config) {
  const runs = DATA.results.filter((run) => run.config === config);
  const splits = Object.keys(runs[0].splits);
  const cell = ({ sr, aer, aer_std: deviation }) =>
    `${percent(sr)}, ${aer.toFixed(2)} ± ${deviation.toFixed(2)}`;
  const baselines = Object.keys(Object.values(runs[0].baselines)[0] ?? {}).map((name) => [
    name.replaceAll("_", " "),
    ...splits.map((split) => cell(runs[0].baselines[split][name])),
  ]);
  const rows = runs.map((run) => [
    run.name, ...splits.map((split) => cell(run.splits[split])),
  ]);
  const panels = splits.map((split) => {
    const bars = runs.map((run) => ({
      name: run.name, share: run.splits[split].sr, interval: run.splits[split].sr_interval,
      colour: DATA.colours.goal,
    }));
    return panel(split, "", barPicture(bars, 1, `Success rate on ${split}`));
  });
  const results = figure(
    `${config}-results`, `Success rate, ${config}`,
    "Share of the labyrinths that one greedy episode solves, with its 95% interval.",
    panels,
    table("SR, and AER with its standard deviation", ["run", ...splits], [...rows, ...baselines]),
  );
  results.querySelector("details").open = true;
  return [results, ...runs.map(runDetails)];
}

function runDetails(run) {
  const share = (value, digits = 1) => (value === null ? "" : percent(value, digits));
  const rows = Object.entries(run.splits).map(([split, scores]) => [
    split,
    grouped(scores.labyrinths),
    share(scores.sr),
    scores.sr_interval.map((bound) => percent(bound, 0)).join(" to "),
    failedButton(run, split, scores),
    [Object.entries(scores.failures).map(([kind, count]) => `${count} ${kind}`).join(", "), "text"],
    `${scores.aer.toFixed(3)} ± ${scores.aer_std.toFixed(2)}`,
    share(scores.path_efficiency),
    share(scores.accuracy_on_demonstrations),
    share(scores.accuracy_elsewhere),
  ]);
  const headings = [
    "split", "labyrinths", "SR", "95%", "failed on", ["how", "text"], "AER", "path efficiency",
    "optimal where demonstrated", "optimal elsewhere",
  ];
  return element(
    "details", { open: DATA.results.length === 1 },
    element("summary", {}, runLabel(run)), table(runLabel(run), headings, rows),
  );
}

function failedButton(run, split, { failed, unsolved }) {
  if (!unsolved) return "none";
  const more = unsolved > failed.length ? `first ${grouped(failed.length)} of ` : "";
  const show = () => showInGallery({ split, failed: runLabel(run) });
  return element(
    "button", { type: "button", class: "quiet", click: show }, `${more}${grouped(unsolved)}: show`,
  );
}
