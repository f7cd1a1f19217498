"""LeRobot: the recipe evaluates a policy of LeRobot as LeRobot's own functions play it.

The policy learns from an export by behavioural cloning, and is then played in one labyrinth after
another. It is a Gaussian actor, as ACT of LeRobot 0.6.1 reads `observation.state`, which labyrinths
do not have.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from typing import Any

import torch
from comparing import CONFIG, DATA, EXPORTS, FOLDER, IDS, fall, report
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.envs.utils import preprocess_observation
from lerobot.policies.factory import make_pre_post_processors
from lerobot.policies.gaussian_actor.configuration_gaussian_actor import (
    GaussianActorConfig,
    PolicyConfig,
)
from lerobot.policies.gaussian_actor.modeling_gaussian_actor import GaussianActorPolicy

from labyrinth_core import Labyrinth, LabyrinthEnv, load_arrays

RECIPE = Path(__file__).parents[2] / "examples" / "lerobot_policy.py"
PLACE, STEPS, PLAYED = FOLDER / "policy", 2_500, 20


def train() -> str:
    """Save a policy with its processors, and return how its loss fell."""
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
def moves_of(policy: Any, before: Any, after: Any, labyrinth: Labyrinth) -> int:
    """Return the number of moves in which a policy ends an episode in a labyrinth."""
    env = LabyrinthEnv(labyrinth=labyrinth)
    picture, _ = env.reset()
    policy.reset()
    moves, ended = 0, False
    while not ended:
        action = after(policy.select_action(before(preprocess_observation({"pixels": picture}))))
        picture, _, terminated, truncated, _ = env.step(min(max(round(action.item()), 0), 3))
        moves, ended = moves + 1, terminated or truncated
    return moves


torch.set_num_threads(1)
trained = train()
results = runpy.run_path(str(RECIPE))["main"](str(PLACE), DATA, CONFIG, splits=["train"])
ours = results.splits["train"].episodes.moves.ravel()[:PLAYED].tolist()
policy = GaussianActorPolicy.from_pretrained(PLACE)
processors = make_pre_post_processors(policy.config, str(PLACE))
labyrinths = load_arrays(DATA, CONFIG, "train").labyrinths[:PLAYED]
theirs = [moves_of(policy, *processors, each) for each in labyrinths]
solved = sum(moves < max(theirs) for moves in theirs)
if ours != theirs or not solved:
    sys.exit(f"the recipe plays in {ours} moves, LeRobot in {theirs}")
report(
    ["lerobot", "torch"],
    f"{PLAYED} episodes that the recipe and LeRobot play in the same number of moves, of which "
    f"{solved} reach the goal",
    trained,
)
