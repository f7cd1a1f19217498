"""What a build leaves on disk: bytes, rows, names; and how it goes on."""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from datasets import ClassLabel, Features, Value, load_dataset
from datasets import Image as ImageFeature
from PIL import Image
from support.brute_force import simple_routes, world_of
from support.crashing import CrashError, before_each_shard
from support.making import Run
from support.tampering import Rows, content_of, cut_short, episode_starts, identities, read_rows

from labyrinth_core import load_episodes
from labyrinth_core.data import COLUMNS, SPLITS, Dataset, Manifest
from labyrinth_core.data import manifest as listing
from labyrinth_core.language import parse
from labyrinth_core.pictures import StatePictures
from labyrinth_core.storage import LocalFile
from labyrinth_core.world import State, Task
from pipeline.generation import build as generation
from pipeline.generation import shard as making
from pipeline.generation.check import validate
from pipeline.inspection import statistics

Build = Callable[..., Run]


def rows_by_split(folder: Path) -> dict[str, Rows]:
    manifest = Manifest.read(folder)
    return {
        split: [row for shard in manifest.of(split) for row in read_rows(folder / shard.path)]
        for split in SPLITS.base
    }


def episodes_of(rows: Rows) -> Iterator[Rows]:
    starts = episode_starts(rows)
    for start, end in zip(starts, [*starts[1:], len(rows)], strict=True):
        yield rows[start:end]


# The same bytes.


@pytest.mark.slow
@pytest.mark.parametrize("task", [str(task) for task in Task])
def test_what_was_built_is_valid_and_the_same_byte_for_byte_when_it_is_built_again(
    build: Build, tmp_path: Path, task: str
) -> None:
    options = {"size": "4", "labyrinths": 4, "random_steps": 150, "task": task}
    run, again = (build(tmp_path / name, **options) for name in ("a", "b"))
    assert validate(Dataset.at(run.folder)) == []
    assert content_of(again.data_dir) == content_of(run.data_dir)


def test_another_seed_gives_other_rows(build: Build, tmp_path: Path, small_dataset: Run) -> None:
    other = Manifest.read(build(tmp_path, seed=1).folder)
    here = Manifest.read(small_dataset.folder)
    assert other.fingerprint != here.fingerprint
    assert not {s.fingerprint for s in other.shards} & {s.fingerprint for s in here.shards}


@pytest.mark.slow
def test_several_shards_hold_the_rows_that_one_holds(
    build: Build, tmp_path: Path, small_dataset: Run
) -> None:
    first, second = (build(tmp_path / name, cells_per_shard=3 * 9).folder for name in ("a", "b"))
    assert content_of(first) == content_of(second)
    manifest = Manifest.read(first)
    for split in SPLITS.base:
        paths = [first / f"{split}-0000{number}-of-00003.parquet" for number in range(3)]
        assert [first / shard.path for shard in manifest.of(split)] == paths
        assert [len({row["info"] for row in read_rows(path)}) for path in paths] == [3, 3, 2]
    assert rows_by_split(first) == rows_by_split(small_dataset.folder)


class OtherPictures(StatePictures):
    """Encodes pictures as another library would: the same pixels in other bytes."""

    def draw(self, states: Sequence[State]) -> tuple[Sequence[bytes], Sequence[bytes]]:
        files, digests = super().draw(states)
        others = [io.BytesIO() for _ in files]
        for file, other in zip(files, others, strict=True):
            Image.open(io.BytesIO(file)).save(other, "PNG", compress_level=1)
        return [other.getvalue() for other in others], digests


@pytest.mark.slow
def test_another_compression_changes_bytes_and_no_fingerprint(build: Build, tmp_path: Path) -> None:
    small = {"labyrinths": 2, "random_steps": 20}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(making, "StatePictures", OtherPictures)
        versions = Manifest.current_versions() | {"png": "Pillow, deflate level 1"}
        patch.setattr(Manifest, "current_versions", lambda: versions)
        folder = build(tmp_path / "other", **small).folder
    here, other = Manifest.read(build(tmp_path, **small).folder), Manifest.read(folder)
    assert other.fingerprint == here.fingerprint
    for shard, recompressed in zip(here.shards, other.shards, strict=True):
        assert recompressed.fingerprint == shard.fingerprint
        assert recompressed.sha256 != shard.sha256
    assert validate(Dataset.at(folder, other)) == []


