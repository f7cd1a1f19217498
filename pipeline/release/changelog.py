"""The changelog of a dataset: an entry for what is there, above those that were there before."""

from __future__ import annotations

import re

from labyrinth_core.data.manifest import Manifest

_TITLE = """# Changelog

What each version of the dataset holds. A fingerprint is one of all values and pixels of a config,
whichever library compressed them."""

_NEW = "Unreleased"
_GENERATED = re.compile(r"- `[^`]+`: .* rows, fingerprint `[0-9a-f]{64}`")


def updated(text: str, manifests: list[Manifest], version: str | None) -> str:
    """Return the changelog with an entry for the datasets of a folder.

    The entry "Unreleased" is the one that changes with the data, and becomes that of a version
    when there is one. Other entries, and lines that a person adds to any, stay as they are.

    Args:
        text: The changelog so far, empty if there is none.
        manifests: The manifests of all datasets of the folder.
        version: The version of the release, if it is one.
    """
    title, entries = _parse(text)
    lines = [_line(manifest) for manifest in manifests]
    newest = entries[0][1] if entries else []
    same = [line for line in newest if _GENERATED.fullmatch(line)] == lines
    if same and version is None:
        return text
    heading = version or _NEW
    replaced = [line for name, body in entries if name in (heading, _NEW) for line in body]
    of_person = [line for line in replaced if line and not _GENERATED.fullmatch(line)]
    kept = [(name, body) for name, body in entries if name not in (heading, _NEW)]
    entries = [(heading, ["", *lines, *of_person]), *kept]
    parts = [title, *("\n".join([f"## {name}", *body]).rstrip() for name, body in entries)]
    return "\n\n".join(parts) + "\n"


def is_generated(text: str) -> bool:
    """Return whether a text is such a changelog, whatever a person has added to it."""
    return any(_GENERATED.fullmatch(line) for line in text.splitlines())


def _parse(text: str) -> tuple[str, list[tuple[str, list[str]]]]:
    """Return the text above the first entry, and the heading and lines of each entry."""
    title, *parts = re.split(r"^## ", text, flags=re.MULTILINE)
    entries = []
    for part in parts:
        heading, *body = part.splitlines()
        entries.append((heading.strip(), body))
    return title.strip() or _TITLE, entries


def _line(manifest: Manifest) -> str:
    rows = sum(shard.rows for shard in manifest.shards)
    return f"- `{manifest.config.name}`: {rows:,} rows, fingerprint `{manifest.fingerprint}`"
