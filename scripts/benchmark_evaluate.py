"""Measure how fast a policy is evaluated, beside stepping the environment labyrinth by labyrinth.

    python run.py size=5
    python scripts/benchmark_evaluate.py [--data FOLDER] [--rounds N] [--labyrinths N] [--quick]

The policy is the CNN of the baselines with fresh weights, since training does not change the time
of a forward pass. The script prints the times of:

- five splits: loading their labyrinths, drawing all states at 64 x 64, one pass of the policy over
  them, the look-ups and the intervals; everything in `stages=evaluate` but the baselines.
- stepping: some labyrinths of train in `LabyrinthEnv`, one after the other, with one call of the
  policy in each step, on the frame of 600 x 600 that the environment renders, averaged to 64 x 64.
- their ratio for a labyrinth of train; both ways have to agree on every move and return.

The policy fails nearly everywhere, and a failed episode is stepped until it is truncated, after
1,000 steps. With `--solving` it is always right and episodes are as short as possible, which gives
the smallest ratio.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
import torch
from measuring import machine, parser_of, positive
from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.loader import load_episodes
from labyrinth_core.env import LabyrinthEnv
from labyrinth_core.evaluation.answers import Policy
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays, load_arrays
from labyrinth_core.evaluation.playing import Episodes, follow, greedy_actions
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS, score
from labyrinth_core.pictures.resize import area_average
from labyrinth_core.policies.networks.acting import NetworkPolicy
from labyrinth_core.policies.networks.network import Network
from labyrinth_core.policies.spec import NetworkSpec

CONFIG = "5x5"


class Solving:
    """A policy that takes as long as another one, and is always right."""

    def __init__(self, policy: Policy, arrays: LabyrinthArrays) -> None:
        best = np.eye(4, dtype=np.float32)[arrays.optimal.argmax(axis=1)]
        self._policy = policy
        self._scores = {
            each.tobytes(): row for each, row in zip(arrays.observations, best, strict=True)
        }

    def __call__(self, observations: NDArray[Any]) -> NDArray[np.float32]:
        """Return the scores of the actions, shape (B, 4)."""
        self._policy(observations)
        return np.stack([self._scores[each.tobytes()] for each in observations])


class Timed:
    """A policy that adds up the CPU time it takes."""

    def __init__(self, policy: Policy) -> None:
        self.seconds = 0.0
        self._policy = policy

    def __call__(self, observations: NDArray[Any]) -> NDArray[np.float32]:
        """Return the scores of the actions, shape (B, 4)."""
        start = time.process_time()
        scores = self._policy(observations)
        self.seconds += time.process_time() - start
        return scores


class Times(NamedTuple):
    """The seconds that an evaluation takes: by the clock, and of CPU time."""

    clock: float
    cpu: float
    loading: float
    policy: float


def evaluate_all(policy: Policy, data: Path) -> Times:
    """Return the seconds to evaluate the five splits, from their files to their figures."""
    timed, loading = Timed(policy), 0.0
    clock, start = time.perf_counter(), time.process_time()
    for split in EVALUATED_SPLITS:
        begin = time.process_time()
        arrays = load_arrays(data, CONFIG, split)
        loading += time.process_time() - begin
        score(timed, arrays).to_json()
    cpu = time.process_time() - start
    return Times(time.perf_counter() - clock, cpu, loading, timed.seconds)


def step_singly(policy: Policy, labyrinths: list[str]) -> list[tuple[int, float]]:
    """Step through an episode in each labyrinth; return the moves and the return of each."""
    found = []
    for text in labyrinths:
        env = LabyrinthEnv(labyrinth=text, observation="state", render_mode="rgb_array")
        env.reset(seed=0)
        moves, total, over = 0, 0.0, False
        while not over:
            frame = env.render()
            assert isinstance(frame, np.ndarray)
            action = int(policy(area_average(frame, 64)[None]).argmax())
            _, reward, terminated, truncated, _ = env.step(action)
            moves, total, over = moves + 1, total + reward, terminated or truncated
        found.append((moves, total))
    return found


def main() -> None:
    """Measure and report."""
    parser = parser_of(__doc__, rounds=5)
    parser.add_argument("--data", type=Path, default=Path("data/labyrinth"), help="dataset")
    parser.add_argument("--labyrinths", type=positive, default=10, help="to step in, per round")
    parser.add_argument("--solving", action="store_true", help="a policy that is always right")
    arguments = parser.parse_args()
    rounds, count = (1, 2) if arguments.quick else (arguments.rounds, arguments.labyrinths)
    try:
        train = load_arrays(arguments.data, CONFIG, "train")
        episodes = list(load_episodes(arguments.data, CONFIG, split="train", draw=True))
    except DatasetError as error:
        sys.exit(f"error: {error}")
    infos = list(dict.fromkeys(episode.info for episode in episodes))
    torch.manual_seed(0)
    network: Policy = NetworkPolicy(Network(NetworkSpec("cnn", 1, 5, 5, "navigation")))
    policy = Solving(network, train) if arguments.solving else network
    print(f"{machine('numpy', 'torch')}; {torch.get_num_threads()} threads, {rounds} rounds")
    whole, ratios, steps = [], [], []
    for number in range(rounds):
        whole.append(evaluate_all(network, arguments.data))
        chosen = [(number * count + place) % len(infos) for place in range(count)]
        start = time.perf_counter()
        arrays = load_arrays(arguments.data, CONFIG, "train")
        looked_up = follow(arrays, greedy_actions(policy, arrays))
        per_labyrinth = (time.perf_counter() - start) / len(infos)
        start = time.perf_counter()
        stepped = step_singly(policy, [infos[place] for place in chosen])
        seconds = time.perf_counter() - start
        ratios.append(seconds / count / per_labyrinth)
        steps.append(sum(moves for moves, _ in stepped) / seconds)
        check(looked_up, chosen, stepped)
    clock, cpu, loading, asking = map(median, zip(*whole, strict=True))
    best = min(each.clock for each in whole)
    print(f"five splits, from files to figures: {clock:.2f} s (best {best:.2f} s)")
    shares = f"{loading / cpu:.0%} loading, {asking / cpu:.0%} the policy"
    print(f"five splits, CPU time: {cpu:.2f} s, of which {shares}")
    print(f"stepping: {median(steps):,.0f} steps a second")
    extent = f"{min(ratios):,.0f} - {max(ratios):,.0f}"
    print(f"a labyrinth by look-ups: {median(ratios):,.0f} times as fast (range {extent})")


def check(looked_up: Episodes, places: list[int], stepped: list[tuple[int, float]]) -> None:
    """Exit with a message if the two ways disagree."""
    returns = looked_up.returns
    for place, (moves, total) in zip(places, stepped, strict=True):
        if looked_up.moves[place] != moves or abs(returns[place] - total) > 1e-9:
            sys.exit(f"labyrinth {place}: {looked_up.moves[place]} moves by look-ups, not {moves}")


if __name__ == "__main__":
    main()
