"""Train the planner without ingredients, on other numbers of labyrinths, and on other tasks.

    python scripts/studies/ablate.py --sizes 3 4 5
    python scripts/studies/ablate.py --variants planner bc --labyrinths 10 25 50 100 1000 10000
    python scripts/studies/ablate.py --variants planner \
        --tasks partial_observability key_and_door icy_floor
    python scripts/studies/ablate.py --variants "planner exchanged" "bc exchanged" \
        --results results/controls/exchanged

Trains one run per variant, size, task, number of labyrinths and seed, and keeps the labyrinths that
it solves in a file in `--results`, from which report_pages.py makes tables and figures. Runs
whose results exist are skipped. A smaller number of labyrinths is a prefix of a larger one. Every
run is selected and tested on the labyrinths of the dataset of the usual size.

In the variants with `exchanged` the labels up and right are exchanged, as if it were unknown which
action is which, and the policy's answers are exchanged back. This makes no difference to a method
that has to learn what the actions do.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from labyrinth_sets import labyrinth_sets, write_results
from numpy.typing import NDArray

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.observations import ObservationSpec
from labyrinth_core.evaluation.answers import Policy
from labyrinth_core.evaluation.labyrinth_arrays import as_arrays, load_arrays
from labyrinth_core.evaluation.playing import solved_by, success_rate
from labyrinth_core.policies.networks.acting import NetworkPolicy
from labyrinth_core.policies.spec import POLICY, NetworkSpec
from labyrinth_core.world.labyrinth import Task
from pipeline.config.errors import ConfigError
from pipeline.config.run import RunConfig, resolve
from pipeline.config.training import IMAGE_SIZE, PROTOCOLS
from pipeline.generation import build
from pipeline.training.checkpoint import Progress
from pipeline.training.loop import fit
from pipeline.training.methods.acting import load_steps
from pipeline.training.methods.method import BaseSettings, Learner, Problem, find
from pipeline.training.methods.relabelling import NO_LABEL, ExampleSampler
from pipeline.training.policy import save_policy

INGREDIENTS = ("augment", "relabel", "average", "path_prior", "grid_prior", "colour_prior")

VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "planner": ("planner", {}),
    **{f"without {name}": ("planner", {name: False}) for name in INGREDIENTS},
    "without grid and colour": ("planner", {"grid_prior": False, "colour_prior": False}),
    "bc": ("bc", {}),
    # 100 epochs of as many pictures as one of BC has at 5x5.
    "bc with ingredients": (
        "bc",
        {"augment": True, "relabel": True, "average": True, "pictures": 18 * 64},
    ),
}
"""Variant -> its method, and the settings that differ from the defaults."""

UNTURNED = {"augment": False, "average": False}
EXCHANGED: dict[str, tuple[str, dict[str, Any]]] = {
    "planner exchanged": ("planner", {}),
    "unturned exchanged": ("planner", UNTURNED),
    "unturned slow exchanged": ("planner", {**UNTURNED, "learning_rate": 0.0004}),
    "unturned gated exchanged": ("planner", {**UNTURNED, "path_prior": False}),
    "bc exchanged": ("bc", {}),
}
"""The same, with two labels exchanged. The symmetries also say what actions do: without them
(`unturned`) only the planning does, and with `gated` nothing does. `slow` learns at a tenth of the
rate."""

EXCHANGE = np.array([1, 0, 2, 3, NO_LABEL])
"""The labels that replace up, right, down and left, and no label."""

CLONING_STEPS = 1_800
"""The gradient steps of plain BC for any number of labyrinths; 100 epochs of 100 at 5x5."""


@dataclass(frozen=True)
class Case:
    """One run of the ablation."""

    variant: str
    dataset: DatasetConfig
    seed: int

    @property
    def name(self) -> str:
        """The path of its results, without suffix."""
        variant = self.variant.replace(" ", "-")
        return f"{self.dataset.name}/{variant}-of-{self.dataset.labyrinths}-seed{self.seed}"


def main() -> None:
    """Do the runs whose results are missing."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    tasks = [str(task) for task in Task]
    all_variants = [*VARIANTS, *EXCHANGED]
    parser.add_argument("--variants", nargs="+", choices=all_variants, default=list(VARIANTS))
    parser.add_argument("--sizes", type=int, nargs="+", default=[5])
    parser.add_argument("--tasks", nargs="+", choices=tasks, default=tasks[:1])
    parser.add_argument("--labyrinths", type=int, nargs="+", default=[None], help="trained on")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--folder", type=Path, default=Path("runs/ablation"), help="for datasets")
    parser.add_argument("--results", type=Path, default=Path("results/ablation"))
    given = parser.parse_args()
    torch.set_num_threads(1)
    axes = (given.seeds, given.sizes, given.tasks, given.labyrinths, given.variants)
    for seed, size, task, labyrinths, variant in product(*axes):
        dataset = config_of(size, task, labyrinths)
        case = Case(variant, dataset, seed)
        kept = given.results / f"{case.name}.json"
        if kept.exists():
            continue
        usual = built(given.folder / "data", config_of(size, task))
        source = usual
        if labyrinths not in (None, config_of(size, task).labyrinths):
            source = built(given.folder / f"data-of-{dataset.labyrinths}", dataset)
        about, solved = run(case, source, usual, given.folder / case.name)
        write_results(kept, {**about, "usual": source == usual}, solved)
        rates = (f"{name} {np.mean(which):.1%}" for name, which in solved.items())
        print(f"{case.name}: {', '.join(rates)}", flush=True)


