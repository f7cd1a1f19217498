// The text language, as labyrinth_core.language.text writes it.

const SETTINGS = {
  key_and_lock: "key_and_door",
  icy_floor: "icy_floor",
  occlusion: "partial_observability",
};

/** Return the text of a labyrinth. */
function dump(labyrinth) {
  const { height, width, up, right, task } = labyrinth;
  const tiles = new Map(labyrinth.ice.map((cell) => [cell, "I"]));
  if (labyrinth.key !== null) tiles.set(labyrinth.key, "K");
  if (labyrinth.door !== null) tiles.set(labyrinth.door, "D");
  tiles.set(labyrinth.start, "S");
  tiles.set(labyrinth.goal, "E");
  const columns = Array.from({ length: width }, (_, column) => column);
  const outerWall = "-".repeat(4 * width + 1);
  const lines = [outerWall];
  for (let row = height - 1; row >= 0; row--) {
    if (row < height - 1) {
      const walls = columns.map((column) => (up[row * width + column] ? " " : "-"));
      lines.push(`| ${walls.join(" + ")} |`);
    }
    const cells = columns.map((column) => {
      const cell = row * width + column;
      return ` ${tiles.get(cell) ?? " "} ${right[cell] ? " " : "|"}`;
    });
    lines.push(`|${cells.join("")}`);
  }
  const settings = Object.entries(SETTINGS).map(
    ([name, switchedOn]) => `${name}: ${switchedOn === task ? "True" : "False"}\n`,
  );
  return `${settings.join("")}\nlabyrinth:\n${lines.join("\n")}\n${outerWall}\nend\n`;
}
