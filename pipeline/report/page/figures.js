// Figures of a dataset, with a panel for each split, and their numbers in tables.

const ACTION_TILES = ["agent", "goal", "start", "key"]; // Their colours are those of the bars.
const BARS = 200; // The width of the area for bars.
const PANEL = { width: 280, height: 130, left: 38, bottom: 22, top: 8 };

/** Return a histogram as an SVG picture; `counts` are pairs of a value and its frequency. */
function histogram(counts, range, most, label) {
  const { width, height, left, bottom, top } = PANEL;
  const total = counts.reduce((sum, [, count]) => sum + count, 0) || 1;
  const values = range[1] - range[0] + 1;
  const wide = (width - left) / values;
  const tall = height - bottom - top;
  const picture = element("svg", {
    viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label,
  });
  for (const share of [0, most / 2, most]) {
    const y = height - bottom - (share / most) * tall;
    picture.append(
      element("line", { class: "axis", x1: left, x2: width, y1: y, y2: y }),
      element("text", { x: left - 5, y: y + 4, "text-anchor": "end" }, percent(share, 0)),
    );
  }
  for (const [value, count] of counts) {
    const long = (count / total / most) * tall;
    const bar = element("rect", {
      class: "mark", x: left + (value - range[0]) * wide + Math.min(1, wide / 8),
      width: Math.max(0.5, wide - Math.min(2, wide / 4)), y: height - bottom - long, height: long,
    });
    bar.append(element("title", {}, `${value}: ${grouped(count)} (${percent(count / total)})`));
    picture.append(bar);
  }
  for (const value of ticks(range)) {
    const x = left + (value - range[0] + 0.5) * wide;
    picture.append(element("text", { x, y: height - 6, "text-anchor": "middle" }, value));
  }
  return picture;
}

/** Return a few evenly spaced whole numbers of a range. */
function ticks([low, high]) {
  const apart = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 5000, 20000].find(
    (step) => (high - low) / step <= 7,
  ) ?? high;
  const first = Math.ceil(low / apart) * apart;
  return Array.from({ length: Math.floor((high - first) / apart) + 1 }, (_, at) => first + at * apart);
}

/** Return a share rounded up so that the value and its half are round numbers on an axis. */
function roundedUp(share) {
  const step = share > 0.2 ? 0.2 : share > 0.04 ? 0.04 : 0.02;
  return Math.ceil(share / step - 1e-9) * step;
}

const mean = (counts) => {
  const total = counts.reduce((sum, [, count]) => sum + count, 0);
  return counts.reduce((sum, [value, count]) => sum + value * count, 0) / total;
};

/** Return the figure of a distribution over the labyrinths of each split. */
function distribution(dataset, key, title, text, unit) {
  const all = dataset.splits.flatMap((split) => split[key].map(([value]) => value));
  const range = [Math.min(...all), Math.max(...all)];
  const most = roundedUp(Math.max(
    ...dataset.splits.flatMap((split) => split[key].map(([, count]) => count / split.labyrinths)),
  ));
  const panels = dataset.splits.map((split) => {
    const average = `mean ${mean(split[key]).toFixed(2)}`;
    const label = `${title} in ${split.name}: ${average} ${unit}`;
    return panel(split.name, average, histogram(split[key], range, most, label));
  });
  const values = [...new Set(all)].sort((a, b) => a - b);
  const rows = values.map((value) => [
    grouped(value),
    ...dataset.splits.map((split) =>
      grouped((split[key].find(([each]) => each === value) ?? [0, 0])[1]),
    ),
  ]);
  const names = dataset.splits.map(({ name }) => name);
  const numbers = table(`${title}: labyrinths`, [unit, ...names], rows);
  return figure(title, text, panels, numbers);
}

function panel(name, note, picture) {
  const caption = element("figcaption", {}, `${name} `, element("span", {}, note));
  return element("figure", {}, caption, picture);
}

function figure(title, text, panels, numbers) {
  return element(
    "section", { class: "figure" },
    element("h2", {}, title),
    element("p", { class: "muted" }, text),
    element("div", { class: "panels" }, ...panels),
    element("details", {}, element("summary", {}, "Numbers"), numbers),
  );
}

/** Return a picture of shares as horizontal bars, some with an interval. */
function barPicture(bars, most, label) {
  const left = 12 + 6 * Math.max(...bars.map(({ name }) => name.length));
  const scale = (BARS - 44) / most; // Leaves room for a number beside the longest.
  const told = bars.map(({ name, share }) => `${name} ${percent(share)}`).join(", ");
  const picture = element("svg", {
    viewBox: `0 0 ${left + BARS} ${24 * bars.length + 6}`, role: "img",
    "aria-label": `${label}: ${told}`,
  });
  bars.forEach(({ name, share, interval, colour }, number) => {
    const y = 4 + 24 * number;
    const [low, high] = interval ?? [share, share];
    picture.append(
      element("text", { x: left - 6, y: y + 13, "text-anchor": "end" }, name),
      element("rect", { x: left, y, height: 18, width: share * scale, fill: rgb(colour) }),
      element("text", { x: left + 6 + high * scale, y: y + 13 }, percent(share)),
    );
    if (high > low) {
      const [x1, x2] = [left + low * scale, left + high * scale];
      picture.append(element("line", { class: "interval", x1, x2, y1: y + 9, y2: y + 9 }));
    }
  });
  return picture;
}

