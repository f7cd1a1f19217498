"""Soft Q imitation learning, SQIL (Reddy, Dragan and Levine 2020).

Off-policy soft Q-learning on the demonstrations, whose steps have reward 1, and on the learner's
own steps, which have reward 0; half of each batch comes from either. The loss is the mean of
(Q(s, a) - y)^2 (Algorithm 1, with lambda_samp = 1), where

    y = r + gamma V(s'),    V(s) = tau log sum_a exp(Q(s, a) / tau),

and the policy acts by softmax(Q / tau). When evaluated, it takes the action with the highest Q.

The goal is absorbing: an expert that has reached it stays there and keeps receiving reward 1, so
that V(goal) = (1 + tau log 4) / (1 - gamma), no matter whether the expert or the learner reached
it. If V(goal) were 0, avoiding the goal would be optimal, since no reward is negative. Ice is
absorbing as well, with value 0, since no expert is ever there.

Departures: the absorbing goal and ice, which Algorithm 1 does not have; gamma, which has to be
below 1 for V(goal) to be finite and is our choice, 0.9; V(s') comes from a table of the values of
all states, which is recomputed once per epoch and takes the place of a target network; the agent
acts in all training labyrinths in lock-step; the temperature tau, 1 in the paper, is a setting. The
network is trained in evaluation mode, without dropout and with running statistics that are computed
once, at the beginning, from all states, so that targets and predictions come from the same mode.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from labyrinth_core.learning.learner import BaseSettings, Learner, setting, settle
from labyrinth_core.learning.networks.network import ACTIONS, double
from labyrinth_core.learning.problem import Problem, roll_out, softmax


@dataclass(frozen=True)
class Settings(BaseSettings):
    """An epoch is `steps` steps in every labyrinth, then `updates` gradient steps."""

    epochs: int = 150
    batch_size: int = setting(
        128, "number of transitions in a gradient step, half of them demonstrations", at_least=2
    )
    updates: int = setting(30, "number of gradient steps in an epoch", at_least=1)
    steps: int = setting(10, "number of steps in each labyrinth in an epoch", at_least=1)
    buffer: int = setting(50_000, "number of the learner's latest steps that are kept", at_least=1)
    gamma: float = setting(
        0.9, "discount factor; with 1 the value of the goal would be infinite", at_most=0.999
    )
    temperature: float = setting(0.1, "tau", at_least=0.001)


class Method(Learner):
    """Q, and the learner's own steps, an array of rows (s, a, s'), shape (N, 3)."""

    def __init__(self, problem: Problem, settings: Settings) -> None:
        super().__init__(problem, settings)
        settle(self.policy, problem.observations)
        arrays = problem.arrays
        self.where, self.taken = arrays.initial.copy(), np.zeros_like(arrays.initial)
        self.own = np.zeros((0, 3), np.int64)
        self.values = np.zeros(len(arrays.observations))

    def epoch(self) -> dict[str, float]:
        q = self.outputs(self.policy)
        self.values = self.soft_values(q)
        self.act(q)
        losses = [self.update() for _ in range(self.settings.updates)]
        return {"loss": float(np.mean(losses)), "value": float(self.values.mean())}

    def soft_values(self, q: Tensor) -> NDArray[np.float64]:
        """Return V for all states, shape (S,), given Q for all states, shape (S, 4)."""
        settings, arrays = self.settings, self.problem.arrays
        tau = settings.temperature
        values: NDArray[np.float64] = (tau * torch.logsumexp(double(q) / tau, 1)).cpu().numpy()
        # In an absorbing state all actions are equivalent, so the entropy is log 4 per step.
        forever = (1 + tau * np.log(ACTIONS)) / (1 - settings.gamma)
        return np.where(arrays.terminal, np.where(arrays.goal, forever, 0), values)

    def act(self, q: Tensor) -> None:
        """Take `steps` steps in every labyrinth, and add them to the buffer."""
        settings, problem = self.settings, self.problem
        probabilities = softmax(q / settings.temperature)
        rollout = roll_out(
            problem.arrays, probabilities, self.where, self.taken, settings.steps, problem.rng
        )
        self.own = np.concatenate([self.own, rollout.transitions])[-settings.buffer :]

    def update(self) -> float:
        """Take a gradient step and return the loss."""
        settings, rng = self.settings, self.problem.rng
        shown, half = self.problem.demonstrations, settings.batch_size // 2
        demonstrated = rng.integers(len(shown.states), size=half)
        own = self.own[rng.integers(len(self.own), size=half)].T
        states, actions, after = (
            np.concatenate([theirs[demonstrated], ours])
            for theirs, ours in zip(shown, own, strict=True)
        )
        rewards = np.repeat([1.0, 0.0], half)
        targets = self.tensor(rewards + settings.gamma * self.values[after]).float()
        q = self.policy(self.see(states)).gather(1, self.tensor(actions)[:, None])[:, 0]
        loss = functional.mse_loss(q, targets)
        self.descend(self.optimizer, loss)
        return loss.item()
