"""The page of the report, in a real browser."""

from __future__ import annotations

import shutil
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright
from support.making import Run
from support.reporting import METHOD, analyse, evaluate, evaluate_own, ids_of

from labyrinth_core import evaluate as evaluate_policy
from labyrinth_core import load_episodes, memorised
from labyrinth_core.command.__main__ import main
from labyrinth_core.data import SPLITS
from labyrinth_core.language import dump
from labyrinth_core.pictures import DEFAULT_STYLE, PICTURE_SIZE, render
from labyrinth_core.world import (
    TILES,
    Labyrinth,
    LabyrinthError,
    Solver,
    State,
    Task,
    sample_labyrinth,
)
from pipeline.inspection import front_matter
from pipeline.report.report import write_report

pytestmark = [pytest.mark.slow, pytest.mark.programs("chromium")]

WAIT = 60_000
"""Milliseconds until it is said that something does not happen; nothing takes so long."""

expect.set_options(timeout=WAIT)

PARTS = ("gallery", "figures", "leakage", "results")
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True}


@pytest.fixture(scope="session")
def reported(build: Callable[..., Run], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with three datasets, an analysis and a run of the first, and the report on them."""
    data_dir = tmp_path_factory.mktemp("reported") / "labyrinth"
    first = build(data_dir, solutions="all").folder
    build(data_dir, size="4", task="key_and_door", labyrinths=3)
    build(data_dir, size="4x5", task="icy_floor", labyrinths=2)
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
        page.goto(f"{(reported / 'report' / 'index.html').as_uri()}#{part}")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert complaints == []
    assert {url.partition("#")[0] for url in asked} == {
        (reported / "report" / "index.html").as_uri()
    }


SOLVE = """(labyrinths) => labyrinths.map((labyrinth) => {
  const { dump, distances, optimalActions } = window.labyrinths;
  const distance = distances(labyrinth);
  const states = [...distance.keys()];
  return {
    text: dump(labyrinth), distances: [...distance],
    optimal: states.map((state) => optimalActions(labyrinth, distance, state)),
  };
})"""


DARK = """([labyrinth, state, size]) => {
  const { paint, visibleFrom } = window.labyrinths;
  const canvas = document.createElement("canvas");
  paint(canvas, labyrinth, size, { state, seen: visibleFrom(labyrinth, state) });
  const { data } = canvas.getContext("2d").getImageData(0, 0, size, size);
  return Array.from({ length: size * size }, (_, pixel) =>
    +(Math.max(data[4 * pixel], data[4 * pixel + 1], data[4 * pixel + 2]) < 50)).join("");
}"""
"""A digit for each pixel: 1 if the page makes it dark, as walls and what the agent does not see."""


def of_the_page(labyrinth: Labyrinth) -> dict[str, Any]:
    """Return a labyrinth in the form that the page's program gives it."""
    structure = labyrinth.structure
    cells = range(structure.cells)
    return {
        "height": structure.height,
        "width": structure.width,
        "up": [structure.up >> cell & 1 for cell in cells],
        "right": [structure.right >> cell & 1 for cell in cells],
        "start": labyrinth.start,
        "goal": labyrinth.goal,
        "task": str(labyrinth.task),
    } | {
        tile.name: sorted(value) if tile.many else value
        for tile in TILES
        for value in [getattr(labyrinth, tile.name)]
    }


def sampled(count: int) -> list[Labyrinth]:
    """Return labyrinths of all tasks, small and not so small."""
    rng = np.random.default_rng(7)
    labyrinths = []
    while len(labyrinths) < count:
        height, width = rng.integers(3, 9, 2).tolist()
        try:
            task = list(Task)[len(labyrinths) % len(Task)]
            labyrinths.append(sample_labyrinth(height, width, task, rng))
        except LabyrinthError:
            continue
    return labyrinths


def test_the_page_writes_and_solves_a_labyrinth_as_python_does(open_report):
    labyrinths = sampled(240)
    answers = open_report().evaluate(SOLVE, [of_the_page(each) for each in labyrinths])
    for labyrinth, answer in zip(labyrinths, answers, strict=True):
        assert answer == {
            "text": dump(labyrinth),
            "distances": Solver(labyrinth).distances,
            "optimal": [
                np.flatnonzero(row).tolist() for row in Solver(labyrinth).optimal_actions()
            ],
        }


def test_the_page_hides_from_the_agent_what_its_pictures_hide(open_report):
    page, rng = open_report(color_scheme="light"), np.random.default_rng(8)
    for size in (3, 5, 8):
        labyrinth = sample_labyrinth(size, size, Task.PARTIAL_OBSERVABILITY, rng)
        for agent in rng.choice(size * size, 3, replace=False).tolist():
            given = [of_the_page(labyrinth), agent, PICTURE_SIZE]
            dark = np.frombuffer(page.evaluate(DARK, given).encode(), np.uint8) == ord("1")
            picture = render(labyrinth, State(agent))
            assert np.array_equal(dark, (picture == 0).all(axis=2).ravel())


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
    names = [manifest.config.name for manifest in front_matter.finished(reported)]
    assert [(name, split) for name, split, _ in packed] == [
        (n, s) for n in names for s in SPLITS.base
    ]
    for name, split, labyrinths in packed:
        held = defaultdict(list)
        for episode in load_episodes(reported, name, split=split, observation="vector"):
            held[f"{episode.labyrinth_id:016x}", episode.info].append(episode.actions.tolist())
        assert [((number, text), episodes) for number, text, episodes in labyrinths] == list(
            held.items()
        )


def test_a_labyrinth_is_found_played_and_copied(open_report, tmp_path, capsys):
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
    page.locator("#copy").click()
    expect(page.locator("#step")).to_have_text("Copied.")
    copied = tmp_path / "copied.labyrinth"
    copied.write_text(page.evaluate("navigator.clipboard.readText()"))
    assert main(["check", str(copied)]) == 0
    assert capsys.readouterr().out == f"{copied}: ok, 4x4, key_and_door, {steps} moves\n"


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
    assert summary.text_content() == f"{METHOD}: 2 runs, with failures"
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


def test_the_copies_of_a_policy_stand_beside_their_twins(browser, reported, tmp_path):
    data_dir = shutil.copytree(reported, tmp_path / "labyrinth")

    def right(vectors: Any) -> Any:
        return np.ones(len(vectors), np.int64)

    receipt = memorised(right, data_dir, "3x3", observation="vector", controls=10)
    results = evaluate_policy(right, data_dir, "3x3", observation="vector")
    path = tmp_path / "runs" / "3x3" / "right" / "results.json"
    replace(results, memorised=receipt).save(path, name="right")
    write_report(data_dir, tmp_path / "runs")
    page = browser.new_page(viewport={"width": 390, "height": 844})
    page.goto(f"{(data_dir / 'report' / 'index.html').as_uri()}#results")
    expect(page.locator("#runs")).to_contain_text(f"{receipt.p:.3f} of 10")
    assert page.locator(".copies figure").count() == len(receipt.copies)
    first = page.locator(".copies figure").first
    expect(first).to_contain_text(receipt.copies[0].train_labyrinth)
    assert first.locator("canvas").count() == 2
    # No copy is wider than a phone.
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
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
        "Theirs: submitted, with failures"
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


def test_the_address_chooses_the_part_and_a_phone_begins_with_labyrinths(open_report):
    page = open_report("leakage", **PHONE)
    assert page.locator("#leakage").is_visible()
    for address, part in {
        "#/figures": "figures",
        "#results": "results",
        "#other": "gallery",
    }.items():
        page.evaluate("address => { location.hash = address; }", address)
        page.locator(f"#{part}").wait_for()
    assert not page.locator("#filters").is_visible()
    page.locator("#filter-box > summary").tap()
    assert page.locator("#filters").is_visible()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_a_phone_and_can_be_read_in_light_and_dark(open_report, scheme):
    page = open_report(color_scheme=scheme, **PHONE)
    assert page.evaluate("document.documentElement.dataset.theme") == scheme
    for part in PARTS:
        page.locator(f"#tab-{part}").tap()
        assert page.locator(f"#{part}").is_visible()
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        assert page.evaluate(
            "() => [...document.querySelectorAll('#analysis th')]"
            ".every((each) => getComputedStyle(each).writingMode === 'horizontal-tb')"
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
