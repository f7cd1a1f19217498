// The gallery: filters, and a list in which only the visible tiles exist.

const THUMBNAIL = 96;
const TILE_WIDTH = 116; // At least; tiles share the width that is left.
const TILE_HEIGHT = 164;
const gallery = { matches: [], active: 0, tiles: new Map(), columns: 1, width: TILE_WIDTH };

function readFilters() {
  const form = byId("filters").elements;
  const number = (name, otherwise) => (form[name].value === "" ? otherwise : +form[name].value);
  return {
    split: form.split.value,
    size: form.size.value,
    task: form.task.value,
    minMoves: number("minMoves", 0),
    maxMoves: number("maxMoves", Infinity),
    minLoops: number("minLoops", 0),
    maxLoops: number("maxLoops", Infinity),
    id: form.id.value.trim().toLowerCase(),
    failed: failuresOf(form.failed.value),
  };
}

function filterGallery() {
  gallery.matches = select(readFilters());
  gallery.active = 0;
  const all = BLOCKS.reduce((sum, block) => sum + block.count, 0);
  const held = BLOCKS.reduce((sum, block) => sum + block.split.labyrinths, 0);
  const rest = held > all ? `; ${grouped(held - all)} more are not in this file` : "";
  byId("matches").textContent =
    `${grouped(gallery.matches.length)} of ${grouped(all)} labyrinths${rest}`;
  byId("list").scrollTop = 0;
  redrawGallery();
}

function redrawGallery() {
  for (const tile of gallery.tiles.values()) tile.remove();
  gallery.tiles.clear();
  showTiles();
}

/** Make the visible tiles, and remove the others. */
function showTiles() {
  const list = byId("list");
  if (!list.clientWidth) return;
  const columns = Math.max(1, Math.floor(list.clientWidth / TILE_WIDTH));
  const width = Math.floor(list.clientWidth / columns);
  if (columns !== gallery.columns || width !== gallery.width) {
    Object.assign(gallery, { columns, width });
    for (const tile of gallery.tiles.values()) tile.remove();
    gallery.tiles.clear();
  }
  const rows = Math.ceil(gallery.matches.length / columns);
  byId("spacer").style.height = `${rows * TILE_HEIGHT}px`;
  const firstRow = Math.floor(list.scrollTop / TILE_HEIGHT) - 1;
  const lastRow = Math.floor((list.scrollTop + list.clientHeight) / TILE_HEIGHT) + 1;
  const first = Math.max(0, firstRow * columns);
  const end = Math.min(gallery.matches.length, (lastRow + 1) * columns);
  for (const [place, tile] of gallery.tiles) {
    if (place < first || place >= end) {
      tile.remove();
      gallery.tiles.delete(place);
    }
  }
  for (let place = first; place < end; place++) {
    if (!gallery.tiles.has(place)) gallery.tiles.set(place, addTile(place));
  }
  markActive();
}

function addTile(place) {
  const [block, index] = locate(gallery.matches[place]);
  const labyrinth = block.labyrinth(index);
  const [moves, loops] = [block.column("moves")[index], block.column("loops")[index]];
  const canvas = element("canvas", { "aria-hidden": "true" });
  const name = block.hex("id", index).slice(0, 8);
  const tile = element(
    "div",
    {
      class: "tile", role: "option", id: `tile-${place}`,
      "aria-posinset": place + 1, "aria-setsize": gallery.matches.length,
      "aria-label":
        `${name}, ${block.split.name}, ${block.dataset.name}, ${plural(moves, "move")}, ` +
        plural(loops, "loop"),
      click: () => openPlayer(place),
    },
    canvas,
    element("span", { class: "name" }, name),
    element("span", {}, block.split.name),
    element("span", {}, `${plural(moves, "move")}, ${plural(loops, "loop")}`),
  );
  tile.style.width = `${gallery.width}px`;
  tile.style.height = `${TILE_HEIGHT}px`;
  tile.style.left = `${(place % gallery.columns) * gallery.width}px`;
  tile.style.top = `${Math.floor(place / gallery.columns) * TILE_HEIGHT}px`;
  paint(canvas, labyrinth, THUMBNAIL, { posts: false });
  byId("list").append(tile);
  return tile;
}

