"""The options of the stages `analyse` and `environments`."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.config.errors import check, listed
from pipeline.config.option import LOCAL_FOLDER, check_options, option

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


@dataclass(frozen=True)
class LeakageOptions:
    """A dataset from elsewhere, to be analysed instead of the dataset of the run."""

    source: str | None = option(
        None,
        "dataset from elsewhere to analyse: a file or a folder of .labyrinth, .npy or .npz files "
        "by split, or any folder or id on the Hub with the column info",
    )
    config: str | None = option(None, "config of that dataset, if it has several")


@dataclass(frozen=True)
class AnalysisOptions:
    """The environments that are compared, and on how many episodes."""

    seeds: int = option(
        1000,
        "episodes of each environment; the original has 100000",
        at_least=4,
        at_most=1_000_000_000,
    )
    environments: tuple[str, ...] = option(
        ENVIRONMENTS,
        "environments to compare: " + ", ".join(ENVIRONMENTS),
        one_of=ENVIRONMENTS,
    )
    experts: tuple[str, ...] = option(
        (), "Stable-Baselines3 archives to take as experts, [Hopper-v5:path or Hub id]"
    )
    folder: str = option(
        "results/environments",
        "where the stage environments leaves its tables and pictures",
        like=LOCAL_FOLDER,
    )

    @property
    def archives(self) -> dict[str, str]:
        """The Stable-Baselines3 archive that is taken instead of our expert, by environment."""
        return dict(expert.partition(":")[::2] for expert in self.experts)


def check_analysis(options: AnalysisOptions) -> None:
    """Raise a ConfigError if an option is impossible."""
    check_options(options, AnalysisOptions, "analysis.")
    check(
        all(name in ENVIRONMENTS[1:] and archive for name, archive in options.archives.items()),
        f"analysis.experts={listed(options.experts)}: give environment:archive, "
        f"the environment one of {listed(ENVIRONMENTS[1:])}",
    )
