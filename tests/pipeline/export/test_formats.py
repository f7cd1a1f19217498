"""What lies in the exports whose libraries cannot be installed beside ours.

`scripts/check_clients.py` reads them with the libraries themselves.
"""

from __future__ import annotations

import json

import datasets
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.exporting import SIZE, episodes, split_of
from support.making import Run

from labyrinth_core.data import Manifest
from pipeline.export import imitation, lerobot

SPLITS = ("train", "random")
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
KEYS = ["min", "max", "mean", "std", *QUANTILES, "count"]


@pytest.mark.slow
@pytest.mark.parametrize("split", SPLITS)
def test_the_trajectories_for_imitation_are_the_episodes(small_dataset: Run, tmp_path, split):
    folder = tmp_path / "parts"
    folder.mkdir()
    imitation.write(split_of(small_dataset, split), folder, part_bytes=4_000)
    assert len(list(folder.glob("data-*.arrow"))) > 1
    rows = datasets.load_from_disk(folder)
    assert rows.column_names == ["obs", "acts", "infos", "terminal", "rews"]
    assert rows.info.license == "mit"
    for row, episode in zip(rows, episodes(small_dataset, split), strict=True):
        seen = np.asarray(row["obs"])  # As the library does.
        assert seen.dtype == np.uint8
        assert np.array_equal(seen, episode.observations)
        assert row["acts"] == episode.actions.tolist()
        assert np.array_equal(np.float32(row["rews"]), episode.rewards)
        assert row["terminal"] == episode.terminated
        assert [json.loads(info) for info in row["infos"]] == [
            {"labyrinth": episode.info},
            *[{}] * (len(episode) - 1),
        ]


def test_the_columns_for_imitation_are_described_as_versions_before_4_read_them(
    small_dataset: Run, tmp_path
):
    """`datasets` 4 writes the type List, which 2 and 3, as imitation allows them, do not know."""
    imitation.write(split_of(small_dataset, "test"), tmp_path)
    with pa.ipc.open_stream(tmp_path / "data-00000.arrow") as stream:
        within = json.loads(stream.schema.metadata[b"huggingface"])["info"]["features"]
    features = json.loads((tmp_path / "dataset_info.json").read_bytes())["features"]
    assert features == within
    lists = {name: each["_type"] for name, each in features.items() if name != "terminal"}
    assert lists == dict.fromkeys(["obs", "acts", "infos", "rews"], "Sequence")
    assert datasets.load_from_disk(tmp_path).features == {
        "obs": datasets.List(datasets.Image()),
        "acts": datasets.List(datasets.Value("int64")),
        "infos": datasets.List(datasets.Value("string")),
        "terminal": datasets.Value("bool"),
        "rews": datasets.List(datasets.Value("float32")),
    }


@pytest.mark.slow
@pytest.mark.parametrize("split", SPLITS)
def test_the_frames_for_lerobot_are_the_rows_of_the_dataset(small_dataset: Run, tmp_path, split):
    folder = tmp_path / "parts"
    folder.mkdir()
    lerobot.write(split_of(small_dataset, split), folder, part_bytes=4_000)
    info = json.loads((folder / "meta/info.json").read_bytes())
    paths = sorted(folder.glob("data/*/*.parquet"))
    assert len(paths) > 1
    frames = datasets.Dataset.from_parquet(list(map(str, paths)), cache_dir=str(tmp_path / "cache"))
    assert frames.column_names == list(info["features"])
    assert len(frames) == info["total_frames"]
    pictures = np.stack([np.asarray(each) for each in frames["observation.image"]])
    rows = frames.remove_columns("observation.image").with_format("numpy")[:]
    table = pq.read_table(folder / "meta/episodes").to_pylist()
    ours = pq.read_table(small_dataset.folder / Manifest.TABLE)
    by_first = {row["first_row"]: row for row in ours.to_pylist() if row["split"] == split}
    for number, episode in enumerate(episodes(small_dataset, split)):
        row = table[number]
        place = slice(row["dataset_from_index"], row["dataset_to_index"])
        assert np.array_equal(pictures[place], episode.observations)
        assert rows["action"][place].tolist() == [*episode.actions, -1]
        assert np.array_equal(rows["next.reward"][place], [*episode.rewards, 0])
        last = [False] * (len(episode) - 1) + [True, True]
        assert rows["next.done"][place].tolist() == last
        cut = not episode.terminated
        assert rows["next.truncated"][place].tolist() == [each and cut for each in last]
        assert set(rows["episode_index"][place]) == {number}
        assert rows["frame_index"][place].tolist() == list(range(len(episode) + 1))
        assert row["info"] == episode.info
        assert {name: row[name] for name in ours.column_names} == by_first[row["first_row"]]
        path = info["data_path"].format(
            chunk_index=row["data/chunk_index"], file_index=row["data/file_index"]
        )
        file = pq.read_table(folder / path, columns=["episode_index"])
        assert number in file["episode_index"].to_pylist()
    assert number + 1 == len(table) == info["total_episodes"]

    # A file of episodes that LeRobot appends has these columns, and is read with the first.
    statistics = json.loads((folder / "meta/stats.json").read_bytes())
    names = {f"stats/{name}/{key}" for name in info["features"] for key in KEYS}
    assert {name for name in table[0] if name.startswith("stats/")} == names
    columns = {**rows, "observation.image": pictures / 255}
    assert list(statistics) == [*list(rows), "observation.image"]
    for name, found in statistics.items():
        axes = (0, 1, 2) if columns[name].ndim == 4 else 0
        for key in ("min", "max", "mean", "std"):
            expected = getattr(columns[name].astype(float), key)(axis=axes)
            assert np.allclose(np.ravel(found[key]), expected, atol=1e-6), (name, key)
        assert found["count"] == [len(frames)]
        assert list(found) == KEYS
        for row in table:
            own = columns[name][row["dataset_from_index"] : row["dataset_to_index"]].astype(float)
            assert row[f"stats/{name}/count"] == [len(own)]
            for key, share in QUANTILES.items():
                quantile = np.quantile(own, share, axes, method="inverted_cdf")
                assert np.allclose(np.ravel(row[f"stats/{name}/{key}"]), quantile), (name, key)
            for key in ("min", "max", "mean", "std"):
                expected = getattr(own, key)(axis=axes)
                assert np.allclose(np.ravel(row[f"stats/{name}/{key}"]), expected, atol=1e-6)
        for key in QUANTILES:
            of_episodes = np.array([np.ravel(row[f"stats/{name}/{key}"]) for row in table])
            weights = [row["length"] for row in table]
            assert np.allclose(np.ravel(found[key]), np.average(of_episodes, 0, weights))
    assert np.shape(statistics["observation.image"]["mean"]) == (3, 1, 1)
    assert info["features"]["observation.image"]["shape"] == [SIZE, SIZE, 3]
