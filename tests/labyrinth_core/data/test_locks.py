"""Locks: one holder at a time, none that is dead, and nothing left behind."""

import errno
import signal
import subprocess
import sys

import pytest

from labyrinth_core.storage import LocalFile

fcntl = pytest.importorskip("fcntl", reason="Windows locks files in another way")

COUNT = """
import sys
from pathlib import Path
from labyrinth_core.storage import LocalFile
folder = Path(sys.argv[1])
for _ in range(40):
    with LocalFile(folder / "lock").locked():
        number = int((folder / "count").read_text())
        (folder / "count").write_text(str(number + 1))
"""

DIE = """
import os, signal, sys
from pathlib import Path
from labyrinth_core.storage import LocalFile
with LocalFile(Path(sys.argv[1]) / "lock").locked():
    os.kill(os.getpid(), signal.SIGKILL)
"""


def start(program, folder):
    return subprocess.Popen([sys.executable, "-W", "error", "-c", program, str(folder)])


@pytest.mark.slow
def test_of_eight_processes_one_at_a_time_has_the_lock_and_none_leaves_a_file(tmp_path):
    (tmp_path / "count").write_text("0")
    processes = [start(COUNT, tmp_path) for _ in range(8)]
    assert [process.wait(timeout=120) for process in processes] == [0] * 8
    assert (tmp_path / "count").read_text() == str(8 * 40)
    assert [path.name for path in tmp_path.iterdir()] == ["count"]


def test_no_process_waits_for_a_killed_one(tmp_path):
    assert start(DIE, tmp_path).wait(timeout=60) == -signal.SIGKILL
    assert [path.name for path in tmp_path.iterdir()] == ["lock"]
    with LocalFile(tmp_path / "lock").locked(wait=False):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_file_system_without_locks_is_an_os_error(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOSYS, "Function not implemented")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with (
        pytest.raises(OSError, match="Function not implemented"),
        LocalFile(tmp_path / "lock").locked(),
    ):
        pass
