"""The page of the report, in a real browser."""

from __future__ import annotations

import base64
import io
import shutil
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect, sync_playwright
from reporting import METHOD, analyse, evaluate, evaluate_own, ids_of

from labyrinth_core.command.__main__ import main
from labyrinth_core.data.loader import load_episodes
from labyrinth_core.data.splits import BASE_SPLITS
from labyrinth_core.language.text import LabyrinthSyntaxError, dump, load, parse, without_agent
from labyrinth_core.pictures.renderer import DEFAULT_STYLE
from labyrinth_core.world.dynamics import initial, state_at, state_count, state_index
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Task
from labyrinth_core.world.random_labyrinth import sample_labyrinth
from labyrinth_core.world.solver import distances, optimal_actions
from pipeline.config.dataset import DemonstrationsConfig
from pipeline.config.run import Run
from pipeline.inspection.front_matter import finished
from pipeline.report.report import write_report

pytestmark = [pytest.mark.slow, pytest.mark.programs("chromium")]

DATA = Path(__file__).parents[2] / "data"
WAIT = 60_000
"""Milliseconds until it is said that something does not happen; nothing takes so long."""

expect.set_options(timeout=WAIT)

PARTS = ("gallery", "figures", "leakage", "results", "editor")
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True}


@pytest.fixture(scope="session")
def reported(build: Callable[..., Run], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with three datasets, an analysis and a run of the first, and the report on them."""
    data_dir = tmp_path_factory.mktemp("reported") / "labyrinth"
    first = build(data_dir, solutions="all").folder
    build(data_dir, size="4", task="key_and_door", labyrinths=3)
    in_pieces = DemonstrationsConfig(pieces=3)
    build(data_dir, size="4x5", task="icy_floor", labyrinths=2, demonstrations=in_pieces)
    analyse(first)
    for seed in (0, 1):
        evaluate(first, data_dir.parent / "runs", seed)
    write_report(data_dir, data_dir.parent / "runs")
    return data_dir


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"))
        yield browser
        browser.close()


@pytest.fixture
def open_report(browser: Browser, reported: Path) -> Iterator[Callable[..., Page]]:
    """A function that opens the report; nothing may be complained of, or asked of the network."""
    complaints: list[str] = []
    asked: list[str] = []
    contexts = []

    def opened(part: str = "gallery", **options: Any) -> Page:
        context = browser.new_context(**options)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(WAIT)
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(f"{(reported / 'report' / 'index.html').as_uri()}#/{part}")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert complaints == []
    assert {url.partition("#")[0] for url in asked} == {
        (reported / "report" / "index.html").as_uri()
    }


READ = """(cases) => cases.map(([name, data]) => {
  const {
    decode, parse, missingTiles, dump, distances, optimalActions, shortestRoute,
  } = window.labyrinths;
  try {
    const bytes = Uint8Array.from(atob(data), (char) => char.charCodeAt(0));
    const labyrinth = parse(decode(bytes));
    const missing = missingTiles(labyrinth);
    if (missing) return { missing };
    const distance = distances(labyrinth);
    const states = [...distance.keys()];
    return {
      text: dump(labyrinth), distances: [...distance],
      optimal: states.map((state) => optimalActions(labyrinth, distance, state)),
      moves: shortestRoute(labyrinth, distance).length,
    };
  } catch (error) {
    if (!error.full) throw error;
    return { error: error.full(name) };
  }
})"""


class MissingTilesError(Exception):
    """A drawing lacks tiles of its task; the message is what the page says of it."""


def refuse(structure, start, goal, task, *_, key=None, door=None):
    """Ask for the tiles that `place` would place, as the page does."""
    Labyrinth(structure, start, goal)
    if task is Task.ICY_FLOOR:
        raise MissingTilesError("icy floor needs ice, at least one I: the drawing has none")
    lacks = "no D" if key is not None else "no K" if door is not None else "neither"
    raise MissingTilesError(f"key and door needs a key K and a door D: the drawing has {lacks}")


def answer_of_python(name, read):
    """Return what the page should answer for a text, read by `read`."""
    try:
        labyrinth = read()
    except MissingTilesError as error:
        return {"missing": str(error)}
    except LabyrinthSyntaxError as error:
        return {"error": str(error).replace(error.file or "<text>", name, 1)}
    distance = distances(labyrinth)
    return {
        "text": dump(labyrinth),
        "distances": distance,
        "optimal": [np.flatnonzero(row).tolist() for row in optimal_actions(labyrinth)],
        "moves": distance[state_index(labyrinth, initial(labyrinth))],
    }


def sampled(count: int) -> list[Labyrinth]:
    """Return labyrinths of all tasks, small and not so small, some with the agent anywhere."""
    rng = np.random.default_rng(7)
    labyrinths = []
    while len(labyrinths) < count:
        height, width = rng.integers(3, 9, 2).tolist()
        try:
            task = list(Task)[len(labyrinths) % len(Task)]
            labyrinth = sample_labyrinth(height, width, task, rng)
            if rng.random() < 0.5:
                agent = state_at(labyrinth, int(rng.integers(state_count(labyrinth))))
                labyrinth = replace(labyrinth, agent=agent)
            labyrinths.append(labyrinth)
        except LabyrinthError:
            continue
    return labyrinths


def texts() -> dict[str, str]:
    """Return texts of labyrinths, and what becomes of them: without tiles, and with mistakes."""
    rng = np.random.default_rng(8)
    made = {}
    for number, labyrinth in enumerate(sampled(240)):
        text = dump(labyrinth)
        made[f"sampled {number}"] = text
        missing = "".join(rng.choice(list("KDI"), rng.integers(1, 4)))
        made[f"without tiles {number}"] = text.translate({ord(tile): " " for tile in missing})
        place = int(rng.integers(len(text)))
        mistake = rng.choice(list(" |-+SEKDIx:\n\t\u00e9'\"\U0001f600"))
        made[f"with a mistake {number}"] = text[:place] + str(mistake) + text[place + 1 :]
    return made


def test_the_page_reads_and_solves_as_python_does(open_report, monkeypatch):
    # Python places the tiles that a text leaves out; the page asks for them.
    monkeypatch.setattr("labyrinth_core.language.text.place", refuse)
    files = {path.name: path for path in sorted(DATA.glob("*/*.labyrinth"))}
    cases = [
        (name, path.read_bytes(), lambda path=path: load(path)) for name, path in files.items()
    ]
    cases += [
        (name, text.encode(), lambda text=text: parse(text)) for name, text in texts().items()
    ]
    given = [[name, base64.b64encode(data).decode()] for name, data, _ in cases]
    answers = open_report().evaluate(READ, given)
    expected = [answer_of_python(name, read) for name, _, read in cases]
    assert len(files) > 60
    assert sum("error" in each for each in expected) > 150
    assert len({each.get("missing") for each in expected}) == 5, "none, and four kinds of missing"
    for (name, *_), answer, wanted in zip(cases, answers, expected, strict=True):
        assert answer == wanted, name


def test_the_page_holds_every_labyrinth_and_episode_of_the_datasets(open_report, reported):
    packed = open_report().evaluate(
        """() => window.labyrinths.BLOCKS.map((block) => [
          block.dataset.name, block.split.name,
          Array.from({ length: block.count }, (_, index) => [
            block.hex("id", index), window.labyrinths.dump(block.labyrinth(index)),
            block.episodes(index),
          ]),
        ])"""
    )
    names = [manifest.config.name for manifest in finished(reported)]
    assert [(name, split) for name, split, _ in packed] == [
        (n, s) for n in names for s in BASE_SPLITS
    ]
    for name, split, labyrinths in packed:
        held = defaultdict(list)
        for episode in load_episodes(reported, name, split=split, observation="vector"):
            text = without_agent(episode.info)
            held[f"{episode.labyrinth_id:016x}", text].append(episode.actions.tolist())
        assert [((number, text), episodes) for number, text, episodes in labyrinths] == list(
            held.items()
        )


def test_a_labyrinth_is_found_played_edited_solved_and_copied(open_report, tmp_path, capsys):
    page = open_report(permissions=["clipboard-read", "clipboard-write"])
    page.select_option("select[name=task]", "key_and_door")
    page.select_option("select[name=split]", "test")
    assert page.locator("#matches").text_content() == "3 of 78 labyrinths"
    page.locator(".tile").nth(1).click()
    steps = int(page.locator("#progress").get_attribute("max"))
    for _ in range(steps):
        assert "optimal: " in page.locator("#step").text_content()
        page.locator("#forth").click()
    assert (
        f"State {steps} of {steps}: on the goal; the end." in page.locator("#step").text_content()
    )
    page.locator("#edit").click()
    before = page.locator("#text").input_value()
    # The wall between the first cell and the one above, which is either open or shut.
    board = page.locator("#board").bounding_box()
    page.mouse.click(board["x"] + board["width"] / 8, board["y"] + board["height"] * 0.76)
    edited = page.locator("#text").input_value()
    changed = [(a, b) for a, b in zip(before, edited, strict=True) if a != b]
    assert changed in ([("-", " ")], [(" ", "-")])
    if changed == [(" ", "-")]:  # What was shut may be in the way: the second cell is no worse.
        page.mouse.click(board["x"] + board["width"] / 8, board["y"] + board["height"] * 0.76)
    page.locator("#solve").click()
    solution = page.locator("#solution").text_content()
    page.locator("#copy").click()
    expect(page.locator("#copied")).to_have_text("Copied.")
    copied = tmp_path / "copied.labyrinth"
    copied.write_text(page.evaluate("navigator.clipboard.readText()"))
    moves = distances(parse(copied.read_text()))[parse(copied.read_text()).start]
    assert solution.startswith(f"{moves} moves: ")
    assert main(["check", str(copied)]) == 0
    assert capsys.readouterr().out == f"{copied}: ok, 4x4, key_and_door, {moves} moves\n"


def test_an_episode_is_saved_as_a_moving_picture(open_report, tmp_path):
    page = open_report()
    page.select_option("select[name=task]", "key_and_door")
    page.locator(".tile").first.click()
    with page.expect_download() as download:
        page.locator("#save-gif").click()
    path = tmp_path / download.value.suggested_filename
    download.value.save_as(path)
    states = int(page.locator("#progress").get_attribute("max")) + 1
    with Image.open(path) as picture:
        assert (picture.n_frames, picture.info["loop"]) == (states, 0)
        for at in range(states):
            picture.seek(at)
            frame = np.array(picture.convert("RGB"))
            drawn = page.evaluate(
                """([state, size]) => {
                  const canvas = document.createElement("canvas");
                  const { paint, player } = window.labyrinths;
                  paint(canvas, player.labyrinth, size, { state: player.states[state] });
                  return canvas.toDataURL().split(",")[1];
                }""",
                [at, len(frame)],
            )
            with Image.open(io.BytesIO(base64.b64decode(drawn))) as shown:
                assert np.array_equal(frame, np.array(shown.convert("RGB")))


def test_a_piece_of_a_route_is_played_from_where_it_begins(open_report, reported):
    page = open_report(permissions=["clipboard-read", "clipboard-write"])
    page.select_option("select[name=task]", "icy_floor")
    page.select_option("select[name=split]", "train")
    page.locator(".tile").first.click()
    episodes = list(load_episodes(reported, "4x5-icy_floor", observation="vector"))
    pieces = [each for each in episodes if each.labyrinth_id == episodes[0].labyrinth_id]
    assert len(pieces) > 1
    for number, piece in enumerate(pieces):
        page.select_option("#episode", str(number))
        labyrinth = parse(piece.info)
        left = distances(labyrinth)[initial(labyrinth).agent]
        begun = f"State 0 of {len(piece)}: optimal: "
        told = page.locator("#step").text_content()
        assert told.startswith(begun)
        assert f"; {left} move" in told
        page.locator("#copy-shown").click()
        assert page.evaluate("navigator.clipboard.readText()") == piece.info
        page.locator("#last").click()
        assert ("on the goal" in page.locator("#step").text_content()) == piece.terminated


def test_everything_can_be_reached_by_keyboard(open_report):
    page = open_report()
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.id") == "tab-gallery"
    for part in [*PARTS[1:], PARTS[0]]:
        page.keyboard.press("ArrowRight")
        assert page.locator(f"#{part}").is_visible()
    page.locator("#list").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("End")
    page.keyboard.press("Home")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    second = page.locator("#tile-1").get_attribute("aria-label")[:8]
    assert page.locator("#player-title").text_content().startswith(f"Labyrinth {second}")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowLeft")
    assert page.locator("#step").text_content().startswith("State 1 of ")
    page.keyboard.press("n")
    assert not page.locator("#player-title").text_content().startswith(f"Labyrinth {second}")
    page.keyboard.press("Escape")
    assert not page.locator("#player").is_visible()
    page.locator("#tab-editor").click()
    before = page.locator("#text").input_value()
    page.locator("#board").focus()
    for _ in range(2):
        page.keyboard.press("Shift+ArrowUp")
    assert page.locator("#text").input_value() == before
    page.keyboard.press("ArrowUp")
    page.keyboard.press("s")
    assert parse_drawing(page.locator("#text").input_value()) == 3


def parse_drawing(text: str) -> int:
    """Return the cell of the start in a 3x3 drawing, whether or not it can be solved."""
    lines = text.split("labyrinth:\n")[1].splitlines()
    row = next(number for number, line in enumerate(lines) if "S" in line)
    return 3 * ((5 - row) // 2) + (lines[row].index("S") - 2) // 4


def test_the_editor_says_what_is_wrong_and_where(open_report):
    page = open_report("editor")
    for name in ("no_route", "unknown_setting", "key_behind_the_door"):
        path = DATA / "invalid" / f"{name}.labyrinth"
        page.locator("#text").fill(path.read_text())
        place, message, shown = split_error(path.with_suffix(".error").read_text())
        told = page.locator("#mistake").text_content()
        assert told == f"Line {place[0]}, column {place[1]}: {message}\n{shown}"
        assert page.locator("#solution").text_content().startswith("The text has a mistake")
        assert page.locator("#solve").is_disabled()
    page.set_input_files("#open", DATA / "invalid" / "no_utf_8.labyrinth")
    expect(page.locator("#mistake")).to_contain_text("found the byte 0xe9")
    page.set_input_files("#open", DATA / "valid" / "figure_1c_key_and_door.labyrinth")
    expect(page.locator("#mistake")).to_be_hidden()
    assert page.locator("#edit-task").input_value() == "key_and_door"


def test_the_editor_asks_for_missing_tiles_and_solves_once_they_are_there(open_report):
    page = open_report("editor")
    said = page.locator("#solution")
    text = (DATA / "valid" / "figure_1c_key_and_door.labyrinth").read_text()
    needs = "Key and door needs a key K and a door D: the drawing has"
    for missing, lacks in (("KD", "neither"), ("K", "no K"), ("D", "no D")):
        page.locator("#text").fill(text.translate(dict.fromkeys(map(ord, missing), " ")))
        assert said.text_content() == f"{needs} {lacks}."
        assert page.locator("#solve").is_disabled()
        assert page.locator("#mistake").is_hidden()
    page.locator("#text").fill(text)
    assert said.text_content() == "Solvable; the shortest route has 8 moves."
    page.locator("#solve").click()
    page.select_option("#edit-task", "icy_floor")
    assert said.text_content() == "Icy floor needs ice, at least one I: the drawing has none."
    assert page.locator("#solve").is_disabled()
    page.select_option("#edit-task", "navigation")
    assert said.text_content().startswith("4 moves: ")


def test_what_was_found_out_leads_to_the_labyrinths(open_report, reported):
    page = open_report("leakage")
    test = ids_of(reported / "3x3", "test")
    assert "Splits share structures." in page.locator("#analysis").text_content()
    page.locator("#analysis summary").click()
    page.locator("#analysis button").first.click()
    assert page.locator("#matches").text_content() == "1 of 78 labyrinths"
    assert page.locator(".tile .name").text_content() == test[0][:8]
    page.locator("#tab-results").click()
    summary = page.locator("#runs > details > summary")
    assert summary.text_content() == f"{METHOD}: 2 runs, and what failed"
    # The method failed with every seed on one labyrinth, its first run on two.
    for number, (failed, name) in enumerate([(test[1:2], "every seed"), (test[:2], "seed0")]):
        page.locator("#tab-results").click()
        page.locator("#runs button").nth(number).click()
        names = page.locator(".tile .name").all_text_contents()
        assert names == [each[:8] for each in failed]
        page.locator(".tile").first.click()
        assert name in page.locator("#facts").text_content()
        page.keyboard.press("Escape")


def test_results_of_ones_own_policy_are_shown_where_it_has_some(browser, reported, tmp_path):
    data_dir = shutil.copytree(reported, tmp_path / "labyrinth")
    runs = shutil.copytree(reported.parent / "runs", tmp_path / "runs")
    evaluate_own(data_dir / "3x3", runs, "<i>Mine</i>")
    page = browser.new_page()
    page.goto(f"{write_report(data_dir, runs).as_uri()}#/results")
    row = page.locator("#runs tr", has_text="<i>Mine</i>").first
    cells = row.locator("td, th").all_text_contents()
    assert [bool(cell) for cell in cells] == [True, True, False, False, True, False, False]
    page.close()


def test_a_submission_stands_last_with_its_author(browser, reported, tmp_path):
    evaluate_own(reported / "3x3", tmp_path / "theirs", "Theirs", author="A. <b>N</b>")
    (tmp_path / "submissions").mkdir()
    shutil.copy(tmp_path / "theirs" / "3x3" / "mine" / "results.json", tmp_path / "submissions")
    data_dir = shutil.copytree(reported, tmp_path / "labyrinth")
    page = browser.new_page()
    report = write_report(data_dir, reported.parent / "runs", tmp_path)
    page.goto(f"{report.as_uri()}#/results")
    rows = page.locator("#runs section table tbody tr")
    assert rows.last.locator("td").first.text_content() == "Theirssubmitted by A. <b>N</b>"
    assert page.locator("#runs > details > summary").last.text_content() == (
        "Theirs: submitted, and what failed"
    )
    page.close()


def test_the_gallery_says_what_the_colours_mean(open_report):
    page = open_report()
    told = page.locator("#legend > span").all_text_contents()
    ice, agent = "ice, which ends the episode", "agent, in an episode"
    assert told == ["start", "goal", "key", "door", ice, agent]
    swatches = page.locator("#legend .swatch").all()
    colours = [each.evaluate("each => getComputedStyle(each).backgroundColor") for each in swatches]
    names = ("start", "goal", "key", "door", "ice", "agent")
    assert colours == [f"rgb{getattr(DEFAULT_STYLE, name)}" for name in names]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_a_phone_and_can_be_read_in_light_and_dark(open_report, scheme):
    page = open_report(color_scheme=scheme, **PHONE)
    assert page.evaluate("document.documentElement.dataset.theme") == scheme
    for part in PARTS:
        page.locator(f"#tab-{part}").tap()
        assert page.locator(f"#{part}").is_visible()
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        assert page.evaluate(
            "() => [...document.querySelectorAll('#analysis .scroll')]"
            ".every((each) => each.scrollWidth <= each.clientWidth)"
        )
        unnamed = page.evaluate(
            """() => [...document.querySelectorAll(
              "button, input, select, textarea, canvas[role], svg[role]"
            )].filter((each) => !(each.ariaLabel || each.textContent.trim() || each.labels?.length))
              .map((each) => each.outerHTML)"""
        )
        assert unnamed == []
    for ink in ("ink", "muted", "accent", "bad"):
        for paper in ("paper", "panel", "faint"):
            assert contrast(page, ink, paper) >= 4.5, (ink, paper)  # WCAG 2.2, AA.
    page.locator("#theme").tap()
    assert page.evaluate("document.documentElement.dataset.theme") == "light"


def contrast(page: Page, one: str, other: str) -> float:
    """Return the contrast of two colours of the page as WCAG counts it."""
    luminances = []
    for name in (one, other):
        text = page.evaluate(
            "(n) => getComputedStyle(document.documentElement).getPropertyValue(`--${n}`)", name
        )
        channels = [int(text.strip()[at : at + 2], 16) / 255 for at in (1, 3, 5)]
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
        luminances.append(0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2])
    return (max(luminances) + 0.05) / (min(luminances) + 0.05)


def split_error(text: str) -> tuple[tuple[str, str], str, str]:
    """Return line and column, message, and source line with caret of an expected error."""
    first, shown = text.rstrip("\n").split("\n", 1)
    _, line, column, message = first.split(":", 3)
    return (line, column), message.strip(), shown
