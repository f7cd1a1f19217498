"""Datasets of Minari: seeds, first observations and action sequences on both sides of a split."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

import numpy as np

from labyrinth_core.benchmarks.certificate import Certificate
from labyrinth_core.benchmarks.encoding import digest, encode
from labyrinth_core.benchmarks.environment import CertifyError, EnvironmentFailure, called
from labyrinth_core.benchmarks.records import Split

PREFIX = "minari:"
TRAIN_SHARE = 0.8
"""The share of the episodes that are train by default, the first ones."""
MEASURES = ("seeds", "first", "actions")


def certify_minari(source: str, train: object, test: object) -> Certificate:
    """Return the certificate of a dataset of Minari, or of two.

    Args:
        source: `minari:` and the id of a dataset, which is downloaded if it is missing.
        train: The share of its episodes that are train, the first ones; 0.8 if None.
        test: `minari:` and the id of the dataset with the episodes of test; None for the rest.

    Raises:
        CertifyError: An argument has a value that is not allowed, or a dataset cannot be read.
    """
    episodes = _episodes(source)
    arguments: dict[str, Any] = {"environment": source}
    if test is not None:
        if train is not None or not str(test).startswith(PREFIX):
            raise CertifyError(f"test={test}: give another dataset as minari:ID, and no train")
        of_train, of_test = episodes, _episodes(str(test))
        arguments["test"] = test
    else:
        share = _share(train)
        cut = round(share * len(episodes))
        of_train, of_test = episodes[:cut], episodes[cut:]
        arguments["train"] = share
        if not of_train or not of_test:
            text = f"train={share}: {len(episodes)} episodes leave {len(of_test)} for test"
            raise CertifyError(f"{source}: {text}")
    reasons = {}
    if any(seed is None for seed, *_ in [*of_train, *of_test]):
        reasons["seeds"] = "the dataset does not record the seed of each episode"
    return Certificate(
        environment=source + ("" if test is None else f" and {test}"),
        arguments=arguments,
        versions={name: version(name) for name in ("minari", "labyrinth-datasets")},
        train=_as_split(of_train, 0, reasons),
        test=_as_split(of_test, len(of_train), reasons),
        reasons=reasons,
        unit="episode",
    )


def _share(value: object) -> float:
    try:
        share = TRAIN_SHARE if value is None else float(str(value))
    except ValueError:
        share = 0
    if not 0 < share < 1:
        raise CertifyError(f"train={value}: give the share of the episodes that are train, as 0.8")
    return share


def _as_split(
    episodes: list[tuple[int | None, int, int]], first: int, reasons: dict[str, str]
) -> Split:
    columns = zip(*episodes, strict=True)
    digests = {
        measure: np.array(column, np.uint64)
        for measure, column in zip(MEASURES, columns, strict=True)
        if measure not in reasons
    }
    return Split(tuple(range(first, first + len(episodes))), digests)


def _episodes(source: str) -> list[tuple[int | None, int, int]]:
    """Return the digests of seed, first observation and actions of each episode of a dataset."""
    name = source.removeprefix(PREFIX)
    try:
        import minari
    except ImportError as error:
        install = "pip install 'labyrinth-datasets[minari]'"
        raise CertifyError(f"{source}: Minari is not installed: {install}") from error
    digests = []
    try:  # A dataset, its files and its server may fail in any way.
        episodes = _read(called(minari.load_dataset, name, download=True))
        while (episode := called(next, episodes, None)) is not None:
            seed, *values = episode
            known = seed is not None and np.asarray(seed).dtype.kind in "iu"
            code = digest(encode(int(np.asarray(seed)))) if known else None
            first, actions = (digest(encode(value)) for value in values)
            digests.append((code, first, actions))
    except EnvironmentFailure as error:
        raise CertifyError(f"{source} cannot be read: {error}") from error
    return digests


def _read(dataset: Any) -> Iterator[tuple[Any, Any, Any]]:
    """Yield the seed, the first observation and the actions of each episode."""
    for episode in dataset.iterate_episodes():
        (metadata,) = dataset.storage.get_episode_metadata([episode.id])
        yield metadata.get("seed"), _at(episode.observations, 0), episode.actions


def _at(values: Any, index: int) -> Any:
    """Return one observation from the arrays, dictionaries and tuples of an episode's."""
    if isinstance(values, dict):
        return {key: _at(item, index) for key, item in values.items()}
    if isinstance(values, tuple):
        return tuple(_at(item, index) for item in values)
    return values[index]
