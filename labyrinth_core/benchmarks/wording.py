"""A certificate in words: for a terminal, for Markdown, and one sentence for a paper."""

from __future__ import annotations

from collections.abc import Iterator

from labyrinth_core.benchmarks.figures import Figures
from labyrinth_core.benchmarks.levels import Share, percent
from labyrinth_core.benchmarks.seeds import text_of

FAILED_SHOWN = 5
"""The maximum number of failed seeds of a split that are named."""
LONGEST_SEEDS = 60
"""The maximum length of the text of a split's seeds."""

NAMES = {
    "first": "first observation",
    "probes": "probes",
    "state": "state",
    "seeds": "recorded seed",
    "actions": "whole action sequence",
}
"""Measure -> what is in train."""

CLAUSES = {
    "first": "{} begin with the first observation of a training {unit}",
    "probes": "{} cannot be told from a training {unit} along {probes}",
    "state": "{} have the state of a training {unit}",
    "seeds": "{} were recorded with the seed of a training {unit}",
    "actions": "{} repeat the whole action sequence of a training {unit}",
}
"""Measure -> a clause about test."""


def _probes(certificate: Figures) -> str:
    """Return how the probes were made."""
    asked = certificate.arguments
    if "probes" not in asked:
        return "the recorded probes"
    sequences = f"{asked['probes']} random action sequence{'' if asked['probes'] == 1 else 's'}"
    return f"{sequences} of {asked['steps']} step{'' if asked['steps'] == 1 else 's'}"


def _split(certificate: Figures, name: str) -> str:
    split = certificate.train if name == "train" else certificate.test
    seeds = text_of(split.seeds) if certificate.unit == "seed" else ""
    shown = f" ({seeds})" if 0 < len(seeds) <= LONGEST_SEEDS else ""
    count = len(split.seeds)
    return f"{count:,} {name} {certificate.unit}{'' if count == 1 else 's'}{shown}"


def rows(certificate: Figures) -> Iterator[tuple[str, str]]:
    """Yield the label and the text of each line of a certificate."""
    for measure, share in certificate.measures.items():
        yield NAMES[measure], f"{share} of test in train"
    for measure, reason in certificate.reasons.items():
        yield NAMES[measure], f"no share: {reason}"
    if certificate.levels is not None:
        yield "levels", str(certificate.levels)
        yield "curve", _curve(certificate, certificate.levels.by)
    if (spread := certificate.spread) is not None:
        yield (
            "spread",
            f"two first observations are {100 * spread.share:.2g}% of a value's range apart "
            f"(of {spread.seeds:,} seeds; number of values that change: {spread.values:,})",
        )
    if (memory := certificate.memory) is not None:
        yield "memory", f"solves {memory.memory}; {memory.known} begin like a demonstration"
        if memory.policy is not None:
            yield "the policy", f"solves {memory.policy}"
        yield "random actions", f"solve {memory.random}"
    if certificate.levels is not None:
        disjoint = len(certificate.disjoint(0))
        yield "disjoint", f"{disjoint:,} test {certificate.unit}s, neither in train nor repeated"
    if certificate.checked:
        yield f"{certificate.unit}s", certificate.checked
    for note in certificate.notes:
        yield "note", note
    for name, split in (("train", certificate.train), ("test", certificate.test)):
        for seed, reason in split.failed[:FAILED_SHOWN]:
            yield "failed", f"{name} seed {seed}: {reason}"
        if len(split.failed) > FAILED_SHOWN:
            yield "failed", f"and {len(split.failed) - FAILED_SHOWN:,} more of {name}"


def _curve(certificate: Figures, by: str) -> str:
    of = len(certificate.test.seeds)
    points = [
        f"{percent(count / of)}% with {m:,}"
        for m, count in certificate.curves[by]
        if m >= 10 or m == len(certificate.train.seeds)
    ]
    return f"of test in train, with so many train {certificate.unit}s: {', '.join(points)}"


def title(certificate: Figures) -> str:
    """Return the name of the environment and the sizes of its splits."""
    splits = ", ".join(_split(certificate, name) for name in ("train", "test"))
    return f"{certificate.environment}: {splits}"


def text(certificate: Figures) -> str:
    """Return the certificate for a terminal."""
    lines = [*rows(certificate)]
    width = max(len(label) for label, _ in lines)
    return "\n".join([title(certificate), *(f"  {a:{width}}  {b}" for a, b in lines)])


def markdown(certificate: Figures) -> str:
    """Return the certificate as a Markdown section."""
    cells = [(a, b.replace("|", r"\|")) for a, b in rows(certificate)]
    lines = [f"| {a} | {b} |" for a, b in cells]
    table = "\n".join(["| | |", "|---|---|", *lines])
    return f"## {title(certificate)}\n\n{sentence(certificate)}\n\n{table}\n"


def sentence(certificate: Figures) -> str:
    """Return what to write in a paper."""
    unit = certificate.unit
    versions = ", ".join(f"{name} {value}" for name, value in certificate.versions.items())
    of = certificate.environment + (f" ({versions})" if versions else "")
    if not certificate.measures:
        reason = next(iter(certificate.reasons.values()), "nothing was recorded")
        return f"The share of test levels of {of} in train cannot be given: {reason}."
    clauses = [
        CLAUSES[measure].format(_counted(share), unit=unit, probes=_probes(certificate))
        for measure, share in certificate.measures.items()
    ]
    listed = ", ".join(clauses[:-1]) + (" and " if clauses[1:] else "") + clauses[-1]
    splits = f"{_split(certificate, 'test')} of {of}, with {_split(certificate, 'train')}"
    parts = [f"Of the {splits}, {listed}"]
    if certificate.levels is not None:
        parts.append(str(certificate.levels))
    parts += [f"no share by {NAMES[measure]} can be given" for measure in certificate.reasons]
    parts += certificate.notes
    return "; ".join(parts) + "."


def _counted(share: Share) -> str:
    low, high = (percent(bound) for bound in share.interval)
    return f"{share.count:,} ({percent(share.share)}%, 95% interval {low} to {high}%)"
