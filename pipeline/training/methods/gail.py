"""Generative adversarial imitation learning, GAIL (Ho and Ermon 2016), with PPO for the policy.

A discriminator D(s, a), the probability that a step is a demonstration's, is fitted to the
demonstrations and to the policy's last steps by cross-entropy (equation 17 and Algorithm 1 of the
paper, with the roles of 0 and 1 exchanged), and the policy is improved on the reward

    r(s, a) = log D(s, a),

which is negative everywhere. -log(1 - D), as common, is positive everywhere: it pays for every
step, so that staying alive is worth more than reaching the goal. Where all steps cost, a bad end
must not be a way out: ice counts as absorbing, and earns for ever what the step onto it did.

The policy's step is PPO (Schulman et al. 2017, equation 7, clipped at 1 +- `clip`, with advantages
by equation 11) where the paper has TRPO: what they share is that a policy moves but a little from
the one that acted. It has an entropy bonus, as the paper's lambda H(pi).

Departures: PPO; the value of a state is one more output beside the policy's last layer; the agent
acts in all training labyrinths in lock-step; the loss of a batch is computed once for each state in
it, however often it was visited, which gives the same gradient. Learning uses the network as it
acts, without dropout and with the running statistics of its normalisation, which are settled once,
before it begins, on all states: the ratio of PPO compares probabilities of the same network.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from pipeline.training.methods.acting import Walk, softmax, walk
from pipeline.training.methods.method import BaseSettings, Learner, Problem, setting
from pipeline.training.networks.network import ACTIONS, WIDTH, Discriminator, Network
from pipeline.training.policy import settle

VALUE_WEIGHT = 0.5
"""Of the critic's squared error beside the policy's loss."""


@dataclass(frozen=True)
class Settings(BaseSettings):
    """An epoch is some steps in every labyrinth, a pass of D, and a few of the policy."""

    batch_size: int = setting(
        "number of states in a gradient step of the policy, and of pairs in one of the "
        "discriminator",
        at_least=2,
    )
    steps: int = setting("number of steps in each labyrinth in an epoch", at_least=1)
    policy_passes: int = setting("number of passes over the states visited", at_least=1)
    gamma: float = setting("discount factor", at_most=0.999)
    trace: float = setting("lambda of the advantages", at_most=1)
    clip: float = setting("clipping range of the ratio of probabilities in PPO", at_most=1)
    entropy: float = setting("weight of the entropy bonus")


class ActorCritic(nn.Module):
    """A policy's network with one more output, the value of the state.

    Args:
        policy: What the critic shares all but the last layer with.
        unit: Of the values; its error counts in it, so as not to drown the policy's.
    """

    def __init__(self, policy: Network, unit: float) -> None:
        super().__init__()
        self.unit = unit
        self.policy = policy
        self.value = nn.Linear(WIDTH, 1)

    def forward(self, observations: Tensor) -> Tensor:
        """Return the scores of the actions and the value, shape (batch, 5)."""
        hidden = self.policy.hidden(observations)
        last = self.policy.classifier[-1]
        return torch.cat([last(hidden), self.value(hidden) * self.unit], 1)


class Samples(NamedTuple):
    """Steps of the policy, and how they are judged, each of shape (N,)."""

    states: NDArray[np.int64]
    actions: NDArray[np.int64]
    advantages: NDArray[np.float64]
    returns: NDArray[np.float64]
    log_probabilities: NDArray[np.float64]
    """Of the actions, by the policy that took them."""


class Method(Learner):
    """The policy with its critic, and the discriminator."""

    policy: Network
    settings: Settings

    def __init__(self, problem: Problem, settings: Settings) -> None:
        super().__init__(problem, settings)
        self.actor = ActorCritic(self.policy, 1 / (1 - settings.gamma)).to(
            problem.observations.device
        )
        settle(self.actor, problem.observations)
        self.optimizer = self.adam(self.actor)
        self.discriminator = Discriminator(problem.spec).to(problem.observations.device)
        self.judge_optimizer = self.adam(self.discriminator)
        self.where = problem.worlds.initial.copy()
        self.taken = np.zeros_like(self.where)

    def epoch(self) -> dict[str, float]:
        problem, settings = self.problem, self.settings
        outputs = self.outputs(self.actor).double()
        probabilities = softmax(outputs[:, :-1])
        walked = walk(
            problem.worlds, probabilities, self.where, self.taken, settings.steps, problem.rng
        )
        judged = self.discriminate(walked)
        rewards = reward_of(self.outputs(self.discriminator)).cpu().numpy()
        fatal = walked.done & ~problem.worlds.goal[walked.next_states]
        samples = sample(walked, outputs.cpu().numpy(), rewards, fatal, settings)
        losses = [self.improve(samples) for _ in range(settings.policy_passes)]
        return {
            "loss": judged,
            "policy_loss": float(np.mean(losses)),
            "reward": float(rewards[walked.states, walked.actions].mean()),
        }

    def discriminate(self, walked: Walk) -> float:
        """Fit the discriminator by one pass over all states of both kinds; return its loss."""
        shares = np.stack(
            [
                shares_of(steps.states, steps.actions, len(self.problem.observations))
                for steps in (self.problem.demonstrations, walked)
            ]
        )
        there = np.flatnonzero(shares.any(axis=(0, 2)))
        self.discriminator.train()
        total = 0.0
        batches = self.batches(len(there))
        for batch in batches:
            logits = self.discriminator(self.see(there[batch]))
            expert, own = self.tensor(shares[:, there[batch]]).float()
            loss = (expert * functional.softplus(-logits) + own * functional.softplus(logits)).sum()
            self.judge_optimizer.zero_grad()
            (loss * len(batches)).backward()
            self.judge_optimizer.step()
            total += loss.item()
        return total

    def improve(self, samples: Samples) -> float:
        """Take the gradient steps of one pass over the states visited; return the mean loss."""
        visited, of_visited = np.unique(samples.states, return_inverse=True)
        batches = self.batches(len(visited))
        total = 0.0
        for batch in batches:
            place = np.full(len(visited), -1)
            place[batch] = np.arange(len(batch))
            rows = place[of_visited]
            mine = rows >= 0
            outputs = self.actor(self.see(visited[batch]))[self.tensor(rows[mine])]
            chosen = [self.tensor(each[mine]) for each in samples[1:]]
            losses = policy_loss(self.settings, outputs, *chosen)
            loss = losses.sum() / len(samples.states)
            self.optimizer.zero_grad()
            (loss * len(batches)).backward()
            self.optimizer.step()
            total += loss.item()
        return total


def reward_of(logits: Tensor) -> Tensor:
    """Return log D, which is below 0, from the discriminator's logits."""
    return functional.logsigmoid(logits.double())


