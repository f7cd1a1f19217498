"""Policies of LeRobot, as `evaluate` takes them.

    policy = ACTPolicy.from_pretrained(path)
    processors = make_pre_post_processors(policy.config, path)
    evaluate(LeRobotPolicy(policy, *processors), "data/labyrinth", "5x5")

Batches and actions are those of `lerobot.scripts.lerobot_eval.rollout` and
`lerobot.envs.utils.preprocess_observation` of https://pypi.org/project/lerobot/, 0.4.4.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from labyrinth_core.world.grid import Action

if TYPE_CHECKING:
    import torch

IMAGE = "observation.image"
"""The name of the pictures in a batch, and in our exports for LeRobot."""


class LeRobotPolicy:
    """A policy of LeRobot with `reset` and `act`: it remembers the rest of a chunk of actions."""

    observation = "image"

    def __init__(
        self, policy: Any, preprocessor: Callable[[Any], Any], postprocessor: Callable[[Any], Any]
    ) -> None:
        """Begin with no episode.

        Args:
            policy: A module of PyTorch with `reset()` and `select_action(batch)`.
            preprocessor: Makes what the policy is given from a batch with `observation.image`,
                float32 from 0 to 1, shape (B, 3, size, size).
            postprocessor: Makes actions of the dataset from what the policy answers.
        """
        self.policy, self.preprocessor, self.postprocessor = policy, preprocessor, postprocessor

    def reset(self, count: int) -> None:  # noqa: ARG002
        """Begin `count` episodes."""
        self.policy.reset()

    def act(self, observations: NDArray[Any]) -> torch.Tensor:
        """Return the actions, shape (B,), or scores, shape (B, 4).

        An action of one number, as in our exports, stands for the nearest of the four.

        Args:
            observations: Pictures, uint8 (B, size, size, 3).
        """
        import torch

        weight = next(self.policy.parameters(), None)
        pictures = torch.as_tensor(observations, device=None if weight is None else weight.device)
        batch = {IMAGE: pictures.permute(0, 3, 1, 2).float() / 255}
        with torch.inference_mode():
            answer = self.policy.select_action(self.preprocessor(batch))
            actions: torch.Tensor = self.postprocessor(answer)
        if actions.ndim == 2 and actions.shape[1] == 1:
            return actions[:, 0].round().clamp(0, len(Action) - 1).long()
        return actions
