"""A dataset, from a folder or the Hub, back into episodes and transitions (s, a, s').

    from pipeline.loader import load_transitions

    transitions = load_transitions("data/labyrinth", "5x5", split="train", image_size=64)
    s, a, s_next = transitions[0]

No pair ever crosses the end of an episode, and the last state of one begins no pair. Everything
that comes from a file or from the Hub is data: it is parsed, never evaluated.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.dynamics import is_terminal
from labyrinth_core.labyrinth import Labyrinth
from labyrinth_core.language import labyrinth_id, parse
from labyrinth_core.renderer import PICTURE_SIZE, area_average
from labyrinth_core.rollout import replay
from labyrinth_core.vector import vector_observation
from pipeline.manifest import MANIFEST, DatasetError, Manifest, Shard, file_sha256
from pipeline.schema import NO_ACTION

OBSERVATIONS = ("image", "vector")
DEFAULT_IMAGE_SIZE = 64
"""Pixels on each side that the benchmark's baselines look at (supplement, section 1)."""

CACHED_BYTES = 64 * 2**20
"""Of decoded pictures that are remembered."""

_HUB_ID = re.compile(r"(?!.*(--|\.\.))\w[\w.-]*/\w[\w.-]*", re.ASCII)


@dataclass(frozen=True, eq=False)
class LoadedEpisode:
    """One episode as it was read."""

    labyrinth_id: int
    info: str
    """The labyrinth in the text language."""
    observations: NDArray[Any]
    """Of the T + 1 states: uint8 (T + 1, size, size, 3), or int32 (T + 1, length) vectors."""
    actions: NDArray[np.int64]
    """Shape (T,)."""
    rewards: NDArray[np.float32]
    """Shape (T,)."""
    terminated: bool
    """Whether it ends on the goal or on ice, instead of being cut."""

    def __len__(self) -> int:
        """Return the number of transitions."""
        return len(self.actions)


class Transition(NamedTuple):
    """One step: state, action, next state."""

    observation: NDArray[Any]
    action: int
    next_observation: NDArray[Any]


@dataclass(frozen=True, eq=False)
class Transitions:
    """All transitions of a split, in order; a map-style dataset for a `DataLoader`.

    Each state is kept once, so that a state and the next share their memory with the pairs before
    and after.
    """

    frames: NDArray[Any]
    """Observations of all states, shape (M, ...), of all episodes one after the other."""
    rows: NDArray[np.int64]
    """Where in `frames` each transition begins, shape (N,); it leads to the frame after."""
    actions: NDArray[np.int64]
    """Shape (N,)."""
    rewards: NDArray[np.float32]
    """Shape (N,)."""
    dones: NDArray[np.bool_]
    """Whether the transition ends its episode on the goal or on ice, shape (N,)."""
    labyrinth_ids: NDArray[np.int64]
    """The labyrinth each is from, shape (N,); `f"{id:016x}"` is its id elsewhere."""

    def __len__(self) -> int:
        """Return the number of transitions, N."""
        return len(self.rows)

    @property
    def observations(self) -> NDArray[Any]:
        """The states acted in, shape (N, ...); a new array."""
        return self.frames[self.rows]

    @property
    def next_observations(self) -> NDArray[Any]:
        """The states that the actions led to, shape (N, ...); a new array."""
        return self.frames[self.rows + 1]

    def __getitem__(self, index: int) -> Transition:
        """Return one transition; its arrays are views of `frames`."""
        row = self.rows[index]
        return Transition(self.frames[row], int(self.actions[index]), self.frames[row + 1])

    def __getitems__(self, indices: Sequence[int]) -> list[Transition]:
        """Return several transitions, as a `DataLoader` asks for a batch."""
        return [self[index] for index in indices]

    def __iter__(self) -> Iterator[Transition]:
        """Yield all transitions in order."""
        return (self[index] for index in range(len(self)))


def load_transitions(
    source: str | Path,
    config: str,
    *,
    split: str = "train",
    observation: str = "image",
    image_size: int = DEFAULT_IMAGE_SIZE,
    revision: str | None = None,
) -> Transitions:
    """Return all transitions of a split; the arguments are those of `load_episodes`."""
    episodes = list(
        load_episodes(
            source,
            config,
            split=split,
            observation=observation,
            image_size=image_size,
            revision=revision,
        )
    )
    if not episodes:
        raise DatasetError(f"{source} {config} {split}: there is no episode in it")
    lengths = np.array([len(episode) for episode in episodes])
    # An episode has a state more than it has transitions.
    shifts = np.repeat(np.arange(len(episodes)), lengths)
    dones = np.zeros(lengths.sum(), np.bool_)
    dones[np.cumsum(lengths) - 1] = [episode.terminated for episode in episodes]
    ids = np.array([episode.labyrinth_id for episode in episodes], np.int64)
    return Transitions(
        frames=np.concatenate([episode.observations for episode in episodes]),
        rows=np.arange(lengths.sum()) + shifts,
        actions=np.concatenate([episode.actions for episode in episodes]),
        rewards=np.concatenate([episode.rewards for episode in episodes]),
        dones=dones,
        labyrinth_ids=np.repeat(ids, lengths),
    )


