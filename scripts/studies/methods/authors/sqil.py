"""SQIL in the authors' code.

The target of Q(s, a) is

    y = r + (1 - done) gamma + V(s'),    V(s) = alpha log sum_a exp(Q(s, a) / alpha),

where gamma is added to V(s') and not multiplied by it as in the paper, and V(s') also counts after
the end of an episode. V comes from a target network that is copied after the gradient steps 1, 2
and 4, counted from 0, and never again, because the code tests whether 4 is divisible by the step.
(It calls the steps epochs.) Like the policy, the target network is in training mode, with dropout
and batch statistics.

So V comes from a network that has learnt almost nothing, and is about alpha log 4, and Q ends
between y with r = 0 and y with r = 1. The policy acts by softmax(Q / alpha), also in evaluation:
with alpha 4, a difference of 1 makes an action 1.3 times as likely as another.

A gradient step uses as many of the learner's own steps as rows, whose reward is 1. The learner
starts with a full buffer of its own steps, here in all labyrinths of train in lock-step, and takes
one step before each gradient step, in a labyrinth sampled for each episode. An epoch has one
gradient step per batch of rows. The authors' last rows have no next state; in ours it is the goal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from labyrinth_core.learning.learner import setting
from labyrinth_core.learning.networks.acting import outputs_of
from labyrinth_core.learning.problem import Problem, draw, roll_out, softmax

from . import learner
from .learner import AuthorsLearner, rows_of

ALPHA = 4.0
"""The temperature."""
COPIES = (1, 2, 4)
"""The gradient steps, counted from 0, after which the target network is copied."""


@dataclass(frozen=True)
class Settings(learner.Settings):
    """An epoch has one gradient step per batch of rows."""

    batch_size: int = setting(
        1, "number of rows, and of the learner's own steps, in a gradient step", at_least=1
    )
    buffer: int = setting(50_000, "number of the learner's latest steps that are kept", at_least=1)
    gamma: float = setting(0.99, "number added to the target unless the episode ends", at_most=1)


class Method(AuthorsLearner):
    """Q, the target network, and the rows and the buffer as rows (s, a, s'), shape (N, 3)."""

    def __init__(self, problem: Problem, settings: Settings) -> None:
        super().__init__(problem, settings)
        arrays = problem.arrays
        self.target = self.make(problem.spec, settings).to(problem.device)
        self.copy()
        self.rows = np.stack(rows_of(arrays), axis=1)
        self.own = self.first_steps()
        self.written = self.steps = 0
        self.where, self.taken = self.begin(), 0

    def epoch(self) -> dict[str, float]:
        losses, values = [], []
        for _ in self.batches(len(self.rows)):
            self.act()
            loss, value = self.update()
            losses.append(loss)
            values.append(value)
        return {"loss": float(np.mean(losses)), "value": float(np.mean(values))}

    @classmethod
    def chances(cls, scores: Tensor) -> NDArray[np.float64]:
        return softmax(scores / ALPHA)

    def first_steps(self) -> NDArray[np.int64]:
        """Return a buffer full of steps of the untrained policy."""
        arrays, size = self.problem.arrays, self.settings.buffer
        where, taken = arrays.initial.copy(), np.zeros_like(arrays.initial)
        rollout = roll_out(
            arrays,
            self.chances(self.outputs(self.policy)),
            where,
            taken,
            -(-size // len(where)),
            self.problem.rng,
        )
        return rollout.transitions[-size:]

    def begin(self) -> int:
        """Return the first state of an episode in a labyrinth of train."""
        initial = self.problem.arrays.initial
        return int(initial[self.problem.rng.integers(len(initial))])

    def act(self) -> None:
        """Take a step; it replaces the oldest one in the buffer."""
        arrays, state = self.problem.arrays, self.where
        scores = outputs_of(self.policy, self.see(np.array([state])))
        action = int(draw(self.chances(scores), self.problem.rng)[0])
        after = int(arrays.next_state[state, action])
        self.own[self.written] = state, action, after
        self.written = (self.written + 1) % len(self.own)
        self.taken += 1
        over = bool(arrays.terminal[after]) or self.taken >= arrays.step_limit
        self.where, self.taken = (self.begin(), 0) if over else (after, self.taken)

    def update(self) -> tuple[float, float]:
        """Take a gradient step; return the loss and the mean V(s')."""
        size, rng = self.settings.batch_size, self.problem.rng
        sampled = [each[rng.integers(len(each), size=size)] for each in (self.own, self.rows)]
        states, actions, after = np.concatenate(sampled).T
        values = self.values(after)
        rewards = np.repeat([0.0, 1.0], size)
        done = self.problem.arrays.done[states, actions]
        targets = self.tensor(rewards + (1 - done) * self.settings.gamma) + values
        self.policy.train()
        q = self.policy(self.see(states)).gather(1, self.tensor(actions)[:, None])[:, 0]
        loss = functional.mse_loss(q, targets.float())
        self.descend(self.optimizer, loss)
        if self.steps in COPIES:
            self.copy()
        self.steps += 1
        return loss.item(), values.mean().item()

    def values(self, states: NDArray[np.int64]) -> Tensor:
        """Return V for B states, from the target network in training mode, shape (B,)."""
        self.target.train()
        with torch.no_grad():
            return ALPHA * torch.logsumexp(self.target(self.see(states)).double() / ALPHA, 1)

    def copy(self) -> None:
        """Copy the weights of the policy to the target network."""
        self.target.load_state_dict(self.policy.state_dict())
