"""Record the first pictures of Procgen's levels, for `certify`.

    python -m venv procgen && procgen/bin/pip install 'numpy<2' procgen-mirror
    export PYTHONPATH=.
    procgen/bin/python scripts/studies/record_procgen.py --to records
    procgen/bin/python scripts/studies/record_procgen.py --to records maze --train 100000

Procgen needs an older numpy than Labyrinth, so this script imports nothing but numpy, Procgen and
`examples/record_levels.py`. Distribution "easy", all other settings as Procgen has them. A level is
drawn at random among those of its split until all have been drawn; one that is drawn again is
recorded again, so that `certify` finds out whether it repeats.
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
TEST = 1_000_000
"""The first level of test."""
AT_ONCE = 64
"""The number of levels that are drawn together."""
NEW_LEVEL = -1
"""The action that ends an episode."""
AGAIN = 2
"""How often a level is recorded at most."""


def first_pictures(game, start, count):
    """Yield the number of a level and the digest of its first picture, until all were seen."""
    env = ProcgenGym3Env(
        num=AT_ONCE,
        env_name=game,
        start_level=start,
        num_levels=count,
        distribution_mode="easy",
        rand_seed=0,
        num_threads=0,
    )
    drawn = {}
    while len(drawn) < count:
        pictures = env.observe()[1]["rgb"]
        for info, picture in zip(env.get_info(), pictures, strict=True):
            level = int(info["level_seed"])
            drawn[level] = drawn.get(level, 0) + 1
            if drawn[level] <= AGAIN:
                yield level, hashlib.sha256(content(picture)).hexdigest()
        env.act(np.full(AT_ONCE, NEW_LEVEL, np.int32))
    env.close()


def main():
    """Record the levels of some games, each in a file of its own."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("games", nargs="*", help="all if left out")
    parser.add_argument("--to", type=Path, required=True, help="folder for the records")
    parser.add_argument("--train", type=int, default=500, help="number of levels of train")
    parser.add_argument("--test", type=int, default=500, help="number of levels of test")
    given = parser.parse_args()
    given.to.mkdir(parents=True, exist_ok=True)
    for game in given.games or GAMES:
        name = f"procgen-{game}-{given.train}"
        versions = {each: version(each) for each in ("numpy", "procgen-mirror")}
        rows = [{"environment": name, "versions": versions}]
        for split, start, count in (("train", 0, given.train), ("test", TEST, given.test)):
            for level, digest in first_pictures(game, start, count):
                rows.append({"split": split, "seed": level, "first": digest})
        path = given.to / (name + ".jsonl")
        path.write_text("".join(json.dumps(row) + "\n" for row in rows))


if __name__ == "__main__":
    main()