def shares_of(
    states: NDArray[np.int64], actions: NDArray[np.int64], count: int
) -> NDArray[np.float64]:
    """Return the share of each state and action in some steps, shape (count, 4)."""
    numbers = np.ravel(states) * ACTIONS + np.ravel(actions)
    shares: NDArray[np.float64] = np.bincount(numbers, minlength=count * ACTIONS) / len(numbers)
    return shares.reshape(count, ACTIONS)


def sample(
    walked: Walk,
    outputs: NDArray[np.float64],
    rewards: NDArray[np.float64],
    fatal: NDArray[np.bool_],
    settings: Settings,
) -> Samples:
    """Return the steps of walkers with their advantages (Schulman et al. 2017, equation 11).

    Args:
        walked: T steps of N walkers.
        outputs: Of the actor in all states, before it learns, shape (S, 5).
        rewards: Of each action in each state, shape (S, 4).
        fatal: Which steps end on ice, shape (T, N).
        settings: gamma and lambda.
    """
    states, actions, after, over, done = walked
    values, earned = outputs[:, -1], rewards[states, actions]
    # An episode that was cut is worth what comes after; one that has ended is over.
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


def policy_loss(
    settings: Settings,
    outputs: Tensor,
    actions: Tensor,
    advantages: Tensor,
    returns: Tensor,
    log_probabilities: Tensor,
) -> Tensor:
    """Return PPO's loss for each sample, shape (N,).

    Args:
        settings: Clipping, and the weight of entropy.
        outputs: Of the actor in the samples' states, shape (N, 5).
        actions: As the others, a field of `Samples`.
        advantages: See there.
        returns: See there.
        log_probabilities: See there.
    """
    logs = torch.log_softmax(outputs[:, :-1], 1)
    ratio = torch.exp(logs.gather(1, actions[:, None])[:, 0] - log_probabilities)
    clipped = ratio.clamp(1 - settings.clip, 1 + settings.clip)
    gain = torch.minimum(ratio * advantages, clipped * advantages)
    error = ((outputs[:, -1] - returns) * (1 - settings.gamma)) ** 2
    entropy = -(logs.exp() * logs).sum(1)
    losses: Tensor = -gain + VALUE_WEIGHT * error - settings.entropy * entropy
    return losses
