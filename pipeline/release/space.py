"""The report of a folder of datasets as a static Space: its page and a card."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from labyrinth_core.data.errors import DatasetError
from pipeline.config.run import Run
from pipeline.machinery import front_matter
from pipeline.machinery.own_files import OwnFiles
from pipeline.release.provenance import code

FOLDER, PAGE = "report", "index.html"
"""Where the stage `report` leaves its page, in the data_dir."""


@contextmanager
def staged_report(run: Run) -> Iterator[Path]:
    """Yield a folder with all that the Space of the report of a run is to hold.

    Raises:
        DatasetError: There is no report, or somebody else made or changed it.
    """
    source = run.local_dir / FOLDER
    if not (source / PAGE).is_file():
        raise DatasetError(f"{source} holds no report: run stages=[report] first")
    own = OwnFiles.read(source, always=re.escape(PAGE))
    if not own.has(PAGE):
        raise DatasetError(
            f"{source / PAGE} is not as stages=[report] left it: move it away, and run that again"
        )
    dataset, _ = run.dataset_on_hub
    with tempfile.TemporaryDirectory(prefix="labyrinth-space-") as temporary:
        folder = Path(temporary)
        shutil.copyfile(source / PAGE, folder / PAGE)
        (folder / "README.md").write_text(_card(dataset), encoding="utf-8")
        yield folder


def _card(dataset: str) -> str:
    """Return the README.md (https://huggingface.co/docs/hub/spaces-config-reference)."""
    values = {
        "title": "Labyrinth report",
        "emoji": "🧭",
        "colorFrom": "gray",
        "colorTo": "green",
        "sdk": "static",
        "app_file": PAGE,
        "pinned": False,
        "license": front_matter.LICENCE,
        "short_description": "Labyrinths, episodes and statistics to look at",
        "datasets": [dataset],
    }
    text = f"""
# Labyrinth report

Labyrinths, their episodes and what is counted in them, of the dataset
[{dataset}](https://huggingface.co/datasets/{dataset}). It is one page that asks the network for
nothing. This card was written by {code()}.
"""
    return front_matter.with_values(values, text)
