"""Trajectories for the library imitation: a Hugging Face dataset with a row for each episode.

The columns are those of `imitation.data.huggingface_utils` of https://pypi.org/project/imitation/,
1.0.1, whose `imitation.data.serialize.load` reads the folder. It would write pictures as lists of
numbers, which it reads back as int64; those that are PNG files it reads as they were, and sooner.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from labyrinth_core.data.storage import write_text
from labyrinth_core.data.transitions import LoadedEpisode
from pipeline.export.picture import image_value
from pipeline.export.split import Split

PART_BYTES = 16 << 20
"""The bytes of PNG files that a file has at least, but for the last."""


def write(split: Split, folder: Path) -> None:
    """Write a split into an empty folder, as `Dataset.save_to_disk` does, with a file a part."""
    import datasets

    features = datasets.Features(
        {
            "obs": datasets.List(datasets.Image()),
            "acts": datasets.List(datasets.Value("int64")),
            "infos": datasets.List(datasets.Value("string")),
            "terminal": datasets.Value("bool"),
            "rews": datasets.List(datasets.Value("float32")),
        }
    )
    facts = {"description": split.description, "license": split.licence}
    info = datasets.DatasetInfo(features=features, **facts)
    names: list[str] = []
    state: dict[str, Any] = {}
    with _without_bars():
        for part in _parts(split):
            place = folder / "part"
            datasets.Dataset.from_list(part, info=info).save_to_disk(place, num_shards=1)
            state = json.loads((place / "state.json").read_bytes())
            (file,) = state["_data_files"]
            names.append(f"data-{len(names):05d}.arrow")
            (place / file["filename"]).replace(folder / names[-1])
            (place / "dataset_info.json").replace(folder / "dataset_info.json")
            shutil.rmtree(place)
    state["_data_files"] = [{"filename": name} for name in names]
    write_text(folder / "state.json", json.dumps(state, indent=2, sort_keys=True))


def _parts(split: Split) -> Iterator[list[dict[str, Any]]]:
    """Yield the rows of consecutive episodes."""
    rows: list[dict[str, Any]] = []
    held = 0
    for episode in split.episodes():
        rows.append(_row(episode))
        held += sum(len(picture["bytes"]) for picture in rows[-1]["obs"])
        if held >= PART_BYTES:
            yield rows
            rows, held = [], 0
    if rows:
        yield rows


def _row(episode: LoadedEpisode) -> dict[str, Any]:
    """Return the row of an episode; the labyrinth is in the info of the first step."""
    return {
        "obs": [image_value(picture) for picture in episode.observations],
        "acts": episode.actions,
        "infos": [json.dumps({"labyrinth": episode.info}), *["{}"] * (len(episode) - 1)],
        "terminal": episode.terminated,
        "rews": episode.rewards,
    }


@contextmanager
def _without_bars() -> Iterator[None]:
    """Keep `datasets` from drawing its own progress bars."""
    import datasets

    if datasets.are_progress_bars_disabled():
        yield
        return
    datasets.disable_progress_bars()
    try:
        yield
    finally:
        datasets.enable_progress_bars()
