"""Commands of the program, run as a person runs them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from quick_python import python

RUN = Path(__file__).parents[2] / "run.py"


def run(folder: Path, *arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run the command in a folder; `data` in it is the `data_dir` that the tests use."""
    program = sys.executable if "preexec_fn" in options else python()
    return subprocess.run(
        [program, "-W", "error", str(RUN), *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=False,
        timeout=120,
        **options,
    )


def error_of(result: subprocess.CompletedProcess[str]) -> str:
    """Return the one line that a mistake is answered with."""
    assert result.returncode == 1
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("error: ")
    return lines[0]


def spaced(text: str) -> str:
    return " ".join(text.split())
