"""What all tests share: examples that are the same in every run, no network, small datasets.

The library `datasets` reads where its cache lies when it is imported, so that is settled first.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from support.making import Run, build_dataset, run_of

from labyrinth_core.world import Task

settings.register_profile(
    "house",
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.register_profile("fast", settings.get_profile("house"), max_examples=25)
settings.load_profile("house")

_private = pytest.StashKey[Path]()

MISSING = "missing program"
"""The property of a skipped test's report that names a program; pytest-xdist passes it on."""


def pytest_addoption(parser: pytest.Parser) -> None:
    text = "write down what pictures and rows are now, instead of comparing them with tests/data"
    parser.addoption("--renew", action="store_true", help=text)


def pytest_configure(config: pytest.Config) -> None:
    if config.option.renew and getattr(config.option, "numprocesses", None):
        raise pytest.UsageError("--renew: give -n0, since all tests write to the same files")
    if config.option.markexpr == "not slow":
        settings.load_profile("fast")
    folder = Path(tempfile.mkdtemp(prefix="labyrinth-tests-"))
    config.stash[_private] = folder
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # Tests run in parallel already.
    # What a killed process has written is not lost, so waiting for the disk proves nothing. That
    # all is synced before it counts as complete is a test of its own, with a function of its own.
    os.fsync = lambda _: None
    os.environ["HF_HUB_OFFLINE"] = "1"
    os.environ["HF_HOME"] = str(folder / "huggingface")
    os.environ["XDG_CACHE_HOME"] = str(folder / "cache")
    os.environ["HF_DATASETS_CACHE"] = str(folder / "huggingface" / "datasets")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave a file whose tests are all slow unread in the fast lane.

    Importing what such files need (Dask, a server of S3) takes longer than many tests.
    """
    if config.option.markexpr != "not slow" or collection_path.suffix != ".py":
        return None
    text = collection_path.read_text("utf-8")
    return bool(re.search(r"^pytestmark = .*pytest\.mark\.slow\b", text, re.MULTILINE)) or None


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a test, before its fixtures are made, that needs a program that is not installed."""
    needed = {name for mark in item.iter_markers("programs") for name in mark.args}
    missing = sorted(name for name in needed if shutil.which(name) is None)
    if missing:
        item.user_properties += [(MISSING, name) for name in missing]
        pytest.skip(f"not installed: {', '.join(missing)}")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say at the end which programs were missing, and how to get them."""
    skipped = [
        [name for key, name in report.user_properties if key == MISSING]
        for report in terminalreporter.stats.get("skipped", ())
    ]
    if missing := " ".join(sorted({name for names in skipped for name in names})):
        count = sum(map(bool, skipped))
        terminalreporter.write_line(f"{count} tests skipped; programs not installed: {missing}")
        terminalreporter.write_line(
            f"To run them: apt-get install {missing} (or your system's packages), "
            "then pytest -m programs"
        )


def pytest_unconfigure(config: pytest.Config) -> None:
    shutil.rmtree(config.stash[_private], ignore_errors=True)


@pytest.fixture
def as_always(request: pytest.FixtureRequest) -> Callable[[str, str, Any], None]:
    """A function that compares a value with the one of a name in a file of tests/data.

    With the option `--renew` it writes the value down.
    """

    def compared(file: str, name: str, value: Any) -> None:
        path = Path(__file__).parent / "data" / file
        known = json.loads(path.read_text("utf-8"))
        if request.config.option.renew:
            path.write_text(json.dumps(known | {name: value}, indent=2) + "\n", "utf-8")
        else:
            assert value == known.get(name)

    return compared


@pytest.fixture(scope="session")
def make_run() -> Callable[..., Run]:
    return run_of


@pytest.fixture(scope="session")
def build() -> Callable[..., Run]:
    """A function that builds a dataset, by default 3x3 with 8 labyrinths a split."""
    return build_dataset


@pytest.fixture(scope="session")
def small_dataset(build: Callable[..., Run], tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A finished 3x3 dataset with 8 labyrinths a split; copy it before you change it."""
    return build(tmp_path_factory.mktemp("small") / "labyrinth")


@pytest.fixture(scope="session")
def datasets(build: Callable[..., Run], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a dataset of three rows and four columns for each task."""
    folder = tmp_path_factory.mktemp("tasks") / "labyrinth"
    for task in Task:
        build(folder, size="3x4", task=str(task), labyrinths=5, solutions="all", random_steps=20)
    return folder
