"""The manifest on disk."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import MANIFEST, Manifest, Shard
from labyrinth_core.data.storage import file_sha256, write_text
from pipeline.config.run import Run

anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=9), inner),
    max_leaves=5,
)


@pytest.fixture(scope="module")
def content(small_dataset: Run) -> Any:
    return json.loads((small_dataset.folder / MANIFEST).read_bytes())


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("manifest")


def read_back(folder: Path, content: Any) -> Manifest:
    (folder / MANIFEST).write_text(json.dumps(content), encoding="utf-8")
    return Manifest.read(folder)


def places(content: Any) -> Iterator[tuple[Any, Any]]:
    """Yield each place in a JSON value as the container and the key in it."""
    if isinstance(content, dict | list):
        for key in list(content) if isinstance(content, dict) else range(len(content)):
            yield content, key
            yield from places(content[key])


def test_a_manifest_survives_the_way_to_disk_and_back(small_dataset: Run, tmp_path: Path) -> None:
    manifest = Manifest.read(small_dataset.folder)
    manifest.write(tmp_path)
    assert Manifest.read(tmp_path) == manifest
    assert (tmp_path / MANIFEST).read_bytes() == (small_dataset.folder / MANIFEST).read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == [MANIFEST]


@pytest.mark.slow
@given(data=st.data())
def test_an_edited_manifest_is_read_as_one_or_refused(
    content: Any, scratch: Path, data: st.DataObject
) -> None:
    edited = copy.deepcopy(content)
    for _ in range(data.draw(st.integers(1, 3))):
        options = list(places(edited))
        container, key = options[data.draw(st.integers(0, len(options) - 1))]
        action = data.draw(st.sampled_from(["replace", "remove", "repeat"]))
        if action == "replace":
            container[key] = data.draw(anything)
        elif action == "remove":
            del container[key]
        elif isinstance(container, list):
            container.append(copy.deepcopy(container[key]))
        else:
            container[data.draw(st.text(max_size=9))] = copy.deepcopy(container[key])
    try:
        manifest = read_back(scratch, edited)
    except DatasetError as error:
        message = str(error)
    else:
        message = ""
    if message:
        assert str(scratch) in message
        assert "\n" not in message
        assert len(message) < 1_000
        return
    assert all((scratch / shard.path).parent == scratch for shard in manifest.shards)
    manifest.write(scratch)
    assert Manifest.read(scratch) == manifest


@pytest.mark.slow
@given(st.binary(max_size=200) | st.text(max_size=200).map(str.encode) | anything)
def test_other_content_is_no_manifest(scratch: Path, other: Any) -> None:
    raw = other if isinstance(other, bytes) else json.dumps(other).encode()
    (scratch / MANIFEST).write_bytes(raw)
    with pytest.raises(DatasetError, match=MANIFEST):
        Manifest.read(scratch)


@pytest.mark.parametrize("make", [lambda path: path.write_text("[" * 200_000), Path.mkdir])
def test_nesting_without_end_or_a_folder_in_its_place_is_no_manifest(
    tmp_path: Path, make: Callable[[Path], object]
) -> None:
    make(tmp_path / MANIFEST)
    with pytest.raises(DatasetError, match="cannot be read"):
        Manifest.read(tmp_path)


def test_a_folder_without_manifest_holds_no_finished_dataset(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "missing"):
        with pytest.raises(DatasetError, match="holds no finished dataset"):
            Manifest.read(folder)


@pytest.mark.parametrize(
    "path",
    [
        "../train-00000-of-00001.parquet",
        "/train-00000-of-00001.parquet",
        "sub/train-00000-of-00001.parquet",
        "..",
        ".",
        "",
        "train-00000-of-00001.parquet\n",
        "train-00000-of-00001.parquet\0",
        "\\train-00000-of-00001.parquet",
        "test-00000-of-00001.parquet",
        "train.parquet",
        "manifest.json",
    ],
)
def test_a_shard_anywhere_but_in_its_place_is_refused(
    content: Any, scratch: Path, path: str
) -> None:
    edited = copy.deepcopy(content)
    assert edited["shards"][0]["path"] == "train-00000-of-00001.parquet"
    edited["shards"][0]["path"] = path
    with pytest.raises(DatasetError, match="no split 'train' has a shard"):
        read_back(scratch, edited)


def test_a_split_that_is_none_of_the_six_is_refused(content: Any, scratch: Path) -> None:
    edited = copy.deepcopy(content)
    edited["shards"][0] |= {"split": "eval", "path": "eval-00000-of-00001.parquet"}
    with pytest.raises(DatasetError, match="no split 'eval'"):
        read_back(scratch, edited)


def test_another_format_is_refused_by_its_number(content: Any, scratch: Path) -> None:
    with pytest.raises(DatasetError, match="its format is 1, not 2"):
        read_back(scratch, content | {"format": 1})


@pytest.mark.parametrize("name", [field.name for field in fields(Shard)])
@pytest.mark.parametrize("value", [None, True, 1.0, -1, [], {}])
def test_a_field_of_a_shard_of_another_kind_is_refused(
    content: Any, scratch: Path, name: str, value: Any
) -> None:
    edited = copy.deepcopy(content)
    edited["shards"][2][name] = value
    with pytest.raises(DatasetError, match="cannot be read"):
        read_back(scratch, edited)


@pytest.mark.parametrize(
    "value",
    [None, [], {}, {"bytes": 1}, {"bytes": "1", "sha256": ""}, {"bytes": 1, "sha256": "", "x": 1}],
    ids=str,
)
def test_a_table_of_labyrinths_described_otherwise_is_refused(
    content: Any, scratch: Path, value: Any
) -> None:
    with pytest.raises(DatasetError, match="cannot be read"):
        read_back(scratch, content | {"labyrinths": value})
    assert read_back(scratch, content).labyrinths is not None


def test_a_write_that_fails_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "text"
    write_text(path, "before\n")
    with pytest.raises(UnicodeEncodeError):
        write_text(path, "\ud800")
    assert [file.name for file in tmp_path.iterdir()] == ["text"]
    assert path.read_text() == "before\n"


def test_the_hash_of_a_file_is_sha256(tmp_path: Path) -> None:
    (tmp_path / "abc").write_bytes(b"abc")
    # FIPS 180-2, appendix B.1
    expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert file_sha256(tmp_path / "abc") == expected


def test_the_fingerprint_of_a_dataset_depends_on_each_shard(small_dataset: Run) -> None:
    manifest = Manifest.read(small_dataset.folder)
    written = json.loads((small_dataset.folder / MANIFEST).read_bytes())
    assert manifest.fingerprint == written["fingerprint"]
    for place, shard in enumerate(manifest.shards):
        other = Shard(**asdict(shard) | {"fingerprint": "0" * 64})
        shards = (*manifest.shards[:place], other, *manifest.shards[place + 1 :])
        changed = Manifest(manifest.config, manifest.versions, shards)
        assert changed.fingerprint != manifest.fingerprint
