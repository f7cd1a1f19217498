"""LeRobot's EnvHub: check that a release's environment has the labyrinths of its splits."""

from __future__ import annotations

import sys

import numpy as np
from comparing import CONFIG, DATA, report
from lerobot.envs.configs import HubEnvConfig
from lerobot.envs.factory import make_env

from labyrinth_core import dump, load_arrays

NAME, ENVIRONMENTS = "user/labyrinth", 10

try:
    make_env(NAME)
except RuntimeError as refused:
    print(refused)
else:
    sys.exit("env.py ran without trust_remote_code")

for split, asked in {"test": NAME, "s0": HubEnvConfig(hub_path=NAME, task="s0")}.items():
    made = make_env(asked, n_envs=ENVIRONMENTS, trust_remote_code=True)
    [[env]] = [suite.values() for suite in made.values()]
    labyrinths = [dump(each) for each in load_arrays(DATA, CONFIG, split).labyrinths]
    shown = []
    for start in range(0, len(labyrinths), ENVIRONMENTS):
        _, info = env.reset(seed=range(start, start + ENVIRONMENTS))  # As LeRobot's rollout does.
        shown += info["labyrinth"].tolist()
        solved = np.zeros(ENVIRONMENTS, bool)
        while not solved.all():
            actions = [each.argmax() for each in info["optimal_actions"]]
            _, _, terminated, _, info = env.step(np.array(actions))
            solved |= terminated
    if shown != labyrinths:
        sys.exit(f"{split}: the environment has other labyrinths than the dataset")
report(
    ["lerobot", "gymnasium"],
    f"the {len(labyrinths)} labyrinths of test and of s0, each solved by its optimal actions",
)