# The files.


def test_a_finished_folder_holds_shards_a_table_and_a_manifest_and_nothing_else(
    small_dataset: Run,
) -> None:
    shards = {f"{split}-00000-of-00001.parquet" for split in SPLITS.base}
    assert {path.name for path in small_dataset.folder.iterdir()} == shards | {
        Manifest.TABLE,
        Manifest.FILE,
    }
    assert {path.name for path in small_dataset.data_dir.iterdir()} == {"3x3", "README.md"}


def test_the_schema_is_the_one_that_datasets_makes_of_the_features() -> None:
    features = Features.from_dict({column.name: column.feature for column in COLUMNS})
    assert features["obs"] == ImageFeature()
    assert features["actions"] == ClassLabel(names=["up", "right", "down", "left"])
    assert features["rewards"] == Value("float32")
    assert COLUMNS.arrow_schema().equals(features.arrow_schema, check_metadata=True)
    assert COLUMNS.arrow_schema().metadata == features.arrow_schema.metadata


def test_row_groups_never_divide_an_episode(small_dataset: Run) -> None:
    groups = 0
    for shard in Manifest.read(small_dataset.folder).shards:
        with pq.ParquetFile(small_dataset.folder / shard.path) as file:
            assert file.schema_arrow.equals(COLUMNS.arrow_schema(), check_metadata=True)
            for group in range(file.num_row_groups):
                rows = file.read_row_group(group).to_pylist()
                assert rows[0]["episode_starts"]
                assert rows[-1]["actions"] == -1
                groups += 1
    assert groups > len(SPLITS.base)


