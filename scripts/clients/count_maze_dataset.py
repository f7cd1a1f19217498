"""maze-dataset: check that the recipe counts the test mazes in train as docs/analysis.md does."""

from __future__ import annotations

import io
import runpy
import sys
from contextlib import redirect_stdout
from pathlib import Path

from comparing import report

RECIPE = Path(__file__).parents[2] / "examples" / "maze_dataset_leak.py"

with redirect_stdout(io.StringIO()) as printed:
    runpy.run_path(str(RECIPE), run_name="__main__")
found = printed.getvalue().splitlines()
if found != ["3x3: 194 of 194", "4x4: 62 of 200", "5x5: 0 of 200"]:
    sys.exit(f"another number of test mazes is in train: {found}")
report(["maze-dataset", "numpy"], f"no data of ours; test mazes in train: {', '.join(found)}")
