"""Files and folders, local and in object stores: replaced whole, links themselves."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any

import fsspec
import pytest
from support.making import RunConfig, resolve
from support.s3_server import bucket, memory, server

from labyrinth_core.remote import RemotePath
from labyrinth_core.storage import File, LocalFile, folder_at
from pipeline.config import ConfigError

__all__ = ["bucket", "memory", "server"]

pytestmark = pytest.mark.slow


@pytest.fixture(params=["local", "memory", "s3"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path | RemotePath:
    if request.param == "local":
        return tmp_path
    return folder_at(request.getfixturevalue({"memory": "memory", "s3": "bucket"}[request.param]))


def test_a_folder_is_used_alike_wherever_it_is(folder: Path | RemotePath, tmp_path: Path) -> None:
    deeper = folder / "a" / "b"
    assert not deeper.exists()
    assert not list(folder.glob("*/*"))
    with pytest.raises(FileNotFoundError):
        (deeper / "one.txt").read_bytes()
    deeper.mkdir(parents=True, exist_ok=True)
    File(deeper / "one.txt").write_bytes(b"old")
    File(deeper / "one.txt").write_bytes(b"new")
    with File(deeper / "two.txt").replacing(tmp_path) as local:
        local.write_bytes(b"2")
        assert not (deeper / "two.txt").exists()
    assert [path.name for path in sorted(deeper.iterdir(), key=str)] == ["one.txt", "two.txt"]
    assert [str(path) for path in (folder / "a").glob("*/one*")] == [str(deeper / "one.txt")]
    assert (deeper / "one.txt").read_text(encoding="utf-8") == "new"
    assert (deeper / "one.txt").parent == deeper
    assert deeper.is_dir()
    assert (deeper / "one.txt").is_file()
    assert not deeper.is_file()
    with (deeper / "one.txt").open("rb") as file:
        assert file.read(2) == b"ne"
    with File(deeper / "two.txt").local_copy() as local:
        assert local.read_bytes() == b"2"
    (deeper / "one.txt").unlink()
    (deeper / "one.txt").unlink(missing_ok=True)
    assert [path.name for path in deeper.iterdir()] == ["two.txt"]


def test_a_file_that_is_not_finished_is_not_there(
    folder: Path | RemotePath, tmp_path: Path
) -> None:
    def write_half() -> None:
        with File(folder / "shard").replacing(tmp_path) as local:
            local.write_bytes(b"half of it")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        write_half()
    assert not list(folder.glob("*"))


@pytest.mark.parametrize("write", ["write_bytes", "new_file", "replacing"])
def test_a_link_is_replaced_itself_and_a_folder_never(tmp_path: Path, write: str) -> None:
    def put(path: Path) -> None:
        if write == "write_bytes":
            File(path).write_bytes(b"new")
            return
        with (
            File(path).replacing(tmp_path)
            if write == "new_file"
            else LocalFile(path).replacing() as local
        ):
            local.write_bytes(b"new")

    target, folder = tmp_path / "target", tmp_path / "folder"
    target.write_bytes(b"old")
    folder.mkdir()
    for place in (target, folder, tmp_path / "nowhere"):
        link = tmp_path / f"to-{place.name}"
        link.symlink_to(place)
        put(link)
        assert not link.is_symlink()
        assert link.read_bytes() == b"new"
    with pytest.raises(FileExistsError, match=r"is not a regular file.*folder"):
        put(folder)
    assert target.read_bytes() == b"old"
    assert list(folder.iterdir()) == []
    assert len(list(tmp_path.iterdir())) == 5


def test_a_link_that_a_user_names_for_output_leads_to_its_target(tmp_path: Path) -> None:
    link, folder = tmp_path / "link", tmp_path / "folder"
    link.symlink_to("target")
    folder.symlink_to(tmp_path)
    File(LocalFile(link).target()).write_bytes(b"new")
    assert link.is_symlink()
    assert (tmp_path / "target").read_bytes() == b"new"
    assert LocalFile(tmp_path / "other").target() == tmp_path / "other"
    with pytest.raises(FileExistsError, match="is not a regular file"):
        LocalFile(folder).target()


def test_an_error_of_a_full_disk_names_the_file_that_is_written(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    for writing in (LocalFile(path).replacing(), File(path).replacing(tmp_path)):
        with pytest.raises(OSError, match=r"No space left on device: '.*a\.parquet'"), writing:
            raise OSError(errno.ENOSPC, "No space left on device")
        assert list(tmp_path.iterdir()) == []


def test_an_error_of_a_temporary_file_names_the_file_that_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, _: Path) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted", str(path))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", refuse)
        with pytest.raises(PermissionError) as refused:
            File(tmp_path / "y.png").write_bytes(b"")
    assert refused.value.filename == str(tmp_path / "y.png")
    path = tmp_path / "nowhere" / "x.png"
    with pytest.raises(FileNotFoundError) as caught:
        File(path).write_bytes(b"")
    assert caught.value.filename == str(path)


def test_only_names_with_their_own_hash_are_those_of_temporary_files(tmp_path: Path) -> None:
    path = tmp_path / "README.md"
    made = LocalFile(path).temporary()
    for name in (made.name, f".README.md.{'0' * 12}.{'0' * 8}.tmp", ".README.md.tmp", "x.tmp"):
        (tmp_path / name).touch()
    assert LocalFile.temporaries(tmp_path, [path.name]) == [made]
    assert LocalFile.temporaries(tmp_path, ["README"]) == []
    assert LocalFile.temporaries(tmp_path, [path.name], ".replaced") == []


class FailingStore(fsspec.AbstractFileSystem):
    """A store that fails with an error of its own."""

    protocol = "failing"

    def cat_file(self, path: str, **_: Any) -> bytes:
        raise RuntimeError(f"no\ncredentials for {path}")


def test_what_a_store_raises_becomes_one_os_error_with_the_url() -> None:
    fsspec.register_implementation("failing", FailingStore, clobber=True)
    with pytest.raises(OSError, match="RuntimeError: no credentials") as caught:
        RemotePath("failing://labyrinth/x").read_bytes()
    assert caught.value.filename == "failing://labyrinth/x"


def test_a_file_url_is_a_local_folder(tmp_path: Path) -> None:
    assert folder_at(f"file://{tmp_path}") == tmp_path


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        ({"data_dir": "nosuch://a/b"}, ["data_dir=nosuch://a/b", "nosuch"]),
        ({"data_dir": "gs://a/b"}, ["data_dir=gs://a/b", "missing", "install gcsfs"]),
    ],
    ids=["unknown", "missing"],
)
def test_a_place_that_cannot_be_used_is_answered_with_one_line(
    options: dict[str, Any], parts: list[str]
) -> None:
    config = RunConfig(**{"stages": ["build"]} | options)
    with pytest.raises(ConfigError) as caught:
        resolve(config)
    assert all(part in str(caught.value) for part in parts), caught.value
    assert "\n" not in str(caught.value)
