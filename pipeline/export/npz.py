"""The arrays that IL-Datasets reads, the library of the benchmark's authors, in one `.npz` file.

Each state is a row, also the last of an episode, whose action is -1 and whose reward is 0; the
library leaves that row out of its pairs. Source: `imitation_datasets.dataset.BaselineDataset` and
`imitation_datasets.functions.baseline_collate` of https://pypi.org/project/IL-Datasets/, 1.0.0.
"""

from __future__ import annotations

import shutil
from contextlib import ExitStack
from pathlib import Path
from typing import IO
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np
from numpy.lib import format as npy
from numpy.typing import DTypeLike

from labyrinth_core.data.columns import NO_ACTION
from pipeline.export.split import Split

FILE = "episodes.npz"


def write(split: Split, folder: Path) -> None:
    """Write a split into an empty folder: a file with five arrays, for N states in E episodes.

    `obs` uint8 (N, size, size, 3), `actions` int64 (N,), `rewards` float32 (N,), `episode_starts`
    bool (N,), and `episode_returns` float64 (E,).
    """
    with ZipFile(folder / FILE, "w") as archive, ExitStack() as files:

        def begun(name: str, count: int, dtype: DTypeLike) -> IO[bytes]:
            # Only one file at a time can be written into an archive; the small ones wait beside it.
            file = files.enter_context((folder / f"{name}.npy").open("w+b"))
            _begin(file, (count,), dtype)
            return file

        actions = begun("actions", split.rows, np.int64)
        rewards = begun("rewards", split.rows, np.float32)
        starts = begun("episode_starts", split.rows, np.bool_)
        returns = begun("episode_returns", split.count, np.float64)
        with archive.open(_member("obs.npy"), "w", force_zip64=True) as pictures:
            _begin(pictures, (split.rows, split.image_size, split.image_size, 3), np.uint8)
            for episode in split.episodes():
                pictures.write(episode.observations.tobytes())
                actions.write(np.append(episode.actions, NO_ACTION).tobytes())
                rewards.write(np.append(episode.rewards, np.float32(0)).tobytes())
                starts.write((np.arange(len(episode) + 1) == 0).tobytes())
                returns.write(episode.rewards.sum(dtype=np.float64).tobytes())
        for file in (actions, rewards, starts, returns):
            file.seek(0)
            path = Path(file.name)
            with archive.open(_member(path.name), "w", force_zip64=True) as member:
                shutil.copyfileobj(file, member)
            path.unlink()


def _member(name: str) -> ZipInfo:
    """Return a member of the archive that has no time, so that equal arrays are equal files."""
    member = ZipInfo(name)
    member.compress_type = ZIP_DEFLATED
    return member


def _begin(file: IO[bytes], shape: tuple[int, ...], dtype: DTypeLike) -> None:
    """Write the header of a `.npy` file, to which the values are then appended."""
    descr = npy.dtype_to_descr(np.dtype(dtype))
    npy.write_array_header_2_0(file, {"descr": descr, "fortran_order": False, "shape": shape})
