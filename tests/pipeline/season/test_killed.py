"""Stages of a season that are killed: the same command goes on, and nothing secret is left."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from seasons import Performer
from support.crashing import killed_before
from support.graphs import endless

from labyrinth_core.storage import LocalFile
from pipeline.machinery import Sums

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="forks, and reads /proc"),
]


def files_in(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def checked(folder):
    """Check a folder's list with the program of the system."""
    return subprocess.run(
        ["sha256sum", "--check", "--quiet", Sums.FILE], cwd=folder, check=True, capture_output=True
    )


def kill_each_change(tmp_path, make_run, before, stage, right, every=1):
    """Kill a stage before each of its changes of files, and perform it again.

    Args:
        tmp_path: An empty folder.
        make_run: The fixture.
        before: The folder of seasons to begin with; None for none.
        stage: The stage.
        right: Checks what is there after the second time, given a `Performer`.
        every: The step between two changes, for a stage that takes long.

    Returns:
        The number of changes.
    """
    change = 0
    while True:
        perform = Performer(tmp_path / str(change), make_run)
        if before is not None:
            shutil.copytree(before, perform.folder / "seasons")
        perform.folder.mkdir(exist_ok=True)
        was_killed = killed_before(change, perform.folder / "seasons", lambda p=perform: p(stage))
        right(perform, perform(stage))
        assert files_in(perform.folder / "temporary") == [], change
        shutil.rmtree(perform.folder)
        if not was_killed:
            return change
        change += every


def test_a_season_goes_on_after_a_kill_before_any_change(tmp_path, make_run):
    def right(perform, said):
        assert "publish this folder now" in said, said
        place = perform.place
        secret = bytes.fromhex(place.secret.read_text(encoding="ascii"))
        committed = json.loads(place.season.read_text(encoding="utf-8"))["secret_sha256"]
        assert hashlib.sha256(secret).hexdigest() == committed
        names = ["2026-a.secret", f"2026-a/{Sums.FILE}", "2026-a/season.json"]
        assert files_in(perform.folder / "seasons") == sorted(names)
        checked(place.public)

    assert kill_each_change(tmp_path, make_run, None, "season", right) >= 12


def test_a_judge_goes_on_after_a_kill_before_any_change(tmp_path, make_run):
    made = Performer(tmp_path / "made", make_run)
    made.folder.mkdir()
    made("season")

    def right(perform, said):
        assert re.search(r"is judged( again, with the same bytes)?: SPL", said), said
        place = perform.place
        names = [f"2026-a.private/{n}" for n in ("1.json", "1/config.json", "1/model.safetensors")]
        names += [f"2026-a.private/{Sums.FILE}", "2026-a.secret"]
        names += [f"2026-a/{name}" for name in (Sums.FILE, "judged.json", "season.json")]
        assert files_in(perform.folder / "seasons") == sorted(names)
        checked(place.public)
        checked(place.private)

    assert (
        kill_each_change(tmp_path, make_run, made.folder / "seasons", "judge", right, every=4) >= 12
    )


def test_a_reveal_goes_on_after_a_kill_before_any_change(hidden, tmp_path, make_run):
    def right(perform, said):
        assert "is revealed: publish it" in said, said
        names = [Sums.FILE, "judged.json", "results/1.json", "season.json", "secret.txt"]
        names += ["submissions/1/config.json", "submissions/1/model.safetensors"]
        assert files_in(perform.place.public) == sorted(names)
        checked(perform.place.public)

    assert kill_each_change(tmp_path, make_run, hidden.place.public.parent, "reveal", right) >= 12


JUDGE = """
import sys

sys.path[:0] = sys.argv[3:]
from support.making import run_of
from pathlib import Path
from seasons import Performer

Performer(Path(sys.argv[1]), run_of)("judge", submission=sys.argv[2])
"""


def processes_with(word):
    """Return the ids of processes whose command line has a word."""
    found = []
    for each in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if word in each.read_bytes().decode(errors="replace"):
                found.append(int(each.parent.name))
        except OSError:
            pass  # It has ended.
    return found


def waited_for(condition):
    until = time.monotonic() + 120
    while not condition() and time.monotonic() < until:
        time.sleep(0.02)
    return condition()


def test_a_killed_judge_leaves_no_graph_that_computes_and_the_next_removes_its_copies(
    hidden, tmp_path, make_run
):
    perform = Performer(tmp_path, make_run)
    shutil.copytree(hidden.place.public.parent, perform.place.public.parent)
    (tmp_path / "evil.onnx").write_bytes(endless())
    tests = Path(__file__).parents[2]
    paths = [str(tests.parent), str(tests), str(Path(__file__).parent)]
    judge = subprocess.Popen(
        [sys.executable, "-c", JUDGE, str(tmp_path), str(tmp_path / "evil.onnx"), *paths]
    )
    try:
        graph_of_it = f"graph_process.py\0{judge.pid}"
        temporary = tmp_path / "temporary"
        assert waited_for(
            lambda: (
                len(processes_with(graph_of_it)) == 1
                and [*temporary.glob("labyrinth-season-*/3x3")]
            )
        )
        assert waited_for(lambda: busy(processes_with(graph_of_it)[0]))
    finally:
        judge.send_signal(signal.SIGKILL)
        judge.wait()
    assert waited_for(lambda: not processes_with(graph_of_it))
    theirs = tmp_path / "theirs"
    (theirs / "kept").mkdir(parents=True)
    (temporary / "labyrinth-season-link").symlink_to(theirs)
    (temporary / ".labyrinth-season-early.lock").touch()  # Killed before it made its folder.
    assert len([*temporary.glob("labyrinth-season-*")]) == 3
    with private_folder_in(temporary) as alive:
        perform("judge")
        assert alive.is_dir()
    assert [path.name for path in temporary.iterdir()] == ["labyrinth-season-link"]
    assert (theirs / "kept").is_dir()


@contextmanager
def private_folder_in(folder):
    """Hold a temporary folder of a process that is alive."""
    own = folder / "labyrinth-season-alive"
    with LocalFile(folder / f".{own.name}.lock").locked():
        own.mkdir()
        yield own
        own.rmdir()


def busy(process):
    """Return whether a process has computed for more than three seconds."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(") ")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK") > 3
