"""Trajectories for the library imitation: a Hugging Face dataset with a row for each episode.

The columns are those of `imitation.data.huggingface_utils` of https://pypi.org/project/imitation/,
1.0.1, whose `imitation.data.serialize.load` reads the folder. The library itself writes pictures as
lists of numbers, which it reads back slowly and as int64; it reads PNG files as uint8.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from labyrinth_core.data.storage import write_text
from pipeline.export.split import PART_BYTES, Split, in_parts, png_value


def write(split: Split, folder: Path, part_bytes: int = PART_BYTES) -> None:
    """Write a split into an empty folder, as `Dataset.save_to_disk` does, with a file per part."""
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
    info = datasets.DatasetInfo(
        features=features, description=split.description, license=split.licence
    )
    names: list[str] = []
    state: dict[str, Any] = {}
    datasets.disable_progress_bars()  # One of theirs for each part, instead of ours for all.
    for part in in_parts(_rows(split), part_bytes):
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


def _rows(split: Split) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield the row of each episode, after the bytes of its pictures."""
    for episode in split.episodes():
        pictures = [png_value(picture) for picture in episode.observations]
        yield (
            sum(len(picture["bytes"]) for picture in pictures),
            {
                "obs": pictures,
                "acts": episode.actions,
                # The labyrinth is in the info of the first step.
                "infos": [json.dumps({"labyrinth": episode.info}), *["{}"] * (len(episode) - 1)],
                "terminal": episode.terminated,
                "rews": episode.rewards,
            },
        )
