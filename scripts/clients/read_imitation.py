"""imitation: load trajectories, and train with the library's behavioural cloning."""

from __future__ import annotations

import numpy as np
from comparing import EXPORTS, IDS, Episode, compare, fall, report
from gymnasium.spaces import Box, Discrete
from imitation.algorithms import bc
from imitation.data import rollout, serialize
from imitation.util import logger

steps = {}
for split, name in IDS.items():
    trajectories = serialize.load_with_rewards(EXPORTS / "imitation" / name)
    episodes = (Episode(t.obs, t.acts, np.float32(t.rews), t.terminal) for t in trajectories)
    steps[split] = compare(episodes, split)
    assert "labyrinth:" in trajectories[0].infos[0]["labyrinth"]

trajectories = serialize.load(EXPORTS / "imitation" / IDS["train"])
transitions = rollout.flatten_trajectories(list(trajectories))
assert len(transitions) == steps["train"]
trainer = bc.BC(
    observation_space=Box(0, 255, (64, 64, 3), np.uint8),
    action_space=Discrete(4),
    rng=np.random.default_rng(0),
    demonstrations=transitions,
    custom_logger=logger.configure(format_strs=[]),
)


def loss() -> float:
    """Return the mean negative log-likelihood of the demonstrated actions."""
    device = trainer.policy.device
    tensors = (
        bc.th.as_tensor(values, device=device) for values in (transitions.obs, transitions.acts)
    )
    with bc.th.no_grad():
        _, log_prob, _ = trainer.policy.evaluate_actions(*tensors)
    return float(-log_prob.mean())


before = loss()
trainer.train(n_batches=30, progress_bar=False)
trained = fall([before, loss()]).replace("2 steps", "30 steps of its BC")
report(
    ["imitation", "gymnasium", "stable-baselines3", "datasets"],
    f"{sum(steps.values()):,} steps",
    trained,
)
