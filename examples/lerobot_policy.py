"""A policy of LeRobot, evaluated on all splits: `evaluate` takes what `reset` and `act` make of it.

    labyrinth-datasets size=5 && python examples/lerobot_policy.py outputs/policy

Needs, in a clone: pip install . lerobot
"""

import sys

import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors

from labyrinth_core import evaluate
from labyrinth_core.evaluation import Results


class LeRobotPolicy:
    """A policy with its processors, in a folder or on the Hub, which may answer in chunks."""

    observation = "image"  # As `observation.image`, float32 from 0 to 1, as in our exports.

    def __init__(self, path: str) -> None:
        config = PreTrainedConfig.from_pretrained(path)
        self.policy = get_policy_class(config.type).from_pretrained(path, config=config)
        self.before, self.after = make_pre_post_processors(config, path)

    def reset(self, _count: int) -> None:
        """Begin episodes: forget the rest of the last chunk."""
        self.policy.reset()

    @torch.inference_mode()
    def act(self, pictures: object) -> torch.Tensor:
        """Return the actions, shape (B,): the nearest of the four to each number."""
        shown = torch.as_tensor(pictures).permute(0, 3, 1, 2).float() / 255
        answer = self.after(self.policy.select_action(self.before({"observation.image": shown})))
        return answer[:, 0].round().clamp(0, 3).long()


def main(path: str, folder="data/labyrinth", config="5x5", **options: object) -> Results:
    """Evaluate the policy, on all splits unless `splits` in the options names some."""
    return evaluate(LeRobotPolicy(path), folder, config, **options)


if __name__ == "__main__":
    print(main(sys.argv[1]))
