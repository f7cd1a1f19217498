"""The stages `build` and `validate`, and their options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.config import Job, ResultFolderOptions, Stage, WorkOptions, check, option

DESCRIBE = "stages=validate,analyse,card", "check every row and describe the dataset"
"""What to do after a build, and why."""


@dataclass(frozen=True)
class BuildOptions(WorkOptions, ResultFolderOptions):
    """How much of a dataset is built, on what, and where files may refer to it."""

    grow: bool = option(
        False, "extend a finished dataset to more labyrinths or shifts, in place of the old one"
    )
    part: str = option(
        "",
        "part of a build to make, such as 3/64, while other processes make other parts in the "
        "same data_dir; a last run without part joins them",
        like=(r"(0*([1-9]\d*)/0*([1-9]\d*))?", "the part and the number of parts, such as 3/64"),
    )

    @property
    def numbers(self) -> tuple[int, int] | None:
        """The part that this process builds and the number of parts, such as (3, 64), if given."""
        part, _, parts = self.part.partition("/")
        return (int(part), int(parts)) if part else None


def _check(job: Job[BuildOptions], stages: Sequence[str]) -> None:  # noqa: ARG001
    if job.options.numbers is not None:
        part, parts = job.options.numbers
        allowed = f"give a part from 1 to {parts}, such as 1/{parts}"
        check(part <= parts, f"part={job.options.part}: {allowed}")


def _next_step(job: Job[BuildOptions], stages: Sequence[str]) -> tuple[str, ...]:  # noqa: ARG001
    return () if job.options.part else DESCRIBE


STAGES = {
    "build": Stage(
        "pipeline.generation.build",
        BuildOptions,
        _check,
        headings={"Building, by stages=build": BuildOptions},
        next_step=_next_step,
        # The other stages need the whole dataset, which the last run, without part, assembles.
        runs_alone=lambda options: bool(options.part),
        is_default=True,
    ),
    "validate": Stage("pipeline.generation.check", WorkOptions, is_default=True),
}
