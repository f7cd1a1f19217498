// The text language, as labyrinth_core.language.text writes it.

/** Return the text of a labyrinth. */
function dump(labyrinth) {
  const { height, width, up, right, task } = labyrinth;
  const tiles = new Map();
  for (const tile of DATA.tasks[task].tiles) {
    for (const cell of cellsOf(labyrinth, tile)) tiles.set(cell, tile.letter);
  }
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
  return `${DATA.tasks[task].settings}\nlabyrinth:\n${lines.join("\n")}\n${outerWall}\nend\n`;
}
