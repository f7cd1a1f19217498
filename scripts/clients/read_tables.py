"""polars and DuckDB: the release itself, pictures as PNG files within Parquet, and its table."""

from __future__ import annotations

import io
import json
import sys

import numpy as np
from comparing import CONFIG, DATA, FOLDER, Episode, compare, report
from PIL import Image

NAME = sys.argv[2]


PATTERN = str(DATA / CONFIG / "train-*.parquet")


def rows() -> list[tuple]:
    """Return the pictures, actions, rewards and starts of all rows."""
    if NAME == "polars":
        import polars as pl

        columns = (pl.col("obs").struct.field("bytes"), "actions", "rewards", "episode_starts")
        return pl.scan_parquet(PATTERN).select(*columns).collect().rows()
    import duckdb

    return duckdb.sql(
        f"SELECT obs.bytes, actions, rewards, episode_starts FROM read_parquet('{PATTERN}')"
    ).fetchall()


def episodes():
    """Yield the episodes, with pictures as our loader makes them small."""
    episode: list[tuple] = []
    for row in [*rows(), (b"", -1, 0.0, True)]:
        if row[-1] and episode:
            pictures, actions, rewards, _ = zip(*episode, strict=True)
            assert actions[-1] == -1
            yield Episode(
                np.stack([small(p) for p in pictures]), actions[:-1], np.float32(rewards[:-1])
            )
            episode = []
        episode.append(row)


def small(png: bytes) -> np.ndarray:
    """Return a picture at 64 x 64, as `load_episodes` makes it."""
    from labyrinth_core.pictures.resize import area_average

    return area_average(np.asarray(Image.open(io.BytesIO(png))), 64)


def table() -> list[list]:
    """Return the rows of the table of labyrinths."""
    path = str(DATA / CONFIG / "labyrinths.parquet")
    if NAME == "polars":
        import polars as pl

        return [[*row] for row in pl.read_parquet(path).rows()]
    import duckdb

    return [[*row] for row in duckdb.sql(f"SELECT * FROM read_parquet('{path}')").fetchall()]


labyrinths = json.loads((FOLDER / "reference" / "labyrinths.json").read_text())
assert table() == labyrinths
report(
    [NAME],
    f"{compare(episodes(), 'train'):,} steps of the release, {len(labyrinths)} labyrinths",
)
