"""The stage `evaluate` where `policy=` names a policy: what it achieves, printed and kept.

The results lie in `<run_dir>/<config>/<name>/results.json`.
"""

from __future__ import annotations

import re
from pathlib import Path

from labyrinth_core import evaluate
from labyrinth_core.evaluation.answers import PolicyError
from pipeline.config.errors import ConfigError
from pipeline.config.run import Run
from pipeline.evaluation.named import named_policy
from pipeline.machinery.console import say
from pipeline.machinery.dataset import fingerprint_of

RESULTS = "results.json"


def run(run: Run) -> None:
    """Evaluate the policy that is named.

    Raises:
        ConfigError: There is no such policy, or an option is impossible.
        DatasetError: There is no such archive or dataset, or a split is missing.
        PolicyError: The policy raises an error, or answers with anything but actions.
    """
    options, asked = run.options, run.options.evaluation
    name = asked.name.strip() or Path(options.policy).name.removesuffix(".zip")
    folder = Path(options.run_dir).expanduser() / run.dataset.name / _as_file_name(name)
    fingerprint_of(run)  # Says how the dataset is made, if there is none.
    policy = named_policy(options.policy)
    try:
        results = evaluate(
            policy,
            run.source,
            run.dataset.name,
            observation=options.observation,
            image_size=asked.image_size,
            episodes=asked.episodes,
            seed=options.seed,
            splits=asked.splits or None,
            revision=options.revision,
        )
        results.save(folder / RESULTS, name=name, url=asked.url, budget=asked.budget)
    except PolicyError:
        raise
    except ValueError as error:
        raise ConfigError(str(error)) from error
    say(f"{name}\n{results}\n{folder / RESULTS}")


def _as_file_name(name: str) -> str:
    """Return a name without what file systems and shells do not like."""
    return re.sub(r"[^\w.-]+", "-", name).strip("-.") or "policy"
