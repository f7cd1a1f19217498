"""The options of the stages `analyse` and `environments`: schema, checks, frozen objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.config.errors import check, check_choices, listed

LABYRINTH = "Labyrinth"
ENVIRONMENTS = (
    LABYRINTH,
    "MountainCar-v0",
    "CartPole-v1",
    "Hopper-v5",
    "Walker2d-v5",
    "HalfCheetah-v5",
)
"""What the stage `environments` compares: labyrinths, and environments of Gymnasium."""


@dataclass
class LeakageConfig:
    """A dataset from elsewhere, for the stage `analyse`."""

    source: str | None = None
    config: str | None = None


@dataclass
class AnalysisConfig:
    """The schema of `analysis`."""

    seeds: int = 1000
    environments: list[str] = field(default_factory=lambda: list(ENVIRONMENTS))
    experts: list[str] = field(default_factory=list)
    folder: str = "results/environments"


ANALYSIS_OPTIONS = {
    "leakage.source": "dataset from elsewhere to analyse: a folder of .labyrinth files by split, "
    "or any folder or id on the Hub with the five columns",
    "leakage.config": "config of that dataset, if it has several",
    "analysis.seeds": "episodes of each environment; the original has 100000",
    "analysis.environments": "which: " + ", ".join(ENVIRONMENTS),
    "analysis.experts": "Stable-Baselines3 archives to take as experts, [Hopper-v5:path or Hub id]",
    "analysis.folder": "where the stage environments leaves its tables and pictures",
}
"""What each option means, as `python run.py --help` and the README say it."""


@dataclass(frozen=True)
class LeakageOptions:
    """Which dataset from elsewhere to analyse, None for that of the run."""

    source: str | None
    config: str | None


@dataclass(frozen=True)
class AnalysisOptions:
    """Which environments to compare, on how many episodes, checked."""

    seeds: int
    environments: tuple[str, ...]
    experts: Mapping[str, str]
    """Environment -> Stable-Baselines3 archive to take instead of our expert."""
    folder: Path


def resolve_analysis(config: AnalysisConfig) -> AnalysisOptions:
    """Return the options of the stage `environments`.

    Raises:
        ConfigError: One is impossible.
    """
    check(4 <= config.seeds <= 10**9, f"analysis.seeds={config.seeds}: give 4 to 1,000,000,000")
    check_choices("analysis.environments", config.environments, ENVIRONMENTS)
    experts = dict(expert.partition(":")[::2] for expert in config.experts)
    check(
        all(name in ENVIRONMENTS[1:] and archive for name, archive in experts.items()),
        f"analysis.experts={listed(config.experts)}: give environment:archive, "
        f"the environment one of {listed(ENVIRONMENTS[1:])}",
    )
    check(config.folder.strip() != "", "analysis.folder is empty: give a folder")
    return AnalysisOptions(
        seeds=config.seeds,
        environments=tuple(dict.fromkeys(config.environments)),
        experts=experts,
        folder=Path(config.folder).expanduser(),
    )
