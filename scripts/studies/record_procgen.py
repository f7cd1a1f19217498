r"""Record the first pictures of Procgen's levels, for `certify`.

    python -m venv procgen && procgen/bin/pip install 'numpy<2' procgen-mirror
    export PYTHONPATH=.
    procgen/bin/python scripts/studies/record_procgen.py --to records
    procgen/bin/python scripts/studies/record_procgen.py --to records --whole \
        --train 100000 --test 5000 maze coinrun ninja

Procgen needs an older numpy than Labyrinth, so this script imports nothing but numpy, Procgen and
`examples/record_levels.py`. The third line records what the benchmark's paper trains on, 200 easy
and 500 hard levels of each game; the fourth the levels of openai/procgen issue 100. As there, an
environment is made for each level. Every tenth level is begun again and recorded again, so that
`certify` finds out whether it repeats. Files that are there are left out.
"""

import argparse
import hashlib
import json
from importlib.metadata import version
from pathlib import Path

import numpy as np
from procgen import ProcgenGym3Env

from examples.record_levels import content

GAMES = (
    *("bigfish", "bossfight", "caveflyer", "chaser", "climber", "coinrun", "dodgeball"),
    *("fruitbot", "heist", "jumper", "leaper", "maze", "miner", "ninja", "plunder", "starpilot"),
)
TRAIN = {"easy": 200, "hard": 500}
"""Mode -> the number of training levels in the benchmark's paper (arXiv 1912.01588)."""
FAR = 1_000_000
"""The first level of test, unless it is that of issue 100."""
HUNDRED = 100_000
"""The number of training levels in issue 100, whose test begins there."""
NEW_EPISODE = np.array([-1], np.int32)
"""The action that ends an episode."""
CHECKED = 10
"""Of so many levels, one is begun again, to check that it repeats."""


def first_pictures(start, count, **options):
    """Yield the number of each level and the digest of its first picture, of some levels twice."""
    for level in range(start, start + count):
        env = ProcgenGym3Env(
            num=1, start_level=level, num_levels=1, rand_seed=0, num_threads=0, **options
        )
        for again in range(1 if level % CHECKED else 2):
            if again:
                env.act(NEW_EPISODE)
            assert env.get_info()[0]["level_seed"] == level
            yield level, hashlib.sha256(content(env.observe()[1]["rgb"][0])).hexdigest()
        env.close()


def record(folder, game, mode, train, test, whole=False, plain=False):
    """Write the levels of a game to a file.

    `train` and `test` are (first level, number of levels); `whole` shows the whole level in place
    of the agent's surroundings, `plain` leaves out backgrounds.
    """
    looks = "-whole" * whole + "-plain" * plain
    name = f"procgen-{game}-{mode}-{train[1]}{looks}"
    path = folder / f"{name}.jsonl"
    if path.exists():
        return
    options = {"env_name": game, "distribution_mode": mode}
    options |= {"center_agent": not whole, "use_backgrounds": not plain}
    versions = {each: version(each) for each in ("numpy", "procgen-mirror")}
    rows = [{"environment": name, "versions": versions}]
    for split, levels in (("train", train), ("test", test)):
        for level, digest in first_pictures(*levels, **options):
            rows.append({"split": split, "seed": level, "first": digest})
    part = path.with_suffix(".part")
    part.write_text("".join(json.dumps(row) + "\n" for row in rows))
    part.rename(path)
    print(name, flush=True)


def main():
    """Record the levels of some games, each in a file of its own."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("games", nargs="*", help="all if left out")
    parser.add_argument("--to", type=Path, required=True, help="folder for the records")
    parser.add_argument("--mode", choices=TRAIN, help="both if left out")
    parser.add_argument("--train", type=int, help="number of levels of train; 200 easy, 500 hard")
    parser.add_argument("--test", type=int, default=500, help="number of levels of test")
    parser.add_argument("--whole", action="store_true", help="show the whole level")
    parser.add_argument("--plain", action="store_true", help="leave out backgrounds")
    given = parser.parse_args()
    given.to.mkdir(parents=True, exist_ok=True)
    for game in given.games or GAMES:
        for mode in [given.mode] if given.mode else TRAIN:
            train = (0, given.train or TRAIN[mode])
            test = (HUNDRED if train[1] == HUNDRED else FAR, given.test)
            record(given.to, game, mode, train, test, given.whole, given.plain)


if __name__ == "__main__":
    main()
