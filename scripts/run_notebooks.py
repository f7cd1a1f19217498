"""Run the notebooks of examples/ twice, each in a clean kernel and a folder that starts empty.

    python scripts/run_notebooks.py          # fails if a cell fails, or its text has changed
    python scripts/run_notebooks.py --write  # saves the outputs in the notebooks

Numbers are not compared: times differ between runs, and training differs between machines.

Needs the extra `docs`. The kernel uses the Python that runs this script; `labyrinth-datasets` is
run by that of tests/support/quick_python.py, which need not import the libraries each time.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import tempfile
import time
from collections.abc import Iterator
from copy import deepcopy
from functools import partial
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from run_documentation import python, run_all
from traitlets.config import Config

EXAMPLES = Path(__file__).parents[1] / "examples"
SECONDS = 300
"""The time limit of a cell."""


def run(path: Path, write: bool) -> tuple[str, bool]:
    """Run a notebook twice; return a line to print, and whether all cells work.

    Args:
        path: The notebook.
        write: Whether to save the outputs in the notebook.
    """
    started = time.monotonic()
    notebook = nbformat.read(path, 4)
    kept, again = deepcopy(notebook), deepcopy(notebook)
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as sockets:
        # Kernels that start at the same time can choose the same TCP port; then one dies or hangs.
        transport = {"transport": "ipc", "ip": f"{sockets}/kernel"}
        for each in (notebook, again):
            client = NotebookClient(
                each,
                timeout=SECONDS,
                record_timing=False,
                resources={"metadata": {"path": folder}},
                config=Config({"KernelManager": transport}),
            )
            try:
                client.execute()
            except CellExecutionError as error:
                return f"{path.name}: FAILED:\n{error}", False
    drop_overwritten(notebook)
    if write:
        nbformat.write(notebook, path)
    elif stale := [*map(str, changed(kept, notebook))]:
        return f"{path.name}: the text of cells {', '.join(stale)} has changed: use --write", False
    return f"{path.name}: ran in {time.monotonic() - started:.0f} s", True


def drop_overwritten(notebook: Any) -> None:
    """Remove output that a terminal would overwrite, such as progress bars, from a notebook."""
    for cell in notebook.cells:
        joined: list[Any] = []
        for each in cell.get("outputs", ()):
            is_text = each.output_type == "stream"
            if is_text and joined and joined[-1].get("name") == each.name:
                joined[-1].text += each.text  # The output of a program arrives in pieces.
            else:
                joined.append(each)
        for each in joined:
            if each.output_type == "stream":
                each.text = re.sub(r"[^\n]*\r(?!\n)", "", each.text).replace("\r\n", "\n")
        if joined:
            cell.outputs = [each for each in joined if each.get("text") != ""]


def changed(kept: Any, now: Any) -> Iterator[int]:
    """Yield the number of each cell whose output differs from the saved one, except in numbers."""
    for number, cells in enumerate(zip(kept.cells, now.cells, strict=True)):
        before, after = (
            "".join(str(each.get("text", "")) for each in cell.get("outputs", ())) for cell in cells
        )
        if re.sub(r"[\d\s.,:%-]+", " ", before) != re.sub(r"[\d\s.,:%-]+", " ", after):
            yield number


def main() -> int:
    """Run all notebooks; return the exit status, which is 1 if one of them fails."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="save the outputs in the notebooks")
    options = parser.parse_args()
    os.environ |= {"COLUMNS": "100", "PYTHONWARNINGS": "ignore", "OMP_NUM_THREADS": "1"}
    # `datasets` draws bars only for data that is not in its cache yet.
    os.environ["HF_DATASETS_DISABLE_PROGRESS_BARS"] = "1"
    own = Path(python()).with_name("labyrinth-datasets")
    own.write_text(f'#!/bin/sh\nexec {python()} -W ignore -m pipeline "$@"\n', encoding="utf-8")
    own.chmod(0o755)
    paths = sorted(EXAMPLES.glob("*.ipynb"), reverse=True)  # The longest one first.
    return run_all(partial(run, write=options.write), paths)


if __name__ == "__main__":
    sys.exit(main())