def config_of(size: int, task: str, labyrinths: int | None = None) -> DatasetConfig:
    """Return the configuration of a dataset, with the defaults of `python run.py` otherwise."""
    asked = RunConfig(stages=["build"], size=str(size), task=task)
    if labyrinths is not None:  # The split random is not needed, and would be long.
        asked = replace(asked, labyrinths=labyrinths, random_steps=1)
    return resolve(asked).dataset


@cache
def built(folder: Path, dataset: DatasetConfig) -> Path:
    """Return the folder of a dataset, which is built unless it exists."""
    asked = resolve(RunConfig(stages=["build"], data_dir=str(folder)))
    build.run(replace(asked, dataset=dataset))
    return folder


def run(
    case: Case, source: Path, usual: Path, work: Path
) -> tuple[dict[str, Any], dict[str, list[bool]]]:
    """Train and test a policy; return its description, and which labyrinths of each set it solves.

    Args:
        case: The run.
        source: Folder with the dataset that the policy is trained on.
        usual: Folder with the dataset that it is selected and tested on.
        work: Folder for the checkpoint and for the policy.
    """
    sets = dict(labyrinth_sets(usual, case.dataset.name))
    began = time.process_time()
    learner = learner_of(case, source)
    validation = load_arrays(usual, case.dataset.name, "validation")

    def understood(policy: Policy) -> Policy:
        if case.variant not in EXCHANGED:
            return policy
        return lambda pictures: policy(pictures)[:, EXCHANGE[:-1]]

    def judge(policy: Policy) -> dict[str, float]:
        return {"validation_sr": success_rate(understood(policy), validation)}

    def report(done: Progress) -> None:
        print(f"  epoch {done.epoch}: {done.history[-1]['loss']:.3f}", end="\r", flush=True)

    work.mkdir(parents=True, exist_ok=True)
    checkpoint = work / "checkpoint.safetensors"
    about = {
        "config": case.dataset.name,
        "variant": case.variant,
        "labyrinths": case.dataset.labyrinths,
        "seed": case.seed,
        "settings": vars(learner.settings),
        "selected": None,
    }
    try:
        done = fit(learner, judge, PROTOCOLS["default"], checkpoint, {"case": case.name}, report)
    except ConfigError as error:  # A loss that is not finite leaves no policy.
        checkpoint.unlink(missing_ok=True)
        about |= {"cpu_seconds": round(time.process_time() - began), "ended": str(error)}
        return about, {name: [False] * len(labyrinths) for name, labyrinths in sets.items()}
    about |= {"selected": done.best, "cpu_seconds": round(time.process_time() - began)}
    learner.policy.load_state_dict(done.weights)
    policy = understood(NetworkPolicy(learner.policy))
    spec = ObservationSpec("image", IMAGE_SIZE, draw=True)
    solved = {
        name: solved_by(policy, as_arrays(labyrinths, spec)).tolist()
        for name, labyrinths in sets.items()
    }
    save_policy(work / POLICY, done.weights, learner.problem.spec)
    checkpoint.unlink(missing_ok=True)
    return about, solved


def learner_of(case: Case, source: Path) -> Learner:
    """Return the learner of a run before training."""
    name, values = (VARIANTS | EXCHANGED)[case.variant]
    config = case.dataset.name
    arrays = load_arrays(source, config, "train")
    demonstrations = load_steps(source, config, "train", arrays)
    method, settings = find(name, values)
    if case.variant in ("bc", "bc exchanged"):
        settings = cloning(settings, len(demonstrations.states))
    shape = (case.dataset.height, case.dataset.width, str(case.dataset.task))
    torch.manual_seed(case.seed)
    kind = Problem
    if case.variant in EXCHANGED:
        kind = ExchangedProblem
        demonstrations = demonstrations._replace(actions=EXCHANGE[demonstrations.actions])
    problem = kind(
        arrays=arrays,
        observations=torch.from_numpy(arrays.observations),
        demonstrations=demonstrations,
        exploration=partial(load_steps, source, config, "random", arrays),
        spec=NetworkSpec("planner" if name == "planner" else "cnn", 1, *shape),
        rng=np.random.default_rng(case.seed),
    )
    return method(problem, settings)


class ExchangedSampler(ExampleSampler):
    """Draws examples of which two labels are exchanged."""

    def draw(
        self, count: int, rng: np.random.Generator, *, relabel: bool, whole: bool
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """Return pictures and labels, as `ExampleSampler.draw` does."""
        pictures, labels = super().draw(count, rng, relabel=relabel, whole=whole)
        return pictures, EXCHANGE[labels]


class ExchangedProblem(Problem):
    """A problem with such examples."""

    @cached_property
    def examples(self) -> ExampleSampler:
        """The source of pictures drawn from the demonstrations."""
        return ExchangedSampler(self.arrays)


def cloning(settings: BaseSettings, demonstrated: int) -> BaseSettings:
    """Return settings of BC with `CLONING_STEPS` gradient steps and about ten evaluations."""
    batches = -(-demonstrated // settings.batch_size)
    epochs = max(1, round(CLONING_STEPS / batches))
    return replace(settings, epochs=epochs, evaluate_every=max(1, epochs // 10))


if __name__ == "__main__":
    main()
