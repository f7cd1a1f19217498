"""Commands of the program, run as a person runs them."""

from __future__ import annotations

import io
import logging
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import pytest

from pipeline.command.launch import run_command
from support.quick_python import python

RUN = Path(__file__).parents[2] / "run.py"


def run(folder: Path, *arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run the command in a folder; `data` in it is the `data_dir` that the tests use."""
    program = sys.executable if "preexec_fn" in options else python()
    return ended([program, "-W", "error", str(RUN), *arguments], cwd=folder, **options)


def ended(command: list[str], **options: Any) -> subprocess.CompletedProcess[str]:
    """Return what became of any process, with all that it printed."""
    kept = {"capture_output": True, "text": True, "encoding": "utf-8", "timeout": 300}
    return subprocess.run(command, check=False, **kept | options)


def answered(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Return what the command prints and how it ends, run in this process, which is quicker."""
    output, errors = io.StringIO(), io.StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        redirect_stdout(output),
        redirect_stderr(errors),
    ):
        patch.setattr(sys, "argv", [str(RUN), *arguments])
        patch.setattr(sys, "unraisablehook", sys.unraisablehook)
        # Hydra closes the handlers of this list, and that of absl then closes pytest's output.
        patch.setattr(logging, "_handlerList", [])
        for name in ("PYTHONWARNINGS", "HYDRA_FULL_ERROR"):  # Which the command sets.
            patch.setenv(name, "")
        try:
            status = run_command()
        except SystemExit as ended:
            status = int(str(ended.code))
    return subprocess.CompletedProcess(arguments, status, output.getvalue(), errors.getvalue())


def refused(*arguments: str) -> str:
    """Return the one line that a mistake is answered with, of the command run in this process."""
    return error_of(answered(*arguments))


def error_of(result: subprocess.CompletedProcess[str]) -> str:
    """Return the one line that a mistake is answered with."""
    assert result.returncode == 1
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("error: ")
    return lines[0]


def spaced(text: str) -> str:
    return " ".join(text.split())
