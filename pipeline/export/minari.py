"""Export as Minari datasets (https://minari.farama.org), written by the library itself.

An episode keeps the `reset` options with which the recovered environment can replay it. Pictures
are raw arrays, because JPEG would change the observed pixels.
"""

from __future__ import annotations

import errno
import os
import shutil
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labyrinth_core.version import DEVELOPERS, __version__
from pipeline.config import ExportOptions
from pipeline.export.stage import PART_BYTES, Split, in_parts

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec
    from minari.data_collector import EpisodeBuffer

NEEDS = ("minari", "h5py")

EPISODE_BYTES = 1 << 17
"""An upper bound on HDF5's bytes per episode, besides its text and three times its pictures."""


def write(split: Split, folder: Path) -> None:
    """Write a split into an empty folder, in Minari's format.

    Raises:
        OSError: The files cannot be written.
    """
    import minari

    folder = folder.absolute()  # Minari concatenates relative paths.
    with _placed_in(folder), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # About addresses and scores, which we do not have.
        storage = minari.create_dataset_from_buffers(
            split.id,
            [],
            env=_environment(split),
            algorithm_name=split.demonstrator,
            author={DEVELOPERS},
            description=split.description,
            requirements=[f"labyrinth-datasets>={__version__}"],
            data_format="hdf5",
            jpeg_encoding=False,
        ).storage
    for batch in in_parts(_episodes(split), PART_BYTES):
        _check_disk(folder, batch)
        storage.update_episodes(batch)
    storage.update_metadata({"licence": split.licence, "labyrinth": split.record()})
    (folder / split.id / "data").replace(folder / "data")
    shutil.rmtree(folder / ExportOptions.NAMESPACE)


def _episodes(split: Split) -> Iterator[tuple[int, EpisodeBuffer]]:
    """Yield, for each episode of a split, the bytes of its pictures and the episode."""
    from minari.data_collector import EpisodeBuffer

    for episode in split.episodes():
        options: dict[str, Any] = {"labyrinth": episode.info}  # `reset` replays it, with its end.
        if episode.truncated:
            options["max_episode_steps"] = len(episode)
        terminations, truncations = [[False] * len(episode) for _ in range(2)]
        terminations[-1], truncations[-1] = episode.terminated, episode.truncated
        buffer = EpisodeBuffer(
            options=options,
            observations=episode.observations,
            actions=episode.actions,
            rewards=episode.rewards,
            terminations=terminations,
            truncations=truncations,
            infos={},
        )
        yield episode.observations.nbytes, buffer


def _check_disk(folder: Path, batch: list[EpisodeBuffer]) -> None:
    """Raise an OSError if the disk is too full for a batch; HDF5 would crash while writing."""
    needed = sum(
        3 * each.observations.nbytes + len(each.options["labyrinth"].encode()) + EPISODE_BYTES
        for each in batch
    )
    if shutil.disk_usage(folder).free < needed:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _environment(split: Split) -> EnvSpec:
    """Return the specification of a split's environment, which samples labyrinths by default."""
    import gymnasium

    config = split.manifest.config
    environment = gymnasium.make(
        "labyrinth_core.env:Labyrinth-v0",
        size=f"{config.height}x{config.width}",
        task=str(config.task),
        image_size=split.image_size,
        max_episode_steps=split.step_limit,
    )
    assert environment.spec is not None
    return environment.spec


@contextmanager
def _placed_in(folder: Path) -> Iterator[None]:
    """Let Minari write datasets into `folder` instead of the user's folder."""
    name = "MINARI_DATASETS_PATH"
    before = os.environ.get(name)
    os.environ[name] = str(folder)
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before
