"""The stages `season`, `judge`, `reveal` and `verify`, and their options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from labyrinth_core import typed
from pipeline.config import Job, Stage, WorkOptions, check, option

_PART = r"(?!\.{1,2}(?:[/@]|\Z))[A-Za-z0-9._+=-]+"
SUBMISSION = rf"(?!.*\.zip$)(?:[A-Za-z]:|~)?/?{_PART}(?:/{_PART})*(?:@{_PART}(?:/{_PART})*)?"
"""The names of submissions, without `.` and `..` and in ASCII, so that no two names look alike."""


@dataclass(frozen=True)
class SeasonOptions:
    """Which season is made, judged on, revealed or verified."""

    name: str = option(
        "",
        "name of a season, such as 2026-a",
        like=(r"[a-z0-9][a-z0-9-]{0,50}", "small letters, digits and hyphens, such as 2026-a"),
    )
    folder: str = option("seasons", "folder of the seasons", is_local_folder=True)
    date: str = option(
        "",
        "day on which the season begins, such as 2026-11-30; not filled in automatically",
        like=(r"(\d{4}-\d\d-\d\d)?", "a day such as 2026-11-30"),
    )
    submission: str = option(
        "",
        "policy to judge: user/model@revision on the Hub, the folder of a run or of a policy, or "
        "an ONNX graph; after a folder or a file, @ and the SHA-256 of its weights pin them",
        like=(
            rf"({SUBMISSION})?",
            "an id on the Hub such as user/model@1.0.0, a folder, or a file such as model.onnx, "
            "spelt with A to Z, a to z, 0 to 9 and ._+=- between single slashes, without . and ..",
        ),
    )
    learnt_from: str = option(
        "",
        "dataset that the submission has learnt from, such as data/labyrinth/5x5, or "
        "user/labyrinth/5x5 on the Hub: the judge asks whether it remembers its train",
        is_dataset=True,
    )


@dataclass(frozen=True)
class SeasonStageOptions(WorkOptions):
    """Which season is meant, and how its dataset is built."""

    season: SeasonOptions = field(default_factory=SeasonOptions)


def _check(job: Job[SeasonStageOptions], stages: Sequence[str]) -> None:
    options = job.options.season
    check(
        "season" not in stages or typed.is_day(options.date),
        f"season.date={options.date}: give the day on which the season begins, such as 2026-11-30",
    )
    check(
        "judge" not in stages or bool(options.submission),
        "season.submission=: give the policy to judge, such as user/model@1.0.0",
    )
    seed, executor = job.dataset.seed, job.options.executor
    check(seed == 0, f"seed={seed}: a season makes its seed from its secret: give no seed")
    check(
        executor == "local",
        f"executor={executor}: a season stays on one machine, so give executor=local",
    )


STAGES = {
    name: Stage(
        f"pipeline.season.{name}",
        SeasonStageOptions,
        _check,
        headings={"Seasons, by stages=season, judge, reveal and verify": SeasonStageOptions},
    )
    for name in ("season", "judge", "reveal", "verify")
}
