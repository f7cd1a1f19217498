"""The texts of cards, as files in this folder, and facts that fill their fields, such as `$code`.

The facts are where a dataset comes from: its command, the code that made it, its name on the Hub.
"""

from __future__ import annotations

import shlex
import subprocess
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from string import Template
from textwrap import wrap

import yaml

from labyrinth_core.data import DatasetConfig
from labyrinth_core.version import DEVELOPERS, __version__
from pipeline.inspection import front_matter
from pipeline.machinery import plain


@dataclass(frozen=True)
class Release:
    """The release that a card is written for."""

    repo_id: str | None = None
    """The id on the Hub, such as `user/labyrinth`."""
    version: str | None = None
    export: str | None = None
    """The id of its export on the Hub, if the same command publishes one."""
    licence: str = front_matter.LICENCE
    """The licence that the card names, as the Hub spells it."""

    @property
    def name(self) -> str:
        """The id to write in examples, `user/labyrinth` for a dataset that is not on the Hub."""
        return self.repo_id or "user/labyrinth"

    @property
    def url(self) -> str:
        """The page of the dataset on the Hub; README.md if it is not there yet."""
        if self.repo_id is None:
            return "README.md"
        return f"https://huggingface.co/datasets/{self.repo_id}"


def command(config: DatasetConfig) -> str:
    """Return the command line that makes a dataset, with every option."""
    options: dict[str, object] = {
        "size": f"{config.height}x{config.width}",
        "task": config.task,
        "labyrinths": config.labyrinths,
        "solutions": config.solutions,
        "solutions_limit": config.solutions_limit,
        "random_steps": config.random_steps,
        "sampler": config.sampler,
        "open_walls": config.open_walls,
        "buckets": config.buckets,
        "splits.min_walls": config.min_walls,
        "seed": config.seed,
    }
    options |= config.unusual_options()
    given = [
        f"{name}=[{','.join(map(str, value))}]" if isinstance(value, tuple) else f"{name}={value}"
        for name, value in options.items()
    ]
    return shlex.join(["labyrinth-datasets", *given])


def command_lines(config: DatasetConfig) -> str:
    """Return the command line that makes a dataset, on lines that fit a page."""
    lines = wrap(
        command(config), 92, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )
    return " \\\n".join(lines)


def code() -> str:
    """Return the version of this code and, in a clone of the repository, the commit."""
    version = f"labyrinth-datasets {__version__}"
    root = Path(__file__).parents[3]
    # An installation may lie in the repository of another project.
    if not (root / ".git").exists():
        return version
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return version
    commit, changed, _ = done.stdout.strip().partition("-dirty")
    return f"{version}, git commit `{commit}`{' with changes' if changed else ''}"


def verbatim(text: object) -> str:
    """Return a text as code that is safe in a table; as `plain` text if it has a backtick."""
    shown = " ".join(str(text).split())
    return plain(shown) if "`" in shown else "`" + shown.replace("|", r"\|") + "`"


def read(name: str) -> str:
    """Return the content of a file of this folder."""
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


def fill(name: str, /, **fields: object) -> str:
    """Return the text of a file with all its fields filled in."""
    return Template(read(name)).substitute(fields)


def paragraph(name: str, /, **fields: object) -> str:
    """Return a paragraph of `paragraphs.yaml` with its fields filled in."""
    return Template(_paragraphs()[name]).substitute(fields)


@cache  # Parsing the file for each paragraph took a third of the time of a small card.
def _paragraphs() -> dict[str, str]:
    return dict(yaml.safe_load(read("paragraphs.yaml")))


def citation() -> str:
    """Return the BibTeX entries of the paper and of this software."""
    return fill("citation.bib", developers=DEVELOPERS, version=__version__).strip()
