"""The texts of cards, as files in this folder; code fills in their fields, such as `$name`."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from string import Template

import yaml

from labyrinth_core.version import DEVELOPERS, __version__


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
