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
from copy import deepcopy
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

EXAMPLES = Path(__file__).parents[1] / "examples"
SECONDS = 300
"""How long a cell may take."""


def run(path: Path, write: bool) -> None:
    """Run a notebook, and if it is asked for keep the outputs in its file.

    Raises:
        CellExecutionError: A cell fails.
    """
    notebook = nbformat.read(path, 4)
    again = deepcopy(notebook)
    with tempfile.TemporaryDirectory() as folder:
        for each in (notebook, again):
            resources = {"metadata": {"path": folder}}
            NotebookClient(
                each, timeout=SECONDS, record_timing=False, resources=resources
            ).execute()
    if write:
        nbformat.write(notebook, path)


def main() -> int:
    """Return the exit status: 1 where a cell fails, which is shown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="keep the outputs in the notebooks")
    options = parser.parse_args()
    # Programs that cells start are those of this environment.
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    os.environ |= {"COLUMNS": "100", "PYTHONWARNINGS": "ignore"}
    for path in sorted(EXAMPLES.glob("*.ipynb")):
        started = time.monotonic()
        try:
            run(path, options.write)
        except CellExecutionError as error:
            print(f"{path.name}: {error}", file=sys.stderr)
            return 1
        print(f"{path.name}: ran in {time.monotonic() - started:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
