"""The report of a folder of datasets as a static Space: its page and a card.

The card follows https://huggingface.co/docs/hub/spaces-config-reference.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.storage import write_text
from pipeline.config.run import Run
from pipeline.machinery.own_files import OwnFiles
from pipeline.release.provenance import code
from pipeline.release.texts import fill

FOLDER, PAGE = "report", "index.html"
"""Where the stage `report` leaves its page, in the data_dir."""


def stage_report(run: Run, folder: Path) -> None:
    """Write the files of the Space of a run's report into a folder.

    Raises:
        DatasetError: There is no report, or it is not as the stage `report` left it.
    """
    source = run.local_dir / FOLDER
    if not (source / PAGE).is_file():
        raise DatasetError(f"{source} holds no report: run stages=report first")
    own = OwnFiles.read(source, always=re.escape(PAGE))
    if not own.has(PAGE):
        raise DatasetError(
            f"{source / PAGE} is not as stages=report left it: move it away, and run that again"
        )
    dataset, _ = run.dataset_on_hub
    shutil.copyfile(source / PAGE, folder / PAGE)
    write_text(folder / "README.md", fill("space.md", dataset=dataset, code=code()))
