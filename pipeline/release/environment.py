"""The labyrinths of a dataset as a repository of LeRobot's EnvHub: `env.py` and a card.

LeRobot looks for `env.py` in a model (`lerobot.envs.utils._download_hub_file` of
https://pypi.org/project/lerobot/, 0.4.4 to 0.6.1), and runs it where its user allows that.
"""

from __future__ import annotations

from pathlib import Path

from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.storage import write_text
from labyrinth_core.evaluation.evaluate import NOT_EVALUATED
from pipeline.config.run import Run
from pipeline.release.provenance import code
from pipeline.release.texts import citation, fill

ENV = "env.py"


def stage_environment(run: Run, folder: Path, commit: str, manifest: Manifest) -> None:
    """Write all that the repository of the environment of a run is to hold.

    Args:
        run: The run, which names the dataset and its config.
        folder: Where to write it.
        commit: The commit of the dataset on the Hub.
        manifest: The manifest of that dataset.
    """
    dataset, _ = run.dataset_on_hub
    splits = [split for split in manifest.config.splits if split not in NOT_EVALUATED]
    # As literals of Python: nothing of what the Hub answers can become code.
    values = {"dataset": repr(dataset), "config": repr(run.dataset.name)}
    write_text(folder / ENV, fill("env.txt", **values, commit=repr(commit)))
    card = fill(
        "environment.md",
        name=run.options.publish.env,
        dataset=dataset,
        config=run.dataset.name,
        commit=commit,
        splits=", ".join(f"`{split}`" for split in splits),
        code=code(),
        citation=citation(),
    )
    write_text(folder / "README.md", card)
