"""What a user can do next: command lines to paste into a shell, bash or zsh."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable
from pathlib import Path

from labyrinth_core.data.storage import RemotePath
from pipeline.config.run import Run

LEARN = "stages=[train,evaluate] method=bc"
NEXT = {
    "build": {"stages=[validate,analyse,card]": "replay every row, and describe the dataset"},
    "questions": {"stages=[validate,card]": "replay every row, and describe the dataset"},
    "validate": {"stages=[analyse,card]": "compare the splits, and describe them"},
    "analyse": {"stages=card": "describe the dataset", "stages=report": "look at it in a browser"},
    "card": {
        "stages=report": "look at it in a browser",
        LEARN: "learn from it (at 5x5 some minutes)",
    },
    "report": {
        LEARN: "learn from a dataset (at 5x5 some minutes)",
        "stages=publish publish.repo_id=you/labyrinth publish.version=1.0.0": "share them",
    },
    "train": {"stages=evaluate": "judge the policy on every split"},
    "evaluate": {
        "stages=results": "compare it with others",
        "stages=report": "see where it fails",
    },
    "results": {"stages=report": "see in which labyrinths each method fails"},
}
"""Stage -> the options of what can be done after it, and what that is for."""

_OF_ONE_RUN = (
    *("stages", "overwrite", "grow", "part", "policy"),
    *("leakage", "analysis", "publish", "export"),
)
"""Options, and groups of options, that are not repeated for what comes next."""


def hints(run: Run, given: Iterable[str]) -> list[str]:
    """Return the lines that say what can be done after a run.

    Args:
        run: The run.
        given: The options of its command line, each as `name=value`.
    """
    options, last = run.options, run.options.stages[-1]
    if last == "publish" and not options.publish.dry_run:
        takes = {
            "load_transitions takes the id of the dataset": options.publish.repo_id,
            "load_policy takes the id of the policy": options.publish.model,
        }
        return [f"Next: {line}, from any machine." for line, id_ in takes.items() if id_]
    if last == "export":
        return ["Next: docs/clients.md has the lines that load it with each library."]
    if last == "environments":
        return ["Next: docs/studies/environments.md says what the tables mean."]
    if options.leakage.source is not None or run.part is not None:
        return []
    kept = [each for each in given if each.partition("=")[0].split(".")[0] not in _OF_ONE_RUN]
    if not any(each.startswith("size=") for each in kept):
        kept = [f"size={options.size}", *kept]
    script = Path(sys.argv[0]).name == "run.py"
    program = f"python {shlex.quote(sys.argv[0])}" if script else "labyrinth-datasets"
    lines = []
    for added, purpose in NEXT.get(last, {}).items():
        more = added.split()
        if "stages=report" in more and (options.policy or isinstance(run.data_dir, RemotePath)):
            continue
        names = {each.partition("=")[0] for each in more}
        same = [each for each in kept if each.partition("=")[0] not in names]
        lines += [f"Next, to {purpose}:", f"  {program} {shlex.join([*same, *more])}"]
    return lines
