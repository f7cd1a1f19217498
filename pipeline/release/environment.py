"""The labyrinths of a dataset as a repository of LeRobot's EnvHub: `env.py` and a card.

LeRobot looks for `env.py` in a model (`lerobot.envs.utils._download_hub_file` of
https://pypi.org/project/lerobot/, 0.4.4 to 0.6.1), and runs it where its user allows that.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.storage import write_text
from labyrinth_core.evaluation.evaluate import NOT_EVALUATED
from pipeline.config.run import Run
from pipeline.machinery.own_files import list_all
from pipeline.release.provenance import code
from pipeline.release.texts import citation, fill

ENV = "env.py"


@contextmanager
def staged_environment(run: Run, commit: str, manifest: Manifest) -> Iterator[Path]:
    """Yield a folder with all that the repository of the environment of a run is to hold.

    Args:
        run: The run, which names the dataset and its config.
        commit: The commit of the dataset on the Hub.
        manifest: The manifest of that dataset.
    """
    dataset, _ = run.dataset_on_hub
    splits = [split for split in manifest.config.splits if split not in NOT_EVALUATED]
    with tempfile.TemporaryDirectory(prefix="labyrinth-environment-") as temporary:
        folder = Path(temporary)
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
        list_all(folder)
        yield folder
