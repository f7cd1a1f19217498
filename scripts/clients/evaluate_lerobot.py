"""LeRobot: an ACT that learns from an export is evaluated by the recipe as LeRobot itself plays it.

LeRobot's own functions make its batches, and each episode is played alone.
"""

from __future__ import annotations

import runpy
import sys
from itertools import islice
from pathlib import Path

import torch
from comparing import CONFIG, DATA, EXPORTS, FOLDER, IDS, fall, report
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.envs.utils import preprocess_observation
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors

from labyrinth_core import LabyrinthEnv, load_arrays

RECIPE = Path(__file__).parents[2] / "examples" / "lerobot_policy.py"
PLACE, CHUNK, STEPS, PLAYED = FOLDER / "act", 2, 150, 20


def train() -> str:
    """Save a policy with its processors, and return how its loss fell."""
    torch.manual_seed(0)
    name = IDS["train"]
    root = EXPORTS / "lerobot" / name
    rate = LeRobotDataset(name, root=root).fps
    times = {"action": [step / rate for step in range(CHUNK)]}
    dataset = LeRobotDataset(name, root=root, delta_timestamps=times)
    config = ACTConfig(
        input_features={"observation.image": PolicyFeature(FeatureType.VISUAL, (3, 64, 64))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (1,))},
        chunk_size=CHUNK,
        n_action_steps=CHUNK,
        pretrained_backbone_weights=None,
        use_vae=False,
        dropout=0,
        dim_model=128,
        dim_feedforward=256,
        n_encoder_layers=1,
        device="cpu",
    )
    policy = ACTPolicy(config)
    before, after = make_pre_post_processors(config, dataset_stats=dataset.meta.stats)
    optimizer = torch.optim.AdamW(policy.parameters(), 3e-4)
    losses = []
    loader = torch.utils.data.DataLoader(dataset, batch_size=64, shuffle=True)
    for batch in islice((batch for _ in range(STEPS) for batch in loader), STEPS):
        loss, _ = policy.forward(before(batch))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    for each in (policy, before, after):
        each.save_pretrained(PLACE)
    return fall(losses)


@torch.inference_mode()
def moves_alone(policy: ACTPolicy, before, after, labyrinth) -> int:
    """Return the number of moves in which a policy ends the episode of a labyrinth."""
    env = LabyrinthEnv(labyrinth=labyrinth)
    picture, _ = env.reset()
    policy.reset()
    moves, ended = 0, False
    while not ended:
        action = after(policy.select_action(before(preprocess_observation({"pixels": picture}))))
        picture, _, terminated, truncated, _ = env.step(min(max(round(action.item()), 0), 3))
        moves, ended = moves + 1, terminated or truncated
    return moves


trained = train()
results = runpy.run_path(str(RECIPE))["main"](str(PLACE), DATA, CONFIG, splits=["train"])
found = results.splits["train"].episodes
policy = ACTPolicy.from_pretrained(PLACE)
processors = make_pre_post_processors(policy.config, str(PLACE))
labyrinths = load_arrays(DATA, CONFIG, "train").labyrinths[:PLAYED]
alone = [moves_alone(policy, *processors, each) for each in labyrinths]
if alone != found.moves.ravel()[:PLAYED].tolist() or len(set(alone)) == 1:
    sys.exit(f"the recipe plays otherwise: {found.moves.ravel()[:PLAYED]}, LeRobot {alone}")
report(
    ["lerobot", "torch"],
    f"{PLAYED} episodes that the recipe's ACT and LeRobot's play in the same number of moves, "
    f"of {sum(alone)} in all",
    trained,
)
