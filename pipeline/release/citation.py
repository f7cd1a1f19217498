"""How to cite a dataset: the paper that defines the benchmark, and the software that made it."""

from __future__ import annotations

from typing import Any

import yaml

from labyrinth_core.version import __version__
from pipeline.machinery.front_matter import DEVELOPERS, LICENCE
from pipeline.release.provenance import (
    LICENCE_URL,
    PAPER_AUTHORS,
    PAPER_TITLE,
    PAPER_URL,
    PAPER_VENUE,
    PAPER_YEAR,
    Release,
)


def paper_bibtex() -> str:
    """Return the BibTeX entry of the paper."""
    authors = " and ".join(f"{family}, {given}" for family, given in PAPER_AUTHORS)
    return f"""@inproceedings{{gavenski{PAPER_YEAR}quantifying,
  title     = {{{PAPER_TITLE}}},
  author    = {{{authors}}},
  booktitle = {{{PAPER_VENUE}}},
  year      = {{{PAPER_YEAR}}},
  url       = {{{PAPER_URL}}}
}}"""


def software_bibtex() -> str:
    """Return the BibTeX entry of this software."""
    return f"""@software{{labyrinth_datasets,
  title   = {{Labyrinth datasets}},
  author  = {{{{{DEVELOPERS}}}}},
  version = {{{__version__}}}
}}"""


def citation_file(release: Release) -> str:
    """Return the CITATION.cff of a dataset (https://citation-file-format.github.io, 1.2.0)."""
    values: dict[str, Any] = {
        "cff-version": "1.2.0",
        "title": "Labyrinth",
        "message": "If you use this dataset, please cite the paper that defines the benchmark.",
        "type": "dataset",
    }
    if release.licence == LICENCE:  # Of another only the Hub's name is known, not that of SPDX.
        values |= {"license": "MIT", "license-url": LICENCE_URL}
    values["authors"] = [{"name": DEVELOPERS}]
    if release.version:
        values["version"] = release.version
    if release.repo_id:
        values["url"] = release.url
    authors = [{"family-names": family, "given-names": given} for family, given in PAPER_AUTHORS]
    values["preferred-citation"] = {
        "type": "conference-paper",
        "title": PAPER_TITLE,
        "authors": authors,
        "year": PAPER_YEAR,
        "collection-title": PAPER_VENUE,
        "url": PAPER_URL,
    }
    software = {"type": "software", "title": "Labyrinth datasets"}
    values["references"] = [software | {"authors": [{"name": DEVELOPERS}], "version": __version__}]
    return yaml.safe_dump(values, sort_keys=False, allow_unicode=True, width=100)
