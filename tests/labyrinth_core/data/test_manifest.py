"""The manifest on disk."""

from __future__ import annotations

import copy
import json
import traceback
from collections.abc import Callable, Iterator
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.making import Run

from labyrinth_core.data import Manifest, Shard
from labyrinth_core.errors import DatasetError

WRONG = (None, True, 1.0, -1, [], {})
"""Values of which none is that of a field of a shard."""

WELL = {"bytes": 1, "sha256": ""}
"""The description of a table of labyrinths."""

anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=9), inner),
    max_leaves=5,
)


@pytest.fixture(scope="module")
def content(small_dataset: Run) -> Any:
    return json.loads((small_dataset.folder / Manifest.FILE).read_bytes())


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("manifest") / "3x3"
    folder.mkdir()
    return folder


def read_back(folder: Path, content: Any) -> Manifest:
    """Read a manifest back from a folder of the dataset's name."""
    (folder / Manifest.FILE).write_text(json.dumps(content), encoding="utf-8")
    return Manifest.read(folder)


def places(content: Any) -> Iterator[tuple[Any, Any]]:
    """Yield each place in a JSON value as the container and the key in it."""
    if isinstance(content, dict | list):
        for key in list(content) if isinstance(content, dict) else range(len(content)):
            yield content, key
            yield from places(content[key])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """An empty folder with the name of the small dataset."""
    (tmp_path / "3x3").mkdir()
    return tmp_path / "3x3"


def test_a_manifest_survives_the_way_to_disk_and_back(small_dataset: Run, folder: Path) -> None:
    manifest = Manifest.read(small_dataset.folder)
    manifest.write(folder)
    assert Manifest.read(folder) == manifest
    assert (folder / Manifest.FILE).read_bytes() == (
        small_dataset.folder / Manifest.FILE
    ).read_bytes()
    assert [path.name for path in folder.iterdir()] == [Manifest.FILE]


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
    (scratch / Manifest.FILE).write_bytes(raw)
    with pytest.raises(DatasetError, match=Manifest.FILE):
        Manifest.read(scratch)


@pytest.mark.parametrize("make", [lambda path: path.write_text("[" * 200_000), Path.mkdir])
def test_nesting_without_end_or_a_folder_in_its_place_is_no_manifest(
    tmp_path: Path, make: Callable[[Path], object]
) -> None:
    make(tmp_path / Manifest.FILE)
    with pytest.raises(DatasetError, match="cannot be read"):
        Manifest.read(tmp_path)


def test_a_folder_without_manifest_holds_no_finished_dataset(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "missing"):
        with pytest.raises(DatasetError, match="holds no finished dataset"):
            Manifest.read(folder)


SHARD = "train-00000-of-00001.parquet"
NO_SHARD = "split 'train' cannot have a shard"


def with_shard(content: Any, **values: Any) -> Any:
    first, *others = content["shards"]
    assert first["path"] == SHARD
    return content | {"shards": [first | values, *others]}


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        *(
            (lambda content, path=path: with_shard(content, path=path), NO_SHARD)
            for path in (
                *(f"../{SHARD}", f"/{SHARD}", f"sub/{SHARD}", f"\\{SHARD}", "..", ".", ""),
                *(f"{SHARD}\n", f"{SHARD}\0", "train.parquet", Manifest.FILE),
                "test-00000-of-00001.parquet",
            )
        ),
        (
            lambda content: with_shard(content, split="eval", path="eval-00000-of-00001.parquet"),
            "split 'eval' cannot",
        ),
        (lambda content: content | {"format": 1}, r"has format 1, and this version reads \d"),
        (lambda content: {k: v for k, v in content.items() if k != "labyrinths"}, "labyrinths"),
        *(
            (lambda content, more=more: with_shard(content, **more), "cannot be read: .*a shard")
            for more in ({field.name: wrong} for field in fields(Shard) for wrong in WRONG)
        ),
        *(
            (lambda content, table=table: content | {"labyrinths": table}, "read: .*a table")
            for table in (None, [], {}, {"bytes": 1}, WELL | {"bytes": "1"}, WELL | {"x": 1})
        ),
    ],
)
def test_a_manifest_that_was_edited_is_refused(
    content: Any, folder: Path, edit: Callable[[Any], Any], message: str
) -> None:
    assert read_back(folder, content).labyrinths is not None
    with pytest.raises(DatasetError, match=message):
        read_back(folder, edit(content))


def test_the_fingerprint_of_a_dataset_depends_on_each_shard(small_dataset: Run) -> None:
    manifest = Manifest.read(small_dataset.folder)
    written = json.loads((small_dataset.folder / Manifest.FILE).read_bytes())
    assert manifest.fingerprint == written["fingerprint"]
    for place, shard in enumerate(manifest.shards):
        other = Shard(**asdict(shard) | {"fingerprint": "0" * 64})
        shards = (*manifest.shards[:place], other, *manifest.shards[place + 1 :])
        changed = Manifest(manifest.config, manifest.versions, shards)
        assert changed.fingerprint != manifest.fingerprint


REBUILD = "build it again with overwrite=true, or download it again"


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (b"", "Expecting value: line 1 column 1"),
        (b'{"format": 2, "name"', "Expecting ':' delimiter: line 1 column 21"),
        (bytes(range(128, 256)) * 9, "'utf-8' codec can't decode byte 0x80 in position 0"),
        (b"[]", "it is not the manifest of a dataset"),
        (b"3", "it is not the manifest of a dataset"),
        (b"{}", "it has no 'format'"),
    ],
)
def test_a_damaged_manifest_is_told_in_one_short_line_with_advice(
    folder: Path, raw: bytes, reason: str
) -> None:
    (folder / Manifest.FILE).write_bytes(raw)
    with pytest.raises(DatasetError) as caught:
        Manifest.read(folder)
    message = str(caught.value)
    assert message.startswith(f"{folder / Manifest.FILE} cannot be read: {reason}")
    assert message.endswith(REBUILD)
    assert len(message) < len(str(folder)) + 300
    assert message.isprintable()


@pytest.mark.parametrize("form", [1, 10**6, "2", None, [], {}])
def test_a_manifest_of_another_format_is_not_called_damaged(
    content: Any, folder: Path, form: Any
) -> None:
    with pytest.raises(
        DatasetError, match=r"has format .*, and this version reads \d+ and \d+: use"
    ):
        read_back(folder, content | {"format": form})


@pytest.mark.parametrize("field", ["task", "solutions", "sampler", "shifts", "\x1b[31m"])
def test_control_characters_of_a_manifest_are_not_sent_to_a_terminal(
    content: Any, folder: Path, field: str
) -> None:
    evil = "\x1b[2J\r\x9b31m\u202e\nforged"
    value = [evil] if field == "shifts" else evil
    with pytest.raises(DatasetError) as caught:
        read_back(folder, content | {"config": content["config"] | {field: value}})
    printed = "".join(traceback.format_exception(caught.value))
    assert printed.replace("\n", "").isprintable()
    assert str(caught.value).isprintable()
