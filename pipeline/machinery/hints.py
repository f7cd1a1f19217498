"""Suggested next steps: command lines to paste into a shell, bash or zsh."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterable
from pathlib import Path

from labyrinth_core.data.storage import RemotePath
from pipeline.config.run import Run

DESCRIBE = "stages=[validate,analyse,card]", "check every row and describe the dataset"
LOOK = "stages=report", "look at it in a browser"
LEARN = "stages=[train,evaluate] method=bc", "train a policy on it"
COMPARE = "stages=results", "compare it with others"
"""The options of each possible next step, and its purpose."""

_OF_ONE_RUN = (
    *("stages", "overwrite", "grow", "part", "policy", "evaluation"),
    *("certify", "publish", "export"),
)
"""Options, and groups of options, that the next command line does not repeat."""


def hints(run: Run, given: Iterable[str], flags: Iterable[str] = ()) -> list[str]:
    """Return the lines that suggest a next step after a build, an evaluation or a publication.

    Args:
        run: The run.
        given: The options of its command line, each as `name=value`.
        flags: The flags of its command line that choose the configuration.
    """
    options, last = run.options, run.options.stages[-1]
    if last == "publish" and not options.publish.dry_run:
        takes = {
            "load_transitions takes the id of the dataset": options.publish.repo_id,
            "load_policy takes the id of the policy": options.publish.model,
        }
        return [f"Next: {line}, from any machine." for line, id_ in takes.items() if id_]
    if last == "evaluate" and not options.evaluate_on:
        added, purpose = COMPARE
    elif last == "build" and run.part is None:
        added, purpose = DESCRIBE
    elif last == "card" and "build" in options.stages:
        added, purpose = LEARN if isinstance(run.data_dir, RemotePath) else LOOK
    else:
        return []
    typed = [re.sub(r"^method\.name=", "method=", each) for each in given]
    more = added.split()
    left_out = {*_OF_ONE_RUN, *(each.partition("=")[0] for each in more)}
    names = {each: each.lstrip("+~").partition("=")[0].split(".")[0] for each in typed}
    kept = [each for each, name in names.items() if name not in left_out]
    if not any(each.startswith("size=") for each in kept):
        kept = [f"size={options.size}", *kept]
    script = Path(sys.argv[0]).name == "run.py"
    program = f"python {shlex.quote(sys.argv[0])}" if script else "labyrinth-datasets"
    return [f"Next, to {purpose}: {program} {shlex.join([*flags, *kept, *more])}"]