function markActive() {
  const list = byId("list");
  for (const [place, tile] of gallery.tiles) {
    const isActive = place === gallery.active;
    tile.classList.toggle("active", isActive && list.matches(":focus-visible"));
    tile.setAttribute("aria-selected", String(isActive));
  }
  if (gallery.tiles.has(gallery.active)) {
    list.setAttribute("aria-activedescendant", `tile-${gallery.active}`);
  } else {
    list.removeAttribute("aria-activedescendant");
  }
}

/** Make a labyrinth of the list the active one, and scroll to it. */
function activate(place) {
  const list = byId("list");
  gallery.active = Math.max(0, Math.min(gallery.matches.length - 1, place));
  const top = Math.floor(gallery.active / gallery.columns) * TILE_HEIGHT;
  if (top < list.scrollTop) list.scrollTop = top;
  const below = top + TILE_HEIGHT - list.clientHeight;
  if (below > list.scrollTop) list.scrollTop = below;
  showTiles();
}

function galleryKey(event) {
  const page = gallery.columns * Math.max(1, Math.floor(byId("list").clientHeight / TILE_HEIGHT));
  const steps = {
    ArrowRight: 1, ArrowLeft: -1, ArrowDown: gallery.columns, ArrowUp: -gallery.columns,
    PageDown: page, PageUp: -page, Home: -Infinity, End: Infinity,
  };
  if (event.key in steps) activate(gallery.active + steps[event.key]);
  else if (event.key === "Enter" || event.key === " ") openPlayer(gallery.active);
  else return;
  event.preventDefault();
}

/** Show the meaning of each colour that occurs in the datasets. */
function setUpLegend() {
  const tiles = { start: "start", goal: "goal" };
  for (const { task } of DATA.datasets) {
    for (const { name, meaning } of DATA.tasks[task].tiles) tiles[name] = meaning;
  }
  tiles.agent = "agent, in an episode";
  for (const [tile, words] of Object.entries(tiles)) {
    const swatch = element("i", { class: "swatch" });
    swatch.style.background = rgb(DATA.colours[tile]);
    byId("legend").append(element("span", {}, swatch, words));
  }
}

function setUpGallery() {
  setUpLegend();
  const form = byId("filters");
  const distinct = (values) => [...new Set(values)].map((value) => [value, value]);
  const words = (value) => value.replaceAll("_", " ");
  fill(form.elements.split, [["", "all"], ...distinct(BLOCKS.map(({ split }) => split.name))]);
  fill(form.elements.size, [["", "all"], ...distinct(DATA.datasets.map(sizeOf))]);
  const tasks = distinct(DATA.datasets.map(({ task }) => task));
  fill(form.elements.task, [["", "all"], ...tasks.map(([task]) => [task, words(task)])]);
  const failed = [...ATTEMPTS.keys()].map((name) => [name, name]);
  byId("method-filter").hidden = !failed.length;
  fill(form.elements.failed, [["", "no filter"], ...failed]);
  const list = byId("list");
  list.append(element("div", { id: "spacer", role: "presentation" }));
  form.addEventListener("input", filterGallery);
  form.addEventListener("reset", () => setTimeout(filterGallery));
  form.addEventListener("submit", (event) => event.preventDefault());
  let asked = false;
  list.addEventListener("scroll", () => {
    if (!asked) requestAnimationFrame(() => { asked = false; showTiles(); });
    asked = true;
  });
  list.addEventListener("keydown", galleryKey);
  list.addEventListener("focus", markActive);
  list.addEventListener("blur", markActive);
  new ResizeObserver(showTiles).observe(list);
  filterGallery();
}
