"""Kill stages of seasons at random moments, and perform each again.

    python scripts/kill_seasons.py --kills 36

The stages `season`, `judge` and `reveal` are forked and get SIGKILL, half of the time with their
workers. Then the same stage is performed again, and must end with the files of an uninterrupted
one: the same names and a list that `sha256sum --check` confirms; after `judge` and `reveal` also
the same bytes; after `season` the secret that it commits to. The temporary folder must be empty.

The exit status is 1 if anything differs, or if a process is left behind.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import safetensors.torch  # noqa: F401  Imported before forking, so that each stage starts at once.
from kill_matrix import clear_memory, finish, hashes, started

from pipeline.command.composed import ALL, resolve
from pipeline.config.stage import Job
from pipeline.machinery.sums import HASHES
from pipeline.season.options import SeasonOptions, SeasonStageOptions
from pipeline.season.season import Layout, Season

POLICY = Path(__file__).parents[1] / "docs" / "results" / "released" / "5x5" / "planner-seed0"
NAME = "2026-a"


def run_in(folder: Path, stage: str) -> Job[SeasonStageOptions]:
    """Return the run of a stage whose seasons, log and temporary files are in a folder."""
    season = SeasonOptions(NAME, str(folder / "seasons"), "2026-11-30", str(POLICY))
    fixed = {"stages": [stage], "size": "3", "labyrinths": 16, "random_steps": 5, "workers": 1}
    return resolve(ALL(**fixed, data_dir=str(folder / "data"), season=season))[stage]


def kill_stage(stage: str, before: Path, kills: int, rng: random.Random, left: list[str]) -> bool:
    """Kill a stage and perform it again, `kills` times; return whether all ended right.

    Args:
        stage: The stage.
        before: The folder of the season before the stage.
        kills: The number of kills that came before the end of the stage.
        rng: The source of the moments.
        left: The names of processes that were left behind, which are added.
    """
    right = copy_of(before, "right")
    began = time.monotonic()
    finish(run_in(right, stage), left, stage)
    longest, names = time.monotonic() - began, hashes(right / "seasons")
    phases, wrong = Counter[str](), 0
    while phases.total() - phases["after the end, not counted"] < kills:
        killed = copy_of(before, "killed")
        run = run_in(killed, stage)
        with started(run, left, stage) as process:
            time.sleep(rng.uniform(0, longest))
            ended = os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT | os.WNOHANG)
            whole_group = rng.random() < 1 / 2
            (os.killpg if whole_group else os.kill)(process, signal.SIGKILL)
            os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT)
            clear_memory(process)
            copies = any(temporary().iterdir())
            changed = hashes(killed / "seasons") != hashes(before / "seasons")
            finish(run, left, stage)
        phase = "with a copy of the test" if copies else "before a copy of the test was made"
        if not copies and changed:
            phase = "after files of the season were written"
        phase = "after the end, not counted" if ended else phase
        phases[phase] += 1
        right_now = ends_right(stage, killed, names)
        wrong += not right_now
        print(f"{stage} killed {phase}: {'right' if right_now else 'WRONG'} in the end", flush=True)
    print(f"{kills} kills of {stage}: {wrong} wrong in the end; {dict(phases)}", flush=True)
    return not wrong


def copy_of(before: Path, name: str) -> Path:
    """Return a new copy of a folder beside it."""
    folder = before.with_name(name)
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(before, folder)
    return folder


def temporary() -> Path:
    """Return the folder of temporary files."""
    return Path(tempfile.gettempdir())


def ends_right(stage: str, folder: Path, names: dict[str, str]) -> bool:
    """Return whether a stage has left the files of an uninterrupted one, and no others."""
    found = hashes(folder / "seasons")
    if stage == "season":
        place = Layout(folder / "seasons" / NAME)
        Season.read(place).require_secret(place.secret)
        same = found.keys() == names.keys()
    else:
        same = found == names
    check = ["sha256sum", "--check", "--quiet", "--strict", HASHES]
    lists = [path.parent for path in (folder / "seasons").rglob(HASHES)]
    confirmed = all(subprocess.run(check, cwd=each, check=False).returncode == 0 for each in lists)
    return same and confirmed and not any(temporary().iterdir())


def main() -> None:
    """Parse the options, kill, and report."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--kills", type=int, default=36, help="of each stage")
    parser.add_argument("--stages", nargs="+", default=["season", "judge", "reveal"])
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    rng, left, right = random.Random(given.seed), list[str](), True
    with tempfile.TemporaryDirectory(prefix="season-kills-") as made:
        folder, tempfile.tempdir = Path(made), str(Path(made) / "temporary")
        before = folder / "before"
        for each in (temporary(), before / "seasons"):
            each.mkdir(parents=True)
        for stage in ("season", "judge", "reveal"):
            if stage in given.stages:
                right &= kill_stage(stage, before, given.kills, rng, left)
            finish(run_in(before, stage), left, stage)
    print(f"{len(left)} processes or names in shared memory were left", *left[:10])
    sys.exit(bool(left) or not right)


if __name__ == "__main__":
    main()