def load_episodes(
    source: str | Path,
    config: str,
    *,
    split: str = "train",
    observation: str = "image",
    image_size: int = DEFAULT_IMAGE_SIZE,
    revision: str | None = None,
) -> Iterator[LoadedEpisode]:
    """Yield the episodes of a split, in order.

    Args:
        source: Folder with the dataset, or its id on the Hub such as `user/labyrinth`.
        config: Such as `5x5` or `5x5-key_and_door`.
        split: One of train, validation, test, random, s0, s0_and_g.
        observation: "image" for pictures from `obs`; "vector" for the authors' vector form, made
            from `info` and `actions` alone (see `labyrinth_core.vector`).
        image_size: Pixels on each side of the pictures, area-averaged from 600.
        revision: Branch, tag or commit on the Hub; not for folders.

    Raises:
        ValueError: An argument is none of the allowed values.
        DatasetError: There is no such dataset or split, or its rows do not make episodes.
    """
    _check(observation, image_size)
    folder = locate(source, config, split, revision)
    shards = Manifest.read(folder).of(split)
    columns = ["actions", "rewards", "episode_starts", "info"]
    columns += ["obs.bytes"] if observation == "image" else []
    rows = chain.from_iterable(_read(folder, shard, columns) for shard in shards)
    return _episodes(rows, observation, image_size)


def stream_episodes(
    source: str | Path,
    config: str,
    *,
    split: str = "train",
    observation: str = "image",
    image_size: int = DEFAULT_IMAGE_SIZE,
    revision: str | None = None,
) -> Iterator[LoadedEpisode]:
    """Yield the episodes of a split as they are downloaded, by `load_dataset(streaming=True)`.

    Arguments and errors are those of `load_episodes`.
    """
    _check(observation, image_size)
    folder = _folder(source, config, revision)
    if folder is not None:
        Manifest.read(folder).of(split)  # Or it says which splits there are.
    rows = _stream(str(source if folder is None else folder.parent), config, split, revision)
    return _episodes(rows, observation, image_size)


def stream_transitions(
    source: str | Path,
    config: str,
    *,
    split: str = "train",
    observation: str = "image",
    image_size: int = DEFAULT_IMAGE_SIZE,
    revision: str | None = None,
) -> Iterator[Transition]:
    """Yield the transitions of a split as they are downloaded; as `stream_episodes`."""
    episodes = stream_episodes(
        source,
        config,
        split=split,
        observation=observation,
        image_size=image_size,
        revision=revision,
    )
    return (
        Transition(episode.observations[step], action, episode.observations[step + 1])
        for episode in episodes
        for step, action in enumerate(episode.actions.tolist())
    )


def locate(source: str | Path, config: str, split: str, revision: str | None = None) -> Path:
    """Return the folder with a dataset's manifest and the shards of a split.

    For an id on the Hub they are downloaded to its cache first.

    Raises:
        DatasetError: There is no such folder, or the Hub does not give it.
    """
    return _folder(source, config, revision) or _download(str(source), config, split, revision)


def _folder(source: str | Path, config: str, revision: str | None) -> Path | None:
    """Return the folder with a dataset's manifest, None for an id on the Hub."""
    folder = Path(source).expanduser()
    if folder.is_dir():
        if revision is not None:
            raise ValueError(f"revision={revision}: {source} is a folder, which has no revisions")
        if not (folder / config / MANIFEST).is_file():
            held = sorted(path.parent.name for path in folder.glob(f"*/{MANIFEST}"))
            raise DatasetError(f"config={config}: {source} holds {', '.join(held) or 'none'}")
        return folder / config
    if not _HUB_ID.fullmatch(str(source)):
        raise DatasetError(f"{source} is neither a folder nor an id such as user/labyrinth")
    return None


def _download(source: str, config: str, split: str, revision: str | None) -> Path:
    from huggingface_hub import snapshot_download
    from huggingface_hub.errors import HfHubHTTPError, HFValidationError

    try:
        snapshot = snapshot_download(
            source,
            repo_type="dataset",
            revision=revision,
            allow_patterns=[f"{config}/{MANIFEST}", f"{config}/{split}-*.parquet"],
        )
    except (OSError, HfHubHTTPError, HFValidationError) as error:
        raise _not_from_the_hub(source, error) from error
    return Path(snapshot) / config


def _stream(source: str, config: str, split: str, revision: str | None) -> Iterator[_RawRow]:
    """Return the rows of a split as they are downloaded, whatever ends where."""
    from datasets import Image, load_dataset

    try:
        stream = load_dataset(source, config, split=split, streaming=True, revision=revision)
        # As bytes: what is not decoded by `datasets` is decoded once, here.
        stream = stream.cast_column("obs", Image(decode=False))
    except (OSError, ValueError) as error:
        raise _not_from_the_hub(source, error) from error
    return _stream_rows(source, stream)


def _stream_rows(source: str, stream: Iterable[dict[str, Any]]) -> Iterator[_RawRow]:
    import pyarrow as pa

    try:
        for row in stream:
            yield _RawRow.from_columns(row)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise DatasetError(f"{source} cannot be read: {_one_line(error)}") from error


