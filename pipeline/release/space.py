"""The report of a folder of datasets as a static Space: its page and a card.

The card follows https://huggingface.co/docs/hub/spaces-config-reference.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from labyrinth_core.data.errors import DatasetError
from pipeline.config.run import Run
from pipeline.machinery.own_files import OwnFiles, list_all
from pipeline.release.provenance import code
from pipeline.release.texts import fill

FOLDER, PAGE = "report", "index.html"
"""Where the stage `report` leaves its page, in the data_dir."""


@contextmanager
def staged_report(run: Run) -> Iterator[Path]:
    """Yield a folder with the files of the Space of a run's report.

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
    with tempfile.TemporaryDirectory(prefix="labyrinth-space-") as temporary:
        folder = Path(temporary)
        shutil.copyfile(source / PAGE, folder / PAGE)
        card = fill("space.md", dataset=dataset, code=code())
        (folder / "README.md").write_text(card, encoding="utf-8")
        list_all(folder)
        yield folder
