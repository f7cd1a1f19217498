"""Datasets of Minari, split by a share or compared with another one."""

from __future__ import annotations

import warnings

import gymnasium
import minari
import numpy as np
import pytest
from minari.data_collector import EpisodeBuffer

from labyrinth_core import certify
from labyrinth_core.benchmarks import CertifyError

pytestmark = pytest.mark.slow  # Importing Minari takes seconds.


def walked(env, seed, action):
    """Return the episode of a seed in which one action is repeated until the end."""
    observations, actions, rewards, ends = [env.reset(seed=seed)[0]], [], [], []
    while not ends or not any(ends[-1]):
        observation, reward, *over, _ = env.step(action)
        observations.append(observation)
        actions.append(action)
        rewards.append(reward)
        ends.append(over)
    terminations, truncations = (list(flags) for flags in zip(*ends, strict=True))
    return EpisodeBuffer(
        seed=seed,
        observations=np.array(observations),
        actions=np.array(actions),
        rewards=rewards,
        terminations=terminations,
        truncations=truncations,
        infos={},
    )


@pytest.fixture(scope="module")
def datasets(tmp_path_factory):
    """Two datasets: seeds 0 to 9, walked by one action; and seeds 5, 25 and 31, by another."""
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # About addresses and scores, which they do not have.
        patch.setenv("MINARI_DATASETS_PATH", str(tmp_path_factory.mktemp("minari")))
        corridor = "support.deceiving:Corridor"
        gymnasium.register("Corridor-v0", entry_point=corridor, max_episode_steps=4)
        env = gymnasium.make("Corridor-v0", disable_env_checker=True)
        for name, seeds, action in (("one-v0", range(10), 1), ("two-v0", (5, 25, 31), 0)):
            episodes = [walked(env, seed, action) for seed in seeds]
            minari.create_dataset_from_buffers(f"corridor/{name}", episodes, env=env)
        yield
        del gymnasium.registry["Corridor-v0"]


@pytest.mark.usefixtures("datasets")
def test_a_dataset_is_split_by_a_share_of_its_episodes():
    found = certify("minari:corridor/one-v0", train=0.7)
    counts = {measure: (share.count, share.of) for measure, share in found.measures.items()}
    # Seed 0 reaches its goal after three steps; all others walk four.
    assert counts == {"seeds": (0, 3), "first": (0, 3), "actions": (3, 3)}
    assert "3 (100%, 95% interval 43.9 to 100%) repeat the whole action sequence" in found.sentence
    assert found.arguments == {"environment": "minari:corridor/one-v0", "train": 0.7}
    assert found.levels.seen == 10


@pytest.mark.usefixtures("datasets")
def test_two_datasets_are_compared():
    found = certify("minari:corridor/one-v0", test="minari:corridor/two-v0")
    counts = {measure: share.count for measure, share in found.measures.items()}
    assert counts == {"seeds": 1, "first": 3, "actions": 0}


@pytest.mark.usefixtures("datasets")
@pytest.mark.parametrize(
    ("train", "test", "message"),
    [
        (2, None, "train=2: give the share"),
        (0.01, None, "10 episodes leave 10 for test"),
        (None, "corridor/two-v0", "give another dataset as minari:ID"),
        (None, "minari:corridor/three-v0", "minari:corridor/three-v0 cannot be read"),
    ],
)
def test_a_mistake_gets_one_line(train, test, message):
    with pytest.raises(CertifyError, match=message) as raised:
        certify("minari:corridor/one-v0", train=train, test=test)
    assert "\n" not in str(raised.value)
