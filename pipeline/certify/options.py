"""The stage `certify`, and its options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from pipeline.config import Job, Stage, WorkOptions, check, option


@dataclass(frozen=True)
class CertifyOptions:
    """Data from elsewhere, whose splits are compared."""

    source: str | None = option(
        None,
        "data to compare the splits of: a .labyrinth or .npy file, a folder of such files by "
        "split, a dataset with the column info, in a folder or on the Hub, gymnasium:ID, "
        "minari:ID, or a .jsonl or .parquet file of records",
    )
    config: str | None = option(None, "config of a dataset, if it has several")
    train: str | None = option(
        None, "seeds of train of an environment, such as 0:1000; for Minari, train's share"
    )
    test: str | None = option(
        None, "seeds of test, such as 1000000:1001000; for Minari, another dataset as minari:ID"
    )
    probes: int = option(
        4, "random action sequences that tell seeds apart", at_least=0, at_most=1_000
    )
    steps: int = option(64, "steps of each of these", at_least=1, at_most=1_000_000)

    @property
    def is_benchmark(self) -> bool:
        """Whether the source is an environment, a Minari dataset or a file of records."""
        source = self.source or ""
        return source.startswith(("gymnasium:", "minari:")) or source.endswith(
            (".jsonl", ".parquet")
        )


@dataclass(frozen=True)
class CertifyStageOptions(WorkOptions):
    """What is certified, and with how many processes."""

    certify: CertifyOptions = field(default_factory=CertifyOptions)


def _check(job: Job[CertifyStageOptions], stages: Sequence[str]) -> None:  # noqa: ARG001
    options = job.options.certify
    check(
        bool(options.source),
        "certify.source=: give what to certify, such as gymnasium:MiniGrid-DoorKey-8x8-v0",
    )
    seeds = options.train is not None or options.test is not None
    check(
        options.is_benchmark or not seeds,
        f"certify.source={options.source}: labyrinths have splits: give neither certify.train nor "
        "certify.test",
    )
    check(
        not options.is_benchmark or options.config is None,
        f"certify.config={options.config}: only a dataset of labyrinths has configs",
    )
    if str(options.source).startswith("gymnasium:"):
        given = {"train": options.train, "test": options.test}
        for name, value in given.items():
            check(value is not None, f"certify.{name}=: give its seeds, such as 0:1000")


STAGES = {
    "certify": Stage(
        "pipeline.certify.stage",
        CertifyStageOptions,
        _check,
        headings={"Data from elsewhere, by stages=certify": CertifyStageOptions},
    )
}
