"""Export for the library imitation: a Hugging Face dataset with one row per episode.

The columns are those of `imitation.data.huggingface_utils` of https://pypi.org/project/imitation/,
1.0.1, whose `imitation.data.serialize.load` reads the folder. The library itself writes pictures as
lists of numbers, which it reads back slowly, as int64. We write PNG files, which it reads as uint8.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labyrinth_core.storage import File
from pipeline.export.stage import PART_BYTES, Split, in_parts, png_value

if TYPE_CHECKING:
    import pyarrow as pa


def write(split: Split, folder: Path, part_bytes: int = PART_BYTES) -> None:
    """Write a split into an empty folder like `Dataset.save_to_disk`, with one file per part."""
    import pyarrow as pa

    schema = _schema()
    names: list[str] = []
    for part in in_parts(_rows(split), part_bytes):
        names.append(f"data-{len(names):05d}.arrow")
        with (folder / names[-1]).open("wb") as file, pa.ipc.new_stream(file, schema) as stream:
            stream.write_table(pa.Table.from_pylist(part, schema))
    info = {
        "citation": "",
        "description": split.description,
        "features": _FEATURES,
        "homepage": "",
        "license": split.licence,
    }
    File(folder / "dataset_info.json").write_text(json.dumps(info, indent=2))
    state: dict[str, Any] = {
        "_data_files": [{"filename": name} for name in names],
        "_fingerprint": hashlib.sha256(json.dumps(split.record()).encode()).hexdigest()[:16],
        "_format_columns": None,
        "_format_kwargs": {},
        "_format_type": None,
        "_output_all_columns": False,
        "_split": None,
    }
    File(folder / "state.json").write_text(json.dumps(state, indent=2))


def _list_of(dtype: str) -> dict[str, Any]:
    return {"feature": {"dtype": dtype, "_type": "Value"}, "_type": "Sequence"}


_FEATURES = {
    "obs": {"feature": {"_type": "Image"}, "_type": "Sequence"},
    "acts": _list_of("int64"),
    "infos": _list_of("string"),
    "terminal": {"dtype": "bool", "_type": "Value"},
    "rews": _list_of("float32"),
}
"""The columns as `datasets` describes them. Its versions before 4 know lists only as `Sequence`;
later versions read `Sequence`, but write `List`."""


def _schema() -> pa.Schema:
    """Return the Arrow schema of the columns, with their description."""
    import pyarrow as pa

    picture = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    return pa.schema(
        [
            ("obs", pa.list_(picture)),
            ("acts", pa.list_(pa.int64())),
            ("infos", pa.list_(pa.string())),
            ("terminal", pa.bool_()),
            ("rews", pa.list_(pa.float32())),
        ],
        metadata={"huggingface": json.dumps({"info": {"features": _FEATURES}})},
    )


def _rows(split: Split) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield, for each episode, the bytes of its pictures and its row."""
    for episode in split.episodes():
        pictures = [png_value(picture) for picture in episode.observations]
        yield (
            sum(len(picture["bytes"]) for picture in pictures),
            {
                "obs": pictures,
                "acts": episode.actions,
                # Only the info of the first step holds the labyrinth.
                "infos": [json.dumps({"labyrinth": episode.info}), *["{}"] * (len(episode) - 1)],
                "terminal": episode.terminated,
                "rews": episode.rewards,
            },
        )
