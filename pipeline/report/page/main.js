// The tabs of the page, of which one is shown, and the theme.

const PARTS = ["gallery", "figures", "leakage", "results"];
const DRAW = {
  gallery: redrawGallery, figures: showFigures, leakage: showLeakage,
  results: showResults,
};
const THEMES = ["auto", "light", "dark"];
const darkPreferred = window.matchMedia("(prefers-color-scheme: dark)");
let theme = "auto";
let shownPart = null;

function showPart(part) {
  shownPart = part;
  for (const each of PARTS) {
    const tab = byId(`tab-${each}`);
    tab.setAttribute("aria-selected", String(each === part));
    tab.tabIndex = each === part ? 0 : -1;
    byId(each).hidden = each !== part;
  }
  history.replaceState(null, "", `#/${part}`);
  DRAW[part]();
}

/** Show the part that the address names, as `#leakage` or `#/leakage`; else the gallery. */
function showAsked() {
  const asked = location.hash.replace(/^#\/?/, "");
  showPart(PARTS.includes(asked) ? asked : "gallery");
}

function tabKey(event) {
  const at = PARTS.indexOf(shownPart);
  const to = { ArrowRight: at + 1, ArrowLeft: at - 1, Home: 0, End: PARTS.length - 1 }[event.key];
  if (to === undefined) return;
  event.preventDefault();
  const part = PARTS[(to + PARTS.length) % PARTS.length];
  showPart(part);
  byId(`tab-${part}`).focus();
}

function applyTheme() {
  const chosen = theme === "auto" ? (darkPreferred.matches ? "dark" : "light") : theme;
  document.documentElement.dataset.theme = chosen;
  byId("theme").textContent = `Theme: ${theme}`;
  if (shownPart) {
    DRAW[shownPart]();
    if (byId("player").open) showState(player.at);
  }
}

function setUp() {
  applyTheme();
  byId("theme").addEventListener("click", () => {
    theme = THEMES[(THEMES.indexOf(theme) + 1) % THEMES.length];
    applyTheme();
  });
  darkPreferred.addEventListener("change", applyTheme);
  const labyrinths = DATA.datasets.flatMap(({ splits }) => splits.map((split) => split.labyrinths));
  const total = labyrinths.reduce((sum, count) => sum + count, 0);
  byId("summary").textContent =
    `${DATA.datasets.map(({ name }) => name).join(", ")}: ${plural(total, "labyrinth")}`;
  for (const id of ["figures-dataset", "leakage-dataset"]) {
    fill(byId(id), DATA.datasets.map(({ name }) => [name, name]));
  }
  byId("figures-dataset").addEventListener("change", showFigures);
  byId("leakage-dataset").addEventListener("change", showLeakage);
  for (const part of PARTS) {
    byId(`tab-${part}`).addEventListener("click", () => showPart(part));
    byId(`tab-${part}`).addEventListener("keydown", tabKey);
  }
  setUpGallery();
  setUpPlayer();
  byId("filter-box").open = !window.matchMedia("(max-width: 760px)").matches;
  window.addEventListener("hashchange", showAsked);
  showAsked();
  performance.mark("usable");
}

// For the tests and the browser's console.
window.labyrinths = { BLOCKS, dump, distances, optimalActions, paint, visibleFrom };
setUp();
