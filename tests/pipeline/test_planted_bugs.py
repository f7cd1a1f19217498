"""A bug in an inner function of a stage gives a traceback, and does not pass for a user's error."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path

import pytest
from support.making import Run, composed, perform
from support.policies import RELEASED

from pipeline.command.stages import STAGES

pytestmark = pytest.mark.slow

DATASET = ("size=3", "labyrinths=16", "random_steps=5")
TRAINING = ("method=bc", "method.epochs=1", "encoder=mlp", "observation=vector")
SEASON = ("season.name=a", "season.date=2030-01-01", *DATASET)

PLANTS = {
    "build": [
        (("data_dir=other",), "pipeline.generation.shard:render"),
        ((), "labyrinth_core.data.manifest:TableFile.from_json"),
    ],
    "validate": [
        ((), "labyrinth_core.data.manifest:Shard.from_json"),
        ((), "pipeline.generation.check_rows:_remade"),
        *[((), "pipeline.questions.companion:routes_of")] * ("questions" in STAGES),
    ],
    "analyse": [((), "pipeline.inspection.statistics:Solver")],
    "questions": [(("overwrite=true",), "pipeline.questions.companion:question")],
    "card": [((), "pipeline.inspection.analyse:_pair")],
    "report": [
        ((), "pipeline.inspection.analyse:_pair"),
        ((), "pipeline.inspection.statistics:Solver"),
    ],
    "publish": [
        (
            ("publish.repo_id=user/labyrinth", "publish.version=1.0.0", "publish.dry_run=true"),
            "pipeline.release.publish:prepared_card",
        )
    ],
    "export": [(("export=imitation",), "pipeline.export.stage:File")],
    "train": [
        ((*TRAINING, "overwrite=true"), "pipeline.training.loop:_select"),
        (TRAINING, "labyrinth_core.typed:read_as"),
    ],
    "evaluate": [
        ((f"policy={RELEASED}",), "labyrinth_core.learning.spec:_read"),
        ((f"policy={RELEASED}",), "labyrinth_core.evaluation.evaluate:Evaluation.results"),
        ((*TRAINING, "overwrite=true"), "pipeline.training.record:require_same"),
    ],
    "results": [((), "labyrinth_core.typed:read_as")],
    "certify": [
        (("certify.source=data",), "pipeline.certify.stage:parse"),
        (
            (
                "certify.source=gymnasium:CartPole-v1",
                "certify.train=0:4",
                "certify.test=4:8",
            ),
            "labyrinth_core.benchmarks.encoding:Tape.play",
        ),
    ],
    "season": [((*SEASON, "season.name=b"), "pipeline.season.season:check_rows")],
    "judge": [((*SEASON, f"season.submission={RELEASED}"), "pipeline.season.season:check_rows")],
    "reveal": [(SEASON, "pipeline.season.season:check_rows")],
    "verify": [(SEASON, "pipeline.season.season:check_rows")],
}
"""Stage -> options, and a function that it calls."""

READERS = (
    "from_json",
    "read_as",
    "parse",
    "question",
    "_read",
    "check_rows",
    "_check",
)
"""Functions whose ValueError says what is wrong with a user's file."""


class PlantedError(KeyError, TypeError):
    """A bug of both kinds, so that one run of a stage shows that neither is caught."""


class PlantedInWorkError(PlantedError, ValueError):
    """Likewise, in a function that does not read what a user gave."""


def run_of(stage: str, *options: str) -> Run:
    """Return the job of a stage in the working directory."""
    return composed(*(DATASET if stage != "certify" else ()), *options, f"stages=[{stage}]")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the stages read: a dataset, a run with results, a season."""
    folder = tmp_path_factory.mktemp("made")
    with chdir(folder):
        perform("build", run_of("build"))
        for stage, options in (
            ("analyse", ()),
            ("questions", ()),
            ("train", TRAINING),
            ("evaluate", TRAINING),
            ("season", SEASON),
        ):
            if stage in STAGES:
                perform(stage, run_of(stage, *options))
    return folder


@pytest.fixture
def in_copy(made: Path, tmp_path: Path) -> Iterator[None]:
    """Make a copy of it the working directory."""
    with chdir(shutil.copytree(made, tmp_path / "copy")):
        yield


@pytest.mark.usefixtures("in_copy")
@pytest.mark.parametrize(
    ("stage", "options", "place"),
    [
        pytest.param(stage, options, place, id=f"{stage} {place}")
        for stage in STAGES
        for options, place in PLANTS[stage]
    ],
)
def test_a_bug_that_is_planted_in_a_stage_comes_out_as_it_is(
    monkeypatch: pytest.MonkeyPatch,
    stage: str,
    options: tuple[str, ...],
    place: str,
) -> None:
    planted = (PlantedError if place.endswith(READERS) else PlantedInWorkError)("planted")

    def bug(*_: object, **__: object) -> None:
        raise planted

    module, _, name = place.partition(":")
    monkeypatch.setattr(f"{module}.{name}", bug)
    with pytest.raises(PlantedError) as raised:
        perform(stage, run_of(stage, *options))
    assert raised.value is planted
