// The player: one labyrinth, its episodes step by step, and the optimal actions in every state.

const player = { labyrinth: null, distance: null, episodes: [], states: [], at: 0, timer: null };
const STEP_MILLISECONDS = 350;

function openPlayer(place) {
  if (!gallery.matches.length) return;
  stopPlaying();
  activate(place);
  const [block, index] = locate(gallery.matches[gallery.active]);
  player.labyrinth = block.labyrinth(index);
  player.distance = distances(player.labyrinth);
  player.episodes = block.episodes(index);
  const id = block.hex("id", index);
  byId("player-title").textContent = `Labyrinth ${id}`;
  const facts = {
    Dataset: `${block.dataset.name}, ${block.split.name}, number ${grouped(index)}`,
    Structure: block.hex("structure", index),
    "Shortest route": plural(block.column("moves")[index], "move"),
    Loops: grouped(block.column("loops")[index]),
  };
  const failed = whoFailed(block, id);
  if (failed.length) facts["Not solved by"] = failed.join("; ");
  byId("facts").replaceChildren(
    ...Object.entries(facts).flatMap(([name, value]) => [
      element("dt", {}, name), element("dd", {}, value),
    ]),
  );
  const episodes = player.episodes.map((actions, number) => [
    number, `${number + 1} of ${player.episodes.length}: ${plural(actions.length, "step")}`,
  ]);
  fill(byId("episode"), episodes);
  byId("seen-option").hidden = player.labyrinth.task !== "partial_observability";
  chooseEpisode(0);
  if (byId("player").open) return;
  byId("player").showModal();
  byId("play").focus();
  showState(0); // Again, now that the dialog has a width.
}

function chooseEpisode(number) {
  player.actions = player.episodes[number];
  player.states = replay(player.labyrinth, player.actions);
  byId("progress").max = player.actions.length;
  showState(0);
}

function showState(at) {
  player.at = Math.max(0, Math.min(player.actions.length, at));
  const { labyrinth, distance, states, actions } = player;
  const state = states[player.at];
  byId("progress").value = player.at;
  byId("first").disabled = byId("back").disabled = player.at === 0;
  byId("forth").disabled = byId("last").disabled = player.at === actions.length;
  const best = optimalActions(labyrinth, distance, state).map((action) => ACTIONS[action]);
  const left = distance[state];
  const standing =
    left === 0 ? "on the goal"
    : labyrinth.ice.includes(state) ? "on ice"
    : left < 0 ? "no way to the goal"
    : `optimal: ${best.join(" or ")}; ${plural(left, "move")} to the goal`;
  const taken = player.at < actions.length ? `; taken: ${ACTIONS[actions[player.at]]}` : "; the end";
  byId("step").textContent = `State ${player.at} of ${actions.length}: ${standing}${taken}.`;
  drawState(state);
}

function drawState(state) {
  const { labyrinth, distance, states } = player;
  const cells = labyrinth.up.length;
  const view = { state, route: states.slice(0, player.at + 1).map((each) => each % cells) };
  if (byId("arrows").checked) view.arrows = arrowsOf(labyrinth, distance, state);
  if (byId("seen").checked && DATA.tasks[labyrinth.task].hides) {
    view.seen = visibleFrom(labyrinth, state % cells);
  }
  const stage = byId("stage");
  const most = Math.max(labyrinth.height, labyrinth.width);
  const tall = (labyrinth.height / most) || 1;
  const size = Math.min(stage.parentElement.clientWidth || 320, (window.innerHeight * 0.62) / tall);
  stage.setAttribute("aria-label", byId("step").textContent);
  paint(stage, labyrinth, Math.max(160, Math.floor(size)), view);
}

function stopPlaying() {
  clearInterval(player.timer);
  player.timer = null;
  byId("play").textContent = "Play";
}

function togglePlaying() {
  if (player.timer !== null) {
    stopPlaying();
    return;
  }
  if (player.at === player.actions.length) showState(0);
  byId("play").textContent = "Pause";
  player.timer = setInterval(() => {
    showState(player.at + 1);
    if (player.at === player.actions.length) stopPlaying();
  }, STEP_MILLISECONDS);
}

function playerKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const inControl = event.target.closest("select, input, button, label");
  const keys = {
    ArrowLeft: () => showState(player.at - 1),
    ArrowRight: () => showState(player.at + 1),
    Home: () => showState(0),
    End: () => showState(player.actions.length),
    " ": togglePlaying,
    n: () => openPlayer(gallery.active + 1),
    p: () => openPlayer(gallery.active - 1),
  };
  // Buttons and lists handle their own keys.
  const own = event.key === " " || inControl?.matches("select, input[type=range]");
  if (!(event.key in keys) || (inControl && own)) return;
  event.preventDefault();
  keys[event.key]();
}

function setUpPlayer() {
  const on = (id, act) => byId(id).addEventListener("click", act);
  on("first", () => showState(0));
  on("back", () => showState(player.at - 1));
  on("forth", () => showState(player.at + 1));
  on("last", () => showState(player.actions.length));
  on("play", togglePlaying);
  on("player-close", () => byId("player").close());
  on("copy", () => copyText(dump(player.labyrinth), byId("step")));
  byId("progress").addEventListener("input", (event) => {
    stopPlaying();
    showState(+event.target.value);
  });
  byId("episode").addEventListener("change", (event) => {
    stopPlaying();
    chooseEpisode(+event.target.value);
  });
  for (const id of ["arrows", "seen"]) {
    byId(id).addEventListener("change", () => showState(player.at));
  }
  byId("player").addEventListener("keydown", playerKey);
  byId("player").addEventListener("close", () => {
    stopPlaying();
    byId("list").focus();
  });
  window.addEventListener("resize", () => byId("player").open && showState(player.at));
}