@pytest.mark.slow
def test_an_episode_of_many_pictures_is_divided_between_row_groups_and_read_like_any_other(
    build: Build, tmp_path: Path, small_dataset: Run
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(making, "DRAWN_AT_ONCE", 3)
        patch.setattr(listing, "GROUP_BYTES", 20_000)
        folder = build(tmp_path).folder
    whole, divided = Manifest.read(small_dataset.folder), Manifest.read(folder)
    for one, other in zip(whole.shards, divided.shards, strict=True):
        assert replace(other, bytes=one.bytes, sha256=one.sha256) == one
    (shard,) = divided.of("random")
    with pq.ParquetFile(folder / shard.path) as file:
        sizes = [file.metadata.row_group(n).num_rows for n in range(file.num_row_groups)]
        for n in range(file.num_row_groups):
            if file.metadata.row_group(n).total_byte_size < 20_000 // 4:  # Streams rely on this.
                assert file.read_row_group(n, ["actions"])["actions"][-1].as_py() == -1
    assert shard.longest == 100
    assert max(sizes) < 20
    assert rows_by_split(folder) == rows_by_split(small_dataset.folder)
    assert validate(Dataset.at(folder, divided)) == []
    found = [statistics.count_dataset(Dataset.at(each)) for each in (folder, small_dataset.folder)]
    assert str(found[0].splits) == str(found[1].splits)
    data_dirs = (tmp_path, small_dataset.data_dir)
    loaded = [load_episodes(each, "3x3", split="random") for each in data_dirs]
    for one, other in zip(*loaded, strict=True):
        assert one.info == other.info
        assert np.array_equal(one.observations, other.observations)


def test_pictures_can_be_skipped_without_reading_statistics_of_them(small_dataset: Run) -> None:
    path = small_dataset.folder / "train-00000-of-00001.parquet"
    actions = [row["actions"] for row in read_rows(path)]
    with pq.ParquetFile(path) as file:
        group = file.metadata.row_group(0)
        columns = {group.column(n).path_in_schema: group.column(n) for n in range(6)}
    assert columns["obs.bytes"].statistics is None
    statistics = columns["actions"].statistics
    assert (statistics.min, statistics.max) == (-1, max(actions))
    assert {column.compression for column in columns.values()} == {"ZSTD"}


def test_a_text_is_stored_once_in_a_row_group(small_dataset: Run) -> None:
    with pq.ParquetFile(small_dataset.folder / "random-00000-of-00001.parquet") as file:
        for number in range(file.num_row_groups):
            texts = file.read_row_group(number, columns=["info"])["info"].to_pylist()
            columns = map(file.metadata.row_group(number).column, range(file.metadata.num_columns))
            stored = next(each for each in columns if each.path_in_schema == "info")
            once = sum(4 + len(text) for text in set(texts))
            assert once < stored.total_uncompressed_size < once + 4 * len(texts) + 100


# As loaded by others.


def test_load_dataset_reads_the_folder(small_dataset: Run) -> None:
    loaded, rows = (
        load_dataset(str(small_dataset.data_dir), "3x3"),
        rows_by_split(small_dataset.folder),
    )
    assert list(loaded) == list(SPLITS.base)
    for split, dataset in loaded.items():
        assert dataset.features.arrow_schema.equals(COLUMNS.arrow_schema(), check_metadata=True)
        assert (dataset[0]["obs"].mode, dataset[0]["obs"].size) == ("RGB", (600, 600))
        assert dataset.remove_columns("obs").to_list() == [
            {name: value for name, value in row.items() if name != "obs"} for row in rows[split]
        ]


# The rows.


def test_names_of_pictures_are_unique_and_tell_their_place(small_dataset: Run) -> None:
    seen: list[str] = []
    for split, rows in rows_by_split(small_dataset.folder).items():
        infos = list(dict.fromkeys(row["info"] for row in rows))
        names = [row["obs"]["path"] for row in rows]
        assert names == sorted(names)
        for name, row in zip(names, rows, strict=True):
            assert name.startswith(f"{split}-{infos.index(row['info']):06d}-")
        seen += names
    assert len(set(seen)) == len(seen)


def every_simple_route(info: str) -> list[list[int]]:
    return [list(route) for route in simple_routes(world_of(parse(info)))]


def routes_in(rows: Rows) -> Iterator[tuple[str, list[list[int]]]]:
    for info, group in groupby(rows, key=lambda row: row["info"]):
        episodes = episodes_of(list(group))
        yield info, [[row["actions"] for row in episode[:-1]] for episode in episodes]


@pytest.mark.slow
@pytest.mark.parametrize("solutions", ["shortest", "all_shortest", "all"])
def test_the_routes_that_are_asked_for_are_there_exactly_once(
    build: Build, tmp_path: Path, solutions: str
) -> None:
    options = {"size": "4", "open_walls": 0.4, "labyrinths": 6, "random_steps": 1}
    folder = build(tmp_path, **options, solutions=solutions).folder
    several = 0
    for split in (*SPLITS.sampled, "s0", "s0_and_g"):
        for info, routes in routes_in(rows_by_split(folder)[split]):
            every = every_simple_route(info)
            shortest = [route for route in every if len(route) == min(map(len, every))]
            several += len(shortest) > 1
            if solutions == "shortest":
                assert len(routes) == 1
                assert routes[0] in shortest
            else:
                assert sorted(routes) == sorted(every if solutions == "all" else shortest)
    assert several > 0
    assert all(shard.cut == 0 for shard in Manifest.read(folder).shards)


def test_a_limit_of_solutions_is_kept_and_reported(
    build: Build, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = {"size": "4", "open_walls": 0.3, "labyrinths": 6, "random_steps": 1}
    folder = build(tmp_path, **options, solutions="all", solutions_limit=2).folder
    printed = " ".join(capsys.readouterr().out.split())
    reported = []
    for shard in Manifest.read(folder).shards:
        rows = read_rows(folder / shard.path)
        if shard.split == "random":
            assert shard.cut == 0
            continue
        cut = 0
        for info, routes in routes_in(rows):
            simple = every_simple_route(info)
            assert len(routes) == min(2, len(simple))
            assert all(route in simple for route in routes)
            cut += len(simple) >= 2
        assert shard.cut == cut
        reported += [f"{cut} of {shard.split}"] if cut else []
    assert reported
    assert (
        f"solutions_limit=2 was reached, so routes may be missing: {', '.join(reported)}."
        in printed
    )


# Going on after an end that came too soon.


@pytest.fixture
def stop_after(build: Build) -> Callable[..., Path]:
    """A function that begins a build, ends it after some shards, and returns its folder."""

    def begin(data_dir: Path, shards: int, **options: Any) -> Path:
        left = iter(range(shards))

        def end() -> None:
            if next(left, None) is None:
                raise CrashError

        with before_each_shard(end), pytest.raises(CrashError):
            build(data_dir, **options)
        return data_dir / ".3x3.building"

    return begin


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "damage"), [("shards/{}.parquet", cut_short), ("{}.shard", Path.unlink)]
)
def test_a_damaged_shard_is_made_again_and_no_other(
    build: Build,
    stop_after: Callable[..., Path],
    tmp_path: Path,
    small_dataset: Run,
    file: str,
    damage: Callable[[Path], None],
) -> None:
    building = stop_after(tmp_path, 2)
    shard, other = sorted(building.glob("shards/*.parquet"))
    damage(building / file.format(shard.stem))
    LocalFile(building / "test-00000-of-00001.parquet").temporary().write_bytes(b"half of it")
    kept = identities(building / "shards")[other.name]
    folder = build(tmp_path).folder
    assert content_of(folder) == content_of(small_dataset.folder)
    assert identities(folder)[other.name] == kept


