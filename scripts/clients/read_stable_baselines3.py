"""Stable-Baselines3: the success rate that it logs, and policies that it and we evaluate alike."""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from comparing import CONFIG, DATA, report
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from labyrinth_core import LabyrinthEnv, evaluate, load_arrays, load_policy

RELEASED = Path(__file__).parents[2] / "docs/results/released/5x5/planner-seed0"
TRAINED = 512
LABYRINTHS = load_arrays(DATA, CONFIG, "test", image_size=8).labyrinths


def compare(policy: Any, way: str, observation: str) -> int:
    """Return the number of episodes, after comparing their returns; exit where one differs."""
    envs = DummyVecEnv(
        [
            lambda each=each: Monitor(LabyrinthEnv(labyrinth=each, observation=observation))
            for each in LABYRINTHS
        ]
    )
    theirs, _ = evaluate_policy(policy, envs, len(LABYRINTHS), return_episode_rewards=True)
    results = evaluate(policy, DATA, CONFIG, observation=observation, splits=["test"])
    ours = results.splits["test"].episodes.returns.ravel()
    if results.way != way or not np.allclose(sorted(theirs), sorted(ours), atol=1e-5):
        sys.exit(f"{type(policy).__name__} by {results.way}: returns differ from evaluate_policy's")
    return len(theirs)


check_env(LabyrinthEnv(CONFIG))
count = compare(load_policy(RELEASED), "look-ups", "image")
for kind, name, way, observation in (
    (PPO, "MlpPolicy", "look-ups", "vector"),
    (PPO, "CnnPolicy", "look-ups", "image"),
    (RecurrentPPO, "MlpLstmPolicy", "steps", "vector"),
):
    model = kind(name, LabyrinthEnv(CONFIG, observation=observation), n_steps=64, seed=0)
    count += compare(model, way, observation)
    count += compare(model.policy, way, observation)

env = LabyrinthEnv(3, observation="vector", max_episode_steps=9)
model = PPO("MlpPolicy", env, n_steps=TRAINED, seed=0, device="cpu")
with TemporaryDirectory() as folder:
    options = {"eval_freq": TRAINED, "log_path": folder, "deterministic": False, "verbose": 0}
    callback = EvalCallback(Monitor(env), n_eval_episodes=50, **options)
    model.learn(TRAINED, callback=callback)
    logged = np.load(f"{folder}/evaluations.npz")
    successes, returns = logged["successes"], logged["results"]
assert successes.any()
assert np.array_equal(successes, returns > 0)  # An episode that is cut returns -0.1.
report(
    ["stable-baselines3", "sb3-contrib", "gymnasium", "torch"],
    f"{count:,} returns that `evaluate_policy` and our `evaluate` find",
    f"{TRAINED} steps of its PPO; its callback logs a success rate of {successes.mean():.0%}",
)
