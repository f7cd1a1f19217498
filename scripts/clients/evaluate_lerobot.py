"""LeRobot: check that the recipe chooses the same actions as LeRobot's own functions.

The policy is trained on an export by behavioural cloning, and then evaluated. It is a Gaussian
actor, because ACT of LeRobot 0.6.1 reads `observation.state`, which labyrinths do not have.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch
from comparing import CONFIG, DATA, EXPORTS, FOLDER, IDS, expected, fall, report
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.envs.utils import preprocess_observation
from lerobot.policies.factory import make_pre_post_processors
from lerobot.policies.gaussian_actor.configuration_gaussian_actor import (
    GaussianActorConfig,
    PolicyConfig,
)
from lerobot.policies.gaussian_actor.modeling_gaussian_actor import GaussianActorPolicy

RECIPE = Path(__file__).parents[2] / "examples" / "lerobot_policy.py"
PLACE, STEPS = FOLDER / "policy", 600


def train() -> str:
    """Train and save a policy with its processors; return how its loss fell."""
    torch.manual_seed(0)
    dataset = LeRobotDataset(IDS["train"], root=EXPORTS / "lerobot" / IDS["train"])
    config = GaussianActorConfig(
        input_features={"observation.image": PolicyFeature(FeatureType.VISUAL, (3, 64, 64))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (1,))},
        freeze_vision_encoder=False,
        shared_encoder=False,
        image_encoder_hidden_dim=12,
        policy_kwargs=PolicyConfig(std_min=1e-6, std_max=1e-6),  # Its actions are its means.
    )
    policy = GaussianActorPolicy(config)
    before, after = make_pre_post_processors(config, dataset_stats=dataset.meta.stats)
    optimizer = torch.optim.Adam(policy.parameters(), 1e-3)
    losses = []
    everything = next(iter(torch.utils.data.DataLoader(dataset, batch_size=len(dataset))))
    columns = {name: everything[name] for name in ("observation.image", "action")}
    for _ in range(STEPS):
        chosen = torch.randint(len(dataset), (64,))
        shown = before({name: column[chosen] for name, column in columns.items()})
        means = policy.forward(shown)["action_mean"].tanh()
        loss = torch.nn.functional.mse_loss(means, shown["action"].reshape(means.shape))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    for each in (policy, before, after):
        each.save_pretrained(PLACE)
    return fall(losses)


@torch.inference_mode()
def answer_to(policy: Any, before: Any, after: Any, picture: Any) -> float:
    """Return the action, as a number, that LeRobot's own functions choose for one picture."""
    policy.reset()
    return after(policy.select_action(before(preprocess_observation({"pixels": picture})))).item()


torch.set_num_threads(1)
trained = train()
recipe = runpy.run_path(str(RECIPE))
policy = GaussianActorPolicy.from_pretrained(PLACE)
processors = make_pre_post_processors(policy.config, str(PLACE))
pictures = np.concatenate([episode.observations for episode in expected("train")])
answers = np.array([answer_to(policy, *processors, picture) for picture in pictures])
clear = np.abs(answers % 1 - 0.5) > 1e-3  # Batches are summed in another order: skip near ties.
theirs = answers.round().clip(0, 3)[clear]
ours = recipe["LeRobotPolicy"](str(PLACE)).act(pictures).numpy()[clear]
if (ours != theirs).any() or len(set(ours.tolist())) < 4 or clear.mean() < 0.99:
    sys.exit(f"the recipe chooses other actions than LeRobot: {np.sum(ours != theirs)}")
results = recipe["main"](str(PLACE), DATA, CONFIG, splits=["test"])
report(
    ["lerobot", "torch"],
    f"{len(ours):,} actions that the recipe and LeRobot choose; {results.config} is evaluated",
    trained,
)
