"""The stage `evaluate`, and its options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from labyrinth_core import typed
from labyrinth_core.data import SPLITS
from labyrinth_core.evaluation import Description, RunName
from labyrinth_core.pictures import PICTURE_SIZE
from pipeline.config import Job, Stage, TrainingOptions, WorkOptions, check, option

COMPARE = "stages=results", "compare it with others"
"""What to do after an evaluation, and why."""


@dataclass(frozen=True)
class EvaluationOptions:
    """How the policy that `policy` names is evaluated, and how its results describe it."""

    image_size: int | None = option(
        None,
        "pixels on each side of the pictures (the policy's own size, or 64)",
        at_least=1,
        at_most=PICTURE_SIZE,
    )
    episodes: int | None = option(
        None,
        "episodes per labyrinth, for a policy that samples its actions",
        at_least=1,
        at_most=typed.MOST_EPISODES,
    )
    splits: tuple[str, ...] = option(
        (), "splits to evaluate policy on, one or a list (all but random)", one_of=SPLITS
    )
    gifs: int = option(
        0,
        "number of GIFs that show the policy beside the solver in labyrinths of test, failures "
        "first",
        at_least=0,
        at_most=1_000,
    )
    memorised: int | None = option(
        None,
        "number of control training sets, such as 200, with which to ask whether the policy "
        "follows its own (not asked)",
        at_least=typed.CONTROLS[0],
        at_most=typed.CONTROLS[1],
    )
    name: str = option(
        "", "name of the policy in tables (module:name as given, else the last part of policy)"
    )
    author: str = option("", "author of the policy")
    url: str = option(
        "",
        "page that describes the policy",
        like=(r"(https?://\S+)?", "an address such as https://example.org"),
    )
    date: str = option(
        "", "date of the evaluation, such as 2026-11-30; not filled in automatically"
    )
    budget: str = option("", "training data of the policy, such as '100 demonstrations of train'")
    train_labyrinths: int | None = option(None, Description.DETAILS["labyrinths"], at_least=0)
    train_steps: int | None = option(None, Description.DETAILS["steps"], at_least=0)
    parameters: int | None = option(None, Description.DETAILS["parameters"], at_least=0)


@dataclass(frozen=True)
class EvaluateOptions(TrainingOptions, WorkOptions):
    """The policy that is evaluated: that of a training run, or any other."""

    policy: str = option(
        "",
        "policy to evaluate: the folder of a run or of a published policy, an ONNX graph, an id on "
        "the Hub such as user/planner-5x5@1.0.0, or module:name",
        like=(
            r"([\w.]+:[\w.]+|(?!.*\.zip$)[^@:\x00-\x1f]+(@[\w./-]+)?)?",
            "module:name, the folder of a run or of a published policy, an ONNX graph, or an id on "
            "the Hub, with @ and a revision if it is not main",
        ),
    )
    evaluate_on: str = option(
        "",
        "another dataset to evaluate the trained policy on, such as data/other/4x6, or "
        "user/name/4x6 on the Hub",
        is_dataset=True,
    )
    evaluation: EvaluationOptions = field(default_factory=EvaluationOptions)


def _check(job: Job[EvaluateOptions], stages: Sequence[str]) -> None:
    options = job.options
    check(
        not (options.evaluate_on and options.evaluation.memorised),
        f"evaluation.memorised={options.evaluation.memorised}: a policy has not learnt from train "
        f"of evaluate_on={options.evaluate_on}, so leave one of them out",
    )
    check(
        not (options.train_labyrinths == RunName.FRESH and options.evaluation.memorised),
        f"evaluation.memorised={options.evaluation.memorised}: train_labyrinths={RunName.FRESH} "
        "has no training set that a policy could remember, so leave one of them out",
    )
    splits = options.evaluation.splits
    check(
        not options.evaluation.memorised or not splits or bool({"test", "validation"} & {*splits}),
        f"evaluation.memorised={options.evaluation.memorised}: give test or validation in "
        "evaluation.splits, since other splits depend on train",
    )
    if not options.policy:
        options.check_training()
        for name in described_by(options.evaluation):
            check(
                False,
                f"evaluation.{name} is for policy=...: a trained run is evaluated under its own "
                "name, on all splits",
            )
        return
    check("train" not in stages, f"policy={options.policy}: give stages=evaluate, not train")
    check(
        not options.evaluate_on,
        f"evaluate_on={options.evaluate_on} is for trained policies: with policy, give dataset",
    )
    options.check_observation()


def described_by(evaluation: EvaluationOptions) -> list[str]:
    """Return the options given that describe a policy as another one than a trained run."""
    changed = (
        each for each in fields(evaluation) if getattr(evaluation, each.name) != each.default
    )
    return [each.name for each in changed if each.name not in ("gifs", "memorised")]


def _next_step(job: Job[EvaluateOptions], stages: Sequence[str]) -> tuple[str, ...]:  # noqa: ARG001
    return () if job.options.evaluate_on else COMPARE


def _idle(options: Any) -> dict[str, str]:
    """Return the options that name a training run, if another policy is evaluated."""
    of_run = ("method", "encoder", "protocol", "train_labyrinths") if options.policy else ()
    return dict.fromkeys(of_run, "without policy")


STAGES = {
    "evaluate": Stage(
        "pipeline.evaluation.evaluate",
        EvaluateOptions,
        _check,
        headings={"Evaluation, by stages=evaluate": EvaluateOptions},
        next_step=_next_step,
        idle=_idle,
    )
}
