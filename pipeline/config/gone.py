"""Removed options and values of options, each with what to do instead."""

from __future__ import annotations

GONE = {
    "demonstrations.pieces": "cut episodes after loading, as docs/loading.md shows",
    "analysis": "run scripts/studies/compare_environments.py in a clone",
    "publish.branch": "publish to main, and make the branch from the tag with the Hub's client",
    "publish.collection": "add the repository to a collection with the Hub's own button",
    "publish.create_pr": "publish to a repository of your own, or upload with the Hub's client",
    "publish.space": "upload report/index.html to a static Space with the Hub's own button",
    "executor=ray": "give executor=dask, or part=i/n in jobs of your own",
    "memory": "docs/results/ARCHIVE.md names the commit that has policies with a memory",
    **{
        f"method=authors/{name}": "in a clone give protocol=authors "
        f"method=scripts.studies.methods.authors.{name}:Method"
        for name in ("bc", "bco", "dagger", "gail", "iupe", "sqil")
    },
    "method=vin": "docs/results/ARCHIVE.md names the commit that has the method",
    "method=walls": "docs/results/ARCHIVE.md names the commit that has the method",
    "pool_stride": "it is always 1; docs/results/ARCHIVE.md names the commit that has 2",
    "precision": "training is in float32; docs/results/ARCHIVE.md names the commit that has bf16",
    "stages=environments": "run scripts/studies/compare_environments.py in a clone",
}
"""An option, a group of options, or `option=value` -> what to do instead, as a clause."""


def instead(name: str, *values: object) -> str | None:
    """Return one line about an option or value that was removed, or None if none was.

    Args:
        name: The full name of an option, such as `analysis.seeds`.
        values: The values given for it.
    """
    for given in (name, name.partition(".")[0], *(f"{name}={value}" for value in values)):
        if given in GONE:
            shown = given if "=" in given else name
            return f"{shown} was removed: {GONE[given]}"
    return None
