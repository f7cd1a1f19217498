"""One change to a file of results is refused, or changes nothing that is shown.

All fields of a run and of a submission are walked. What their authors alone can know is excepted:
it may be changed, and the figures and the ranks stay.
"""

from __future__ import annotations

import csv
import json
from copy import deepcopy

import pytest
from support.submitted import ACCURACIES, content_of, forgetful, of_run, results_of

from labyrinth_core.errors import DatasetError
from pipeline.results import results as stage

TABLES = ("leaderboard.md", "leaderboard.csv", "README.md", "results.csv")

STATED = {
    ("method",): "what a submission says of itself",
    ("evaluated", "version"): "the software that evaluated it",
    ("evaluated", "observation"): "what it was shown, if not pictures",
    ("run", "training"): "how long it was trained, and on what",
    **{("splits", "*", name): "a share of the right number of states" for name in ACCURACIES},
}
"""Field that only the authors know -> what it is."""

SHOWN = ("test",)
"""The split that is walked; all are read alike, and a submission has no other."""

BASELINES = (("baselines", "oracle"), ("baselines", "random"))
"""The baselines whose figures are walked: one of those that `evaluate` reports, and a blind one."""

FIGURES = ("rank", "labyrinths", "spl", "sr_within_cells", "sr", "aer", "aer_std")


def places_of(value, path=()):
    """Return the place of each value that is walked, those that hold others, too."""
    places = [path] if path else []
    keys = list(value) if isinstance(value, dict) else []
    if isinstance(value, list):
        keys = sorted({0, len(value) - 1}) if value else []
    elif path == ("splits",) or path in BASELINES:
        keys = SHOWN
    elif len(path) == 2 and path[0] == "baselines":
        keys = []
    return places + [place for key in keys for place in places_of(value[key], (*path, key))]


def others_of(value):
    """Return values that may stand in place of one, of the same kind and of others."""
    if isinstance(value, bool) or value is None:
        return [not value, 1, "x"]
    if isinstance(value, int):
        return [value + 1, value - 1, value + 2, 0, 10**15, -1, value + 0.5, None, str(value)]
    if isinstance(value, float):
        return [value + 1e-6, value - 1e-6, 0.0, 1.0, 1e9, -1e9, None, "x"]
    if isinstance(value, str):
        changed = [value + "0", value[:-1], value.swapcase(), value[::-1], "", "../x", None, 7]
        swapped = value.translate(str.maketrans("01slw", "10lws"))
        return [*changed, swapped, swapped[:1] + value[1:]]
    if isinstance(value, list):
        return [value[:-1], [*value, *value[-1:]], value[::-1], [], None, {}]
    return [{}, None, [], {**value, "test": {}}, dict(list(value.items())[1:])]


def changes_of(content):
    """Return each place with each other value; `...` stands for none at all."""
    found = []
    for place in places_of(content):
        value = content
        for key in place:
            value = value[key]
        others = [each for each in others_of(value) if json.dumps(each) != json.dumps(value)]
        if isinstance(place[-1], str):
            others.append(...)
        found += [(place, other) for other in others]
    return [(place, other) for place, other in found if not is_of_fewer_splits(place, other)]


def is_of_fewer_splits(place, other):
    """Return whether a change makes an honest file on fewer splits."""
    return place[0] == "splits" and (other is ... or isinstance(other, dict)) and len(place) <= 2


def is_stated(place):
    for stated in STATED:
        pairs = zip(stated, place, strict=False)
        if len(place) >= len(stated) and all(mine in ("*", theirs) for mine, theirs in pairs):
            return True
    return False


class Board:
    """A folder of results with one file, in which a field is changed."""

    def __init__(self, folder, make_run, source, name):
        results = results_of(source, "3x3", forgetful(3, 3))
        about = {"author": "me", "details": {"steps": 7}}
        is_run = name.startswith("runs/")
        self.content = content_of(of_run(results)) if is_run else content_of(results, **about)
        if not is_run:
            self.content["splits"] = {split: self.content["splits"][split] for split in SHOWN}
        self.folder, self.path = folder, folder / name
        self.path.parent.mkdir(parents=True)
        options = {"run_dir": str(folder / "none"), "results_dir": str(folder)}
        self.run = make_run(source, stages=["results"], **options)
        self.checks = stage.Checks(self.run)
        self.shown = self.show(self.content)

    def show(self, content):
        """Return the tables made from the file with some content; None if it is refused."""
        self.path.write_text(json.dumps(content), encoding="utf-8")
        try:
            stage.run(self.run)
        except DatasetError as error:
            first, why = str(error).splitlines()
            assert first == "1 file not on the leaderboard:"
            assert " is refused: " in why
            return None
        return {
            name: (self.folder / name).read_text(encoding="utf-8")
            for name in TABLES
            if (self.folder / name).exists()
        }

    def figures(self, shown):
        rows = csv.DictReader(shown["leaderboard.csv"].splitlines())
        return sorted([row["split"], *(row[name] for name in FIGURES)] for row in rows)

    def check(self, place, other):
        content = deepcopy(self.content)
        *way, last = place
        inner = content
        for key in way:
            inner = inner[key]
        if other is ...:
            del inner[last]
        else:
            inner[last] = other
        shown = self.show(content)
        if shown is not None and is_stated(place):
            assert self.figures(shown) == self.figures(self.shown), (place, other)
        elif shown is not None:
            assert shown == self.shown, (place, other)


@pytest.fixture(scope="module", params=["submissions/x.json", "runs/3x3/bc-cnn-seed0.json"])
def board(small_dataset, make_run, tmp_path_factory, request):
    folder = tmp_path_factory.mktemp("results")
    return Board(folder, make_run, small_dataset.data_dir, request.param)


@pytest.mark.slow
def test_every_changed_field_is_refused_or_changes_nothing_that_is_shown(board, monkeypatch):
    # Read once, not for each change.
    monkeypatch.setattr(stage, "Checks", lambda _: board.checks)
    for place, other in changes_of(board.content):
        board.check(place, other)