def _not_from_the_hub(source: str, error: Exception) -> DatasetError:
    return DatasetError(
        f"{source} is no folder (python run.py makes one), and not to be had from the Hub: "
        f"{_one_line(error)}"
    )


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _check(observation: str, image_size: int) -> None:
    if observation not in OBSERVATIONS:
        raise ValueError(f"observation={observation}: choose one of {', '.join(OBSERVATIONS)}")
    if image_size < 1:
        raise ValueError(f"image_size={image_size}: give 1 or more")


class _RawRow(NamedTuple):
    actions: int
    rewards: float
    episode_starts: bool
    info: str
    png: bytes | None

    @classmethod
    def from_columns(cls, row: dict[str, Any]) -> _RawRow:
        for name, kind in _TYPES.items():
            if type(row.get(name)) is not kind:
                raise DatasetError(f"{name}={row.get(name)!r}: every row needs {kind.__name__}")
        picture = row.get("obs")
        png = picture.get("bytes") if isinstance(picture, dict) else None
        return cls(
            row["actions"],
            row["rewards"],
            row["episode_starts"],
            row["info"],
            png if isinstance(png, bytes) else None,
        )


_TYPES = {"actions": int, "rewards": float, "episode_starts": bool, "info": str}


def _read(folder: Path, shard: Shard, columns: list[str]) -> Iterator[_RawRow]:
    """Yield the rows of a shard that is what its manifest says, one row group at a time."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = folder / shard.path
    try:
        if file_sha256(path) != shard.sha256:
            raise DatasetError(f"{path} is damaged: its sha256 is not the manifest's")
        with pq.ParquetFile(path) as file:
            for group in range(file.num_row_groups):
                for row in file.read_row_group(group, columns=columns).to_pylist():
                    yield _RawRow.from_columns(row)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise DatasetError(f"{path} cannot be read: {_one_line(error)}") from error


def _episodes(
    rows: Iterable[_RawRow], observation: str, image_size: int
) -> Iterator[LoadedEpisode]:
    """Yield episodes from rows in order, wherever shards and batches may end."""
    pending: list[_RawRow] = []
    for number, row in enumerate(rows):
        if not pending and not row.episode_starts:
            raise DatasetError(f"row {number} episode_starts: False where an episode must begin")
        if pending and (row.episode_starts or row.info != pending[0].info):
            raise DatasetError(f"row {number}: an episode ends without its last row, actions=-1")
        pending.append(row)
        if row.actions == NO_ACTION:
            if len(pending) == 1:
                raise DatasetError(f"row {number} actions: -1 in the first row of an episode")
            yield _episode(pending, observation, image_size)
            pending = []
    if pending:
        raise DatasetError("the last episode ends without its last row, actions=-1")


def _episode(rows: list[_RawRow], observation: str, image_size: int) -> LoadedEpisode:
    actions = [row.actions for row in rows[:-1]]
    try:
        labyrinth = _parse(rows[0].info)
        episode = replay(labyrinth, actions)
    except ValueError as error:
        reason = str(error).partition("\n")[0]
        raise DatasetError(f"an episode cannot be replayed: {reason}") from error
    if observation == "image":
        decode = _remembering_decoder(image_size)
        observations = np.stack([decode(row.png) for row in rows])
    else:
        observations = np.stack([vector_observation(labyrinth, s) for s in episode.states])
    return LoadedEpisode(
        labyrinth_id=int(labyrinth_id(labyrinth), 16),
        info=rows[0].info,
        observations=observations,
        actions=np.array(actions, np.int64),
        rewards=np.array([row.rewards for row in rows[:-1]], np.float32),
        terminated=is_terminal(labyrinth, episode.states[-1]),
    )


@lru_cache(maxsize=1)
def _parse(info: str) -> Labyrinth:
    """Return the labyrinth of a row; consecutive rows mostly have the same."""
    return parse(info)


@lru_cache(maxsize=1)
def _remembering_decoder(image_size: int) -> Callable[[bytes | None], NDArray[np.uint8]]:
    """Return `_decode` with a memory.

    Decoding takes milliseconds, and a random policy comes back to its states.
    """
    pictures = max(1, CACHED_BYTES // (3 * image_size**2))
    return lru_cache(maxsize=pictures)(partial(_decode, image_size=image_size))


def _decode(png: bytes | None, image_size: int) -> NDArray[np.uint8]:
    """Return a picture, shape (image_size, image_size, 3), area-averaged."""
    from PIL import Image

    if png is None:
        raise DatasetError("obs: a row has no picture")
    try:
        with Image.open(io.BytesIO(png), formats=["PNG"]) as image:
            # Before anything is unpacked, since it may claim to be huge.
            if image.size != (PICTURE_SIZE, PICTURE_SIZE):
                width, height = image.size
                raise ValueError(f"it has {width} x {height} pixels, not {PICTURE_SIZE} each way")
            return area_average(np.asarray(image.convert("RGB")), image_size)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise DatasetError(f"obs: a picture cannot be decoded: {_one_line(error)}") from error
