"""Generative adversarial imitation learning, GAIL (Ho and Ermon 2016), with PPO for the policy.

A discriminator estimates D(s, a), the probability that a step is from the demonstrations. It is
fitted by cross-entropy to the demonstrations and to the policy's latest steps (equation 17 and
Algorithm 1 of the paper, with the roles of 0 and 1 exchanged). The policy maximises the reward

    r(s, a) = log D(s, a),

which is negative everywhere. With our roles, the paper's reward is -log(1 - D), which is positive
everywhere: it rewards every step, so that staying alive is worth more than reaching the goal. The
code of the paper's authors offers log D for tasks that end at a goal (openai/imitation, option
`favor_zero_expert_reward`). If every step costs, an agent must not gain by failing early: ice is
absorbing, and the reward of the step onto it is repeated for ever.

The policy is updated by PPO (Schulman et al. 2017, equation 7, clipped at 1 +- `clip`, with
advantages by equation 11) instead of the paper's TRPO; both keep the new policy close to the one
that acted. There is an entropy bonus, the paper's lambda H(pi).

Departures: log D; absorbing ice; PPO; the critic is one more output of the policy's network; the
agent acts in all training labyrinths in lock-step; the loss of a batch is computed once per
distinct state, however often the state was visited, which gives the same gradient. PPO's ratio has
to compare probabilities of the same network, so the network is trained in evaluation mode: without
dropout, and with running statistics that are computed once, at the beginning, from all states.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from labyrinth_core.learning.learner import BaseSettings, Learner, setting, settle
from labyrinth_core.learning.networks.network import (
    ACTIONS,
    ActorCritic,
    Discriminator,
    Network,
    double,
)
from labyrinth_core.learning.problem import Problem, Rollout, roll_out, softmax

VALUE_WEIGHT = 0.5
"""The weight of the critic's loss."""


@dataclass(frozen=True)
class Settings(BaseSettings):
    """An epoch is some steps in every labyrinth, a pass of D, and some passes of the policy."""

    epochs: int = 150
    batch_size: int = setting(
        256,
        "number of states in a gradient step of the policy or the discriminator",
        at_least=2,
    )
    steps: int = setting(64, "number of steps in each labyrinth in an epoch", at_least=1)
    policy_passes: int = setting(4, "number of passes over the states visited", at_least=1)
    gamma: float = setting(0.95, "discount factor", at_most=0.999)
    trace: float = setting(0.95, "lambda of the advantages", at_most=1)
    clip: float = setting(0.2, "clipping range of the ratio of probabilities in PPO", at_most=1)
    entropy: float = setting(0.01, "weight of the entropy bonus")


class Samples(NamedTuple):
    """Steps of the policy with PPO's targets, each array of shape (N,)."""

    states: NDArray[np.int64]
    actions: NDArray[np.int64]
    advantages: NDArray[np.float64]
    returns: NDArray[np.float64]
    log_probabilities: NDArray[np.float64]
    """The logarithm of each action's probability under the policy that took it."""


class Method(Learner):
    """The policy with its critic, and the discriminator."""

    policy: Network
    settings: Settings

    def __init__(self, problem: Problem, settings: Settings) -> None:
        super().__init__(problem, settings)
        self.actor = ActorCritic(self.policy, 1 / (1 - settings.gamma)).to(problem.device)
        settle(self.actor, problem.observations)
        self.optimizer = self.adam(self.actor)
        self.discriminator = Discriminator(problem.spec).to(problem.device)
        self.judge_optimizer = self.adam(self.discriminator)
        self.where = problem.arrays.initial.copy()
        self.taken = np.zeros_like(self.where)

    def epoch(self) -> dict[str, float]:
        problem, settings = self.problem, self.settings
        outputs = double(self.outputs(self.actor))
        probabilities = softmax(outputs[:, :-1])
        rollout = roll_out(
            problem.arrays, probabilities, self.where, self.taken, settings.steps, problem.rng
        )
        loss = self.discriminate(rollout)
        rewards = reward_of(self.outputs(self.discriminator)).cpu().numpy()
        fatal = rollout.done & ~problem.arrays.goal[rollout.next_states]
        samples = sample(rollout, outputs.cpu().numpy(), rewards, fatal, settings)
        losses = [self.improve(samples) for _ in range(settings.policy_passes)]
        return {
            "loss": loss,
            "policy_loss": float(np.mean(losses)),
            "reward": float(rewards[rollout.states, rollout.actions].mean()),
        }

    def discriminate(self, rollout: Rollout) -> float:
        """Fit the discriminator in one pass over demonstrations and rollout; return its loss."""
        both, count = (self.problem.demonstrations, rollout), len(self.problem.observations)
        shares = np.stack([shares_of(each.states, each.actions, count) for each in both])
        there = np.flatnonzero(shares.any(axis=(0, 2)))
        self.discriminator.train()
        total = 0.0
        batches = self.batches(len(there))
        for batch in batches:
            logits = self.discriminator(self.see(there[batch]))
            expert, own = self.tensor(shares[:, there[batch]]).float()
            loss = (expert * functional.softplus(-logits) + own * functional.softplus(logits)).sum()
            self.descend(self.judge_optimizer, loss * len(batches))
            total += loss.item()
        return total

    def improve(self, samples: Samples) -> float:
        """Update the policy in one pass over the visited states; return the mean loss."""
        visited, of_visited = np.unique(samples.states, return_inverse=True)
        batches = self.batches(len(visited))
        of_batch, row_in_batch = np.empty((2, len(visited)), np.int64)
        for number, batch in enumerate(batches):
            of_batch[batch], row_in_batch[batch] = number, np.arange(len(batch))
        # The samples of one batch after those of another, each in the order of the rollout.
        in_batches = of_batch[of_visited]
        order = in_batches.argsort(kind="stable")
        bounds = in_batches[order].searchsorted(np.arange(1, len(batches)))
        total = 0.0
        for batch, mine in zip(batches, np.split(order, bounds), strict=True):
            rows = row_in_batch[of_visited[mine]]
            outputs = self.actor(self.see(visited[batch]))[self.tensor(rows)]
            chosen = [self.tensor(each[mine]) for each in samples[1:]]
            losses = policy_loss(self.settings, outputs, *chosen)
            loss = losses.sum() / len(samples.states)
            self.descend(self.optimizer, loss * len(batches))
            total += loss.item()
        return total


