"""Imitating unknown policies via exploration, IUPE (Gavenski et al. 2020), an extension of BCO.

Three things differ from BCO (`bco.py`), as in the paper:

- The labels of the demonstrations are sampled from the inverse dynamics model's probabilities, anew
  for every pass, instead of being its most likely actions.
- The policy samples its actions when it gathers experience (as in our BCO).
- The model is fitted to a sample I_s of the steps, which depends on how often the policy reached
  the goal. Let E be the policy's episodes of a round, P(g | E) the share of them that reached the
  goal, P(A | E; I_pos) the distribution of actions in these, with equal weight on each episode,
  and P(A | I_pre) the distribution of the random policy's actions. Then I_s consists of

      P(g | E) P(A | E; I_pos)  sampled from the successful episodes, and
      (1 - P(g | E)) P(A | I_pre)  sampled from the random steps.

So a policy that never succeeds adds nothing to the model's sample, and a policy that always
succeeds supplies all of it.

Departures: those of BCO; no self-attention: the networks have the layers of the supplement's
Table 1; |I_s| = |I_pre|, since the paper gives no number. A round is one episode in every training
labyrinth, truncated after `episode_steps`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.learning.learner import setting
from labyrinth_core.learning.methods import bco
from labyrinth_core.learning.problem import Problem, draw, roll_out, softmax


@dataclass(frozen=True)
class Settings(bco.Settings):
    """The settings of BCO; `alpha` has no effect."""

    episode_steps: int = setting(
        100,
        "number of steps after which an episode that gathers experience is truncated",
        at_least=1,
    )


class Method(bco.Method):
    """The policy, the inverse dynamics model, and I_s."""

    settings: Settings

    def __init__(self, problem: Problem, settings: Settings) -> None:
        super().__init__(problem, settings)
        self.reached = 0.0

    def epoch(self) -> dict[str, float]:
        return super().epoch() | {"reached": self.reached}

    def explore(self) -> None:
        """Let the policy play one episode in each labyrinth, and sample I_s."""
        steps, episodes = self.successes()
        self.reached = len(set(episodes.tolist())) / len(self.problem.arrays.initial)
        self.experience = compose(self.before, steps, episodes, self.reached, self.problem.rng)

    def successes(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the steps of successful episodes, shape (N, 3), and each one's episode, (N,)."""
        arrays = self.problem.arrays
        probabilities = softmax(self.outputs(self.policy))
        where, taken = arrays.initial.copy(), np.zeros_like(arrays.initial)
        steps = self.settings.episode_steps
        rollout = roll_out(arrays, probabilities, where, taken, steps, self.problem.rng)
        first: NDArray[np.bool_] = np.cumsum(rollout.over, axis=0) - rollout.over == 0
        reached = arrays.goal[rollout.next_states]
        kept = first & (first & reached).any(axis=0)
        return rollout.transitions[kept.ravel()], np.nonzero(kept)[1]

    def labels(self) -> NDArray[np.int64]:
        return draw(softmax(self.tensor(self.scores)), self.problem.rng)


def compose(
    before: NDArray[np.int64],
    steps: NDArray[np.int64],
    episodes: NDArray[np.int64],
    reached: float,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Return I_s, which has as many steps as I_pre.

    Args:
        before: I_pre, shape (N, 3).
        steps: The steps of the successful episodes, I_pos, shape (M, 3).
        episodes: The episode of each of these steps, shape (M,).
        reached: P(g | E).
        rng: The source of the sample.
    """
    own = round(reached * len(before))
    ours = steps[:0]
    if own:
        # The action of a random step of a random episode is distributed as P(A | E; I_pos).
        weights = 1 / np.bincount(episodes)[episodes]
        ours = steps[rng.choice(len(steps), own, p=weights / weights.sum())]
    others = before[rng.permutation(len(before))[: len(before) - own]]
    return np.concatenate([ours, others])
