"""Run the notebooks of examples/, each from a clean kernel in an empty folder, and there again.

    python scripts/run_notebooks.py          # fails where a cell fails
    python scripts/run_notebooks.py --write  # and keeps what the cells print and draw

Needs the extra `docs`. The kernel is that of this Python.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

EXAMPLES = Path(__file__).parents[1] / "examples"
SECONDS = 300
"""How long a cell may take."""


def run(path: Path, write: bool) -> tuple[str, bool]:
    """Run a notebook, and return a line about it, and whether all cells work.

    Args:
        path: The notebook.
        write: Keep what its cells print and draw in its file.
    """
    started = time.monotonic()
    notebook = nbformat.read(path, 4)
    again = deepcopy(notebook)
    with tempfile.TemporaryDirectory() as folder:
        for each in (notebook, again):
            resources = {"metadata": {"path": folder}}
            client = NotebookClient(each, timeout=SECONDS, record_timing=False, resources=resources)
            try:
                client.execute()
            except CellExecutionError as error:
                return f"{path.name}: FAILED:\n{error}", False
    if write:
        nbformat.write(notebook, path)
    return f"{path.name}: ran in {time.monotonic() - started:.0f} s", True


def main() -> int:
    """Return the exit status: 1 where a cell fails, which is shown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="keep the outputs in the notebooks")
    options = parser.parse_args()
    # Programs that cells start are those of this environment.
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    os.environ |= {"COLUMNS": "100", "PYTHONWARNINGS": "ignore", "OMP_NUM_THREADS": "1"}
    paths = sorted(EXAMPLES.glob("*.ipynb"))
    works = True
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        for line, each in pool.map(partial(run, write=options.write), paths):
            print(line, flush=True)
            works &= each
    return 0 if works else 1


if __name__ == "__main__":
    sys.exit(main())