def reward_of(logits: Tensor) -> Tensor:
    """Return the reward log D, which is negative, from the discriminator's logits."""
    return functional.logsigmoid(double(logits))


def shares_of(
    states: NDArray[np.int64], actions: NDArray[np.int64], count: int
) -> NDArray[np.float64]:
    """Return the share of steps with each state and action, shape (count, 4)."""
    numbers = np.ravel(states) * ACTIONS + np.ravel(actions)
    shares: NDArray[np.float64] = np.bincount(numbers, minlength=count * ACTIONS) / len(numbers)
    return shares.reshape(count, ACTIONS)


def sample(
    rollout: Rollout,
    outputs: NDArray[np.float64],
    rewards: NDArray[np.float64],
    fatal: NDArray[np.bool_],
    settings: Settings,
) -> Samples:
    """Return the steps of a rollout with their advantages (Schulman et al. 2017, equation 11).

    Args:
        rollout: T steps of N agents.
        outputs: The outputs in all states of the actor that acted, shape (S, 5).
        rewards: The reward of each action in each state, shape (S, 4).
        fatal: Whether each step ends on ice, shape (T, N).
        settings: The settings, of which gamma and lambda (`trace`) are used.
    """
    states, actions, after, over, done = rollout
    values, earned = outputs[:, -1], rewards[states, actions]
    # A terminal state is worth 0, but a truncated episode would have gone on.
    worth_after = np.where(done, 0, values[after])
    worth_after = np.where(fatal, earned / (1 - settings.gamma), worth_after)
    surprise = earned + settings.gamma * worth_after - values[states]
    advantages = np.zeros_like(surprise)
    following = np.zeros(surprise.shape[1])
    for step in reversed(range(len(surprise))):
        following = surprise[step] + settings.gamma * settings.trace * following * ~over[step]
        advantages[step] = following
    scores = outputs[states, :-1]
    logs = scores - np.logaddexp.reduce(scores, axis=2, keepdims=True)
    taken = np.take_along_axis(logs, actions[:, :, None], 2)[:, :, 0]
    returns = advantages + values[states]
    scaled = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
    return Samples(*map(np.ravel, (states, actions, scaled, returns, taken)))


def policy_loss(settings: Settings, outputs: Tensor, *targets: Tensor) -> Tensor:
    """Return PPO's loss for each sample, shape (N,).

    `outputs` are the actor's outputs in the states of the samples, shape (N, 5); `targets` are the
    fields of `Samples` after the states.
    """
    actions, advantages, returns, log_probabilities = targets
    logs = torch.log_softmax(outputs[:, :-1], 1)
    ratio = torch.exp(logs.gather(1, actions[:, None])[:, 0] - log_probabilities)
    clipped = ratio.clamp(1 - settings.clip, 1 + settings.clip)
    gain = torch.minimum(ratio * advantages, clipped * advantages)
    error = ((outputs[:, -1] - returns) * (1 - settings.gamma)) ** 2
    entropy = -(logs.exp() * logs).sum(1)
    losses: Tensor = -gain + VALUE_WEIGHT * error - settings.entropy * entropy
    return losses
