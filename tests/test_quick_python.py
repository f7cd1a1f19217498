"""The Python that the tests start quickly is like the usual one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.quick_python import python

pytestmark = pytest.mark.slow

SHOW = """
import os, sys
print(sys.argv, sys.path[:2], os.getcwd(), os.environ["MINE"], input(), __name__)
print("wrong", file=sys.stderr)
sys.exit(3)
"""
LATE = """
import atexit, threading, time
atexit.register(print, "last")
threading.Thread(target=lambda: (time.sleep(0.3), print("late"))).start()
"""


@pytest.mark.parametrize(
    "arguments",
    [
        ["-c", SHOW, "a b"],
        ["show.py", "a b"],
        ["-m", "show", "a b"],
        ["-W", "error", "-c", "import warnings; warnings.warn('mine')"],
        ["-c", "import sys; print(open('show.py').closed); raise LookupError('mine')"],
        ["-c", "import os; os.kill(os.getpid(), 9)"],
        ["-c", "import sys; sys.exit('mine')"],
        ["-c", LATE],
    ],
    ids=["program", "file", "module", "warning", "error", "killed", "text", "late"],
)
def test_it_does_what_python_does(tmp_path: Path, arguments: list[str]) -> None:
    (tmp_path / "show.py").write_text(SHOW, encoding="utf-8")
    usual, quick = (
        subprocess.run(
            [program, *arguments],
            env=os.environ | {"MINE": "x y", "PYTHONPATH": str(tmp_path / "more")},
            cwd=tmp_path,
            input="given\n",
            capture_output=True,
            text=True,
            check=False,
        )
        for program in (sys.executable, python())
    )
    assert (quick.returncode, quick.stdout) == (usual.returncode, usual.stdout)
    assert quick.stderr.splitlines()[-1:] == usual.stderr.splitlines()[-1:]


def test_it_ends_when_it_is_killed_with_what_it_has_started() -> None:
    program = """
import subprocess, sys
subprocess.run([sys.executable, "-c", "import time; print(1, flush=True); time.sleep(600)"])
"""
    with subprocess.Popen([python(), "-c", program], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "1\n"
        process.kill()
        assert process.stdout.read() == ""  # Only now that no process holds it any more.