function actionFigure(dataset) {
  const shares = dataset.splits.map(({ actions }) => {
    const total = actions.reduce((sum, count) => sum + count, 0);
    return actions.map((count) => count / total);
  });
  const most = Math.max(...shares.flat());
  const panels = dataset.splits.map(({ name }, place) => {
    const bars = ACTIONS.map((action, number) => ({
      name: action, share: shares[place][number], colour: DATA.colours[ACTION_TILES[number]],
    }));
    return panel(name, "", barPicture(bars, most, `Actions in ${name}`));
  });
  const rows = dataset.splits.map(({ name, actions }) => [name, ...actions.map(grouped)]);
  return figure(
    "Actions", "Share of each action among all actions of the episodes.",
    panels, table("Actions: how often each is taken", ["split", ...ACTIONS], rows),
  );
}

function visitFigure(dataset) {
  const { height, width } = dataset;
  const totals = dataset.splits.map(({ visits }) => visits.reduce((sum, count) => sum + count, 0));
  const most = Math.max(...dataset.splits.map(({ visits }, at) => Math.max(...visits) / totals[at]));
  const panels = dataset.splits.map(({ name, visits }, at) => {
    const canvas = element("canvas", { role: "img" });
    const busiest = visits.indexOf(Math.max(...visits));
    const share = percent(visits[busiest] / totals[at]);
    const where = `row ${Math.floor(busiest / width)}, column ${busiest % width}`;
    canvas.setAttribute("aria-label", `Visited cells in ${name}: most often ${where}, ${share}`);
    paintHeat(canvas, dataset, visits.map((count) => count / totals[at]), most);
    return panel(name, `maximum ${share}`, canvas);
  });
  const rows = [];
  for (let cell = 0; cell < Math.min(height * width, 400); cell++) {
    const place = `${Math.floor(cell / width)}, ${cell % width}`;
    rows.push([place, ...dataset.splits.map(({ visits }) => grouped(visits[cell]))]);
  }
  const names = dataset.splits.map(({ name }) => name);
  const caption = height * width > 400 ? "Visited cells: the first 400" : "Visited cells: states";
  return figure(
    "Visited cells",
    "Share of a split's states with the agent in each cell, on one scale for all splits; row 0 is at the bottom.",
    panels, table(caption, ["row, column", ...names], rows),
  );
}

/** Paint shares of the cells; the deeper the colour, the larger the share. */
function paintHeat(canvas, { height, width }, shares, most) {
  const pitch = Math.max(1, Math.floor((220 * window.devicePixelRatio) / Math.max(height, width)));
  canvas.width = pitch * width;
  canvas.height = pitch * height;
  canvas.style.width = `${canvas.width / window.devicePixelRatio}px`;
  const pencil = canvas.getContext("2d");
  const [none, full] = isDark()
    ? [[38, 43, 48], [120, 226, 190]]
    : [[240, 243, 242], [0, 82, 60]];
  const gap = pitch > 8 ? 1 : 0;
  const size = Math.round(pitch / 4.2);
  pencil.font = `${size}px system-ui, sans-serif`;
  pencil.textAlign = "center";
  pencil.textBaseline = "middle";
  shares.forEach((share, cell) => {
    const part = share / most;
    const colour = none.map((channel, at) => Math.round(channel + part * (full[at] - channel)));
    const [x, y] = [(cell % width) * pitch, (height - 1 - Math.floor(cell / width)) * pitch];
    pencil.fillStyle = rgb(colour);
    pencil.fillRect(x, y, pitch - gap, pitch - gap);
    if (pitch < 34 * window.devicePixelRatio) return;
    pencil.fillStyle = part > 0.5 === isDark() ? "#101316" : "#ffffff";
    if (part <= 0.5) pencil.fillStyle = isDark() ? "#e4e7ea" : "#1d2126";
    pencil.fillText(percent(share), x + pitch / 2, y + pitch / 2);
  });
}

function showFigures() {
  const dataset = DATA.datasets[byId("figures-dataset").selectedIndex];
  byId("charts").replaceChildren(
    distribution(
      dataset, "moves", "Route length", "Moves of a shortest route from start to goal.", "moves",
    ),
    actionFigure(dataset),
    visitFigure(dataset),
    distribution(
      dataset, "loops", "Loops",
      "Passages beyond those of a spanning tree (passages - cells + 1).", "loops",
    ),
    distribution(
      dataset, "junctions", "Branching", "Cells with three or four passages.", "junctions",
    ),
  );
}