@pytest.mark.slow
def test_what_another_version_left_is_discarded(
    build: Build, stop_after: Callable[..., Path], tmp_path: Path, small_dataset: Run
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(making, "StatePictures", OtherPictures)
        patch.setattr(Manifest, "current_versions", lambda: {"png": "another"})
        stop_after(tmp_path, 3)
    assert content_of(build(tmp_path).data_dir) == content_of(small_dataset.data_dir)


def test_a_build_that_ends_before_its_first_shard_leaves_nothing(
    stop_after: Callable[..., Path], tmp_path: Path
) -> None:
    stop_after(tmp_path / "new" / "folders", 0)
    assert list(tmp_path.iterdir()) == []


def test_overwrite_replaces_a_dataset_once_the_new_one_is_finished(
    build: Build, stop_after: Callable[..., Path], tmp_path: Path, small_dataset: Run
) -> None:
    build(tmp_path, labyrinths=2, random_steps=5)
    before = content_of(tmp_path / "3x3")
    stop_after(tmp_path, 4, overwrite=True)
    assert content_of(tmp_path / "3x3") == before
    build(tmp_path, overwrite=True)
    assert content_of(tmp_path) == content_of(small_dataset.data_dir)
    assert {path.name for path in tmp_path.iterdir()} == {"3x3", "README.md"}


# What is printed.


STRANGE = ["a'b", 'a"b', r"a\b", "日本 #,=(&)%20{}@", "\x1b[31m", "[/red]a [bold]b"]
STRANGE += ["a*b", "a?b", "a::b", "a$HOME"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "data_dir"),
    [*((".", name) for name in STRANGE), *((name, "data") for name in ("a [5x5]", "a::b"))],
)
def test_the_line_that_is_printed_loads_the_dataset_when_it_is_pasted(
    small_dataset: Run,
    make_run: Build,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    place: str,
    data_dir: str,
) -> None:
    """Wherever the dataset is, and from whichever folder a relative path leads to it."""
    folder = Path(shutil.copytree(small_dataset.data_dir, tmp_path / place / data_dir))
    monkeypatch.chdir(tmp_path / place)
    run = make_run(folder if place == "." else Path(data_dir))
    generation.run(run)
    lines = capsys.readouterr().out.splitlines()
    if data_dir.isprintable():
        assert f"{run.folder} is complete already." in " ".join(lines)
    line = next(each for each in lines if "load_" in each).removeprefix("To load it: ")
    pasted = "from datasets import load_dataset\nfrom labyrinth_core import load_transitions\n"
    exec(f"{pasted}loaded = {line}", found := {})
    rows = sum(shard.rows for shard in Manifest.read(run.folder).of("train"))
    loaded = found["loaded"]
    assert (len(loaded.frames) if "transitions" in line else len(loaded["train"])) == rows


def test_the_summary_shows_each_split(build: Build, tmp_path: Path, capsys: Any) -> None:
    run = build(tmp_path)
    lines = capsys.readouterr().out.splitlines()
    for shard in Manifest.read(run.folder).shards:
        row = next(line for line in lines if shard.split in line.split())
        cells = row.split()
        assert cells[:4] == [shard.split, "8", str(shard.episodes), str(shard.rows)]
        assert cells[4] == f"{(shard.rows - shard.episodes) / shard.episodes:.2f}"
        assert cells[5] == str(shard.longest)
