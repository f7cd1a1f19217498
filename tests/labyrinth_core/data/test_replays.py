"""Episodes replayed and drawn together are those that are replayed and drawn one by one."""

from __future__ import annotations

import numpy as np
import pyarrow.compute as pc
import pytest

from labyrinth_core.data import loader, observations, replays
from labyrinth_core.data.loader import load_transitions
from pipeline.config.dataset import DemonstrationsConfig

FIELDS = ("frames", "rows", "actions", "rewards", "dones", "labyrinth_ids")

BUILDS = {
    "navigation": {"size": "3x5", "shifts": ["recoloured", "thin_walls"]},
    "partial_observability": {"size": "4x3", "task": "partial_observability"},
    "key_and_door": {"size": "4x4", "task": "key_and_door", "solutions": "all"},
    "icy_floor": {"size": "4x5", "task": "icy_floor"},
    "pieces": {"size": "5", "demonstrations": DemonstrationsConfig(pieces=3)},
    "pieces with a key": {
        "size": "4",
        "task": "key_and_door",
        "demonstrations": DemonstrationsConfig(pieces=2),
    },
    "noise": {"size": "4", "demonstrations": DemonstrationsConfig(noise=0.3)},
}


@pytest.fixture(scope="module", params=BUILDS)
def run(request, build, tmp_path_factory):
    return build(tmp_path_factory.mktemp("data"), labyrinths=5, **BUILDS[request.param])


@pytest.fixture
def singly(monkeypatch):
    """Return what loads transitions with every episode replayed and drawn by itself."""

    def load(*arguments, **options):
        with monkeypatch.context() as patch:
            patch.setattr(loader, "replays_of", lambda _: None)
            return load_transitions(*arguments, **options)

    return load


@pytest.fixture
def together(monkeypatch):
    """Return what loads transitions, and fails if any episode is replayed by itself."""

    def refuse(*_):
        raise AssertionError("episodes are replayed one by one")

    def load(*arguments, **options):
        with monkeypatch.context() as patch:
            patch.setattr(loader, "episodes_of", refuse)
            return load_transitions(*arguments, **options)

    return load


def assert_same(found, expected):
    for name in FIELDS:
        ours, theirs = getattr(found, name), getattr(expected, name)
        assert ours.dtype == theirs.dtype
        np.testing.assert_array_equal(ours, theirs, name)


def splits_of(run):
    return sorted({path.name.partition("-")[0] for path in run.folder.glob("*-of-*.parquet")})


@pytest.mark.parametrize("small", [False, True], ids=["large blocks", "small blocks"])
def test_all_splits_are_those_that_are_drawn_singly(run, singly, together, small, monkeypatch):
    if small:
        monkeypatch.setattr(observations, "DRAWN_BYTES", 1_000)
        monkeypatch.setattr(replays, "DRAWN_CELLS", 40)
        monkeypatch.setattr(replays, "PARSED_CELLS", 1)
    for split in splits_of(run):
        options = {"split": split, "draw": True, "image_size": 9, "cache_dir": False}
        of_split = run.data_dir, run.folder.name
        assert_same(together(*of_split, **options), singly(*of_split, **options))


def test_thin_walls_and_the_cache_file_are_the_same(run, singly, together, tmp_path):
    options = {"split": "random", "image_size": 21, "resize": "original"}
    of_split = run.data_dir, run.folder.name
    kept = together(*of_split, **options, cache_dir=tmp_path)
    assert_same(kept, singly(*of_split, **options, cache_dir=False))
    assert_same(together(*of_split, **options, cache_dir=tmp_path), kept)


def test_some_labyrinths_are_those_that_are_drawn_singly(run, singly, together):
    of_split = run.data_dir, run.folder.name
    for some in ({"labyrinths": 2}, {"where": pc.field("first_row") > 0}):
        options = {"draw": True, "image_size": 8, "cache_dir": False, **some}
        assert_same(together(*of_split, **options), singly(*of_split, **options))
