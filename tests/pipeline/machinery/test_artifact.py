"""Artifacts are whole or absent, and a person's files are told from them."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from uuid import uuid4

import pytest
from support.crashing import ERRORS, CrashError, killed_before, no_folder_is_renamed
from support.tampering import content_of

from labyrinth_core.errors import DatasetError
from labyrinth_core.listing import is_litter
from labyrinth_core.remote import RemotePath
from labyrinth_core.storage import AnyPath, File, LocalFile, folder_at
from pipeline.machinery import Ownership, Sums, artifact, leave, produced

FILES = {"a": b"1", "deep/b": b"2"}


def make(folder: Path, key: int = 1, files: dict[str, bytes] = FILES, **rules: object) -> bool:
    """Produce an artifact; return whether it was made, and not there."""
    with produced(folder, {"key": key}, **rules) as new:  # type: ignore[arg-type]
        for name, content in files.items() if new else ():
            (new / name).parent.mkdir(exist_ok=True)
            (new / name).write_bytes(content)
    return new is not None


def made(folder: Path) -> dict[str, bytes]:
    """Return the content of a folder but its list."""
    return {name: content for name, content in content_of(folder).items() if name != Sums.FILE}


def test_an_artifact_is_made_once_and_its_list_is_one_for_sha256sum(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "it"
    assert make(folder)
    before = content_of(tmp_path)
    assert not make(folder)
    assert content_of(tmp_path) == before
    assert set(before) == {f"new/it/{name}" for name in (*FILES, Sums.FILE)}
    assert Sums.read(folder).key == {"key": 1}
    if program := shutil.which("sha256sum"):
        subprocess.run([program, "--strict", "-c", Sums.FILE], cwd=folder, check=True)


@pytest.mark.parametrize("name", ["../x", "/x", "a/../x", r"..\x", r"C:\x", "C:x", r"\\host\x"])
def test_no_name_in_a_list_is_of_a_file_elsewhere(tmp_path: Path, name: str) -> None:
    make(tmp_path / "it")
    with (tmp_path / "it" / Sums.FILE).open("a") as file:
        file.write(f"{'0' * 64}  {name}\n")
    with pytest.raises(DatasetError, match="is damaged"):
        Sums.read(tmp_path / "it")
    own = Sums.read(tmp_path / "it", overwrite=True)
    assert {name for name, _ in own.hashes} == FILES.keys()


def test_an_artifact_of_another_key_is_replaced_only_if_that_is_asked_for(tmp_path: Path) -> None:
    folder = tmp_path / "it"
    make(folder)
    reason = "it is made with key=1, not 2: choose it, or give overwrite=true to replace it$"
    with pytest.raises(DatasetError, match=reason):
        make(folder, 2, {"c": b"3"}, instead="choose it")
    assert made(folder) == FILES
    assert make(folder, 2, {"c": b"3"}, overwrite=True)
    assert made(folder) == {"c": b"3"}
    leave(folder, {"of two": b"2"}, key={"key": 2})
    with pytest.raises(DatasetError, match="is made with key=2, not 1"):
        leave(folder, {"of one": b"1"}, key={"key": 1})
    leave(tmp_path, {"of none": b""})
    with pytest.raises(DatasetError, match="holds files of another stage: choose"):
        leave(tmp_path, {"of one": b"1"}, key={"key": 1})
    with pytest.raises(DatasetError, match="is made with key=2: choose"):  # Of another kind.
        leave(folder, {"of one": b"1"}, key={"policy": "a", "budget": 1})


def test_a_second_process_waits_and_finds_the_artifact(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, begun = tmp_path / "it", threading.Event()

    def make_slowly() -> None:
        with produced(folder, {"key": 1}) as new:
            assert new is not None
            begun.set()
            while "waiting for another process that works on" not in capsys.readouterr().out:
                time.sleep(0.01)
            (new / "a").write_bytes(b"1")

    with ThreadPoolExecutor() as threads:
        first = threads.submit(make_slowly)
        assert begun.wait(60)
        assert not make(folder)
        first.result()
    assert made(folder) == {"a": b"1"}


def test_an_error_leaves_nothing_new(tmp_path: Path) -> None:
    with pytest.raises(KeyError), produced(tmp_path / "new" / "it", {}):
        raise KeyError
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("error", [0, ERRORS[0]])
@pytest.mark.parametrize("there", [True, False])
def test_after_a_crash_at_any_change_the_same_call_ends_in_the_same_bytes(
    error: int, there: bool, tmp_path: Path
) -> None:
    old = {"a": b"0", "old": b"0"}
    with no_folder_is_renamed(error) if error else nullcontext():
        for change in range(200):
            folder = tmp_path / str(change) / "it"
            folder.parent.mkdir()
            if there:
                make(folder, 0, old)
            again = partial(make, folder, overwrite=there)
            killed = killed_before(change, folder.parent, again)
            if (folder / Sums.FILE).exists():
                assert made(folder) in (FILES, old)
            again()
            assert made(folder) == FILES
            assert [path.name for path in folder.parent.iterdir()] == [folder.name]
            if not killed:
                assert change > 9
                return
    pytest.fail("there are more changes than were tried")


def test_what_is_missing_is_made_anew(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "it"
    make(folder)
    (folder / "a").unlink()
    (folder / "deep/b").unlink()
    (folder / "deep/b").symlink_to("nowhere")
    with pytest.raises(DatasetError, match="holds deep/b, damaged or changed since"):
        make(folder)
    (folder / "deep/b").unlink()
    assert make(folder)
    assert made(folder) == FILES
    assert "it is made again, because missing: a, deep/b." in capsys.readouterr().out


@pytest.mark.parametrize("there", [True, False])
def test_a_file_that_was_changed_is_found_whatever_its_time_and_kept(
    tmp_path: Path, there: bool
) -> None:
    folder = tmp_path / "it"
    make(folder)
    before = (folder / "a").stat()
    (folder / "a").write_bytes(b"x")
    os.utime(folder / "a", ns=(before.st_atime_ns, before.st_mtime_ns))
    if there:
        leave(folder, {"c": b"3"})
    reason = "it holds a, damaged or changed since it was made: give overwrite=true to make it aga"
    with pytest.raises(DatasetError, match=reason):
        make(folder)
    assert (folder / "a").read_bytes() == b"x"
    assert make(folder, overwrite=True)
    assert made(folder) == FILES


@pytest.mark.parametrize("name", ["notes", "deep/b/notes", "left"])
def test_a_file_of_a_person_stops_what_would_replace_it_and_nothing_else(
    tmp_path: Path, name: str
) -> None:
    folder = tmp_path / "it"
    make(folder)
    leave(folder, {"left": b"3"})
    if (folder / name.removesuffix("/notes")).is_file():
        (folder / name.removesuffix("/notes")).unlink()
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_bytes(b"mine")
    before = content_of(tmp_path)
    with pytest.raises(DatasetError, match=f"it holds {name}, which would be lost: move it else"):
        make(folder, 2, overwrite=True)
    assert content_of(tmp_path) == before
    if name in ("notes", "left"):
        assert not make(folder)


def test_a_person_s_files_under_other_names_stay(tmp_path: Path) -> None:
    folder = tmp_path / "it"
    make(folder)
    for name in ("notes", "mine/notes", ".DS_Store", LocalFile(folder / "a").temporary().name):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(b"mine")
    (folder / "link").symlink_to("nowhere")
    make(folder, 2, {"c": b"3"}, overwrite=True, ours=("a", "c"))
    assert made(folder) == {"c": b"3", "notes": b"mine", "mine/notes": b"mine"}
    assert (folder / "link").is_symlink()


def test_what_comes_while_an_artifact_is_made_is_not_lost(tmp_path: Path) -> None:
    make(tmp_path / "it")
    with (
        pytest.raises(DatasetError, match="holds notes, which would be lost"),
        produced(tmp_path / "it", {}, overwrite=True),
    ):
        (tmp_path / "it" / "notes").write_bytes(b"mine")
    assert made(tmp_path / "it") == FILES | {"notes": b"mine"}


def test_a_file_in_the_place_of_an_artifact_is_refused(tmp_path: Path) -> None:
    (tmp_path / "it").write_bytes(b"mine")
    with pytest.raises(DatasetError, match="it is a file: move it, or choose another folder"):
        make(tmp_path / "it", overwrite=True)
    assert (tmp_path / "it").read_bytes() == b"mine"


@pytest.mark.parametrize("name", ["it", "deep/it"])
def test_a_file_in_the_place_of_a_folder_above_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_bytes(b"mine")
    for act in (make, partial(leave, files=FILES)):
        with pytest.raises(DatasetError, match=r"file is a file: move it, or choose another fold"):
            act(tmp_path / "file" / name)


def test_a_link_to_an_artifact_stays(tmp_path: Path) -> None:
    make(tmp_path / "it")
    (tmp_path / "link").symlink_to("it")
    assert not make(tmp_path / "link")
    assert make(tmp_path / "link", 2, overwrite=True)
    assert (tmp_path / "link").is_symlink()
    assert Sums.read(tmp_path / "it").key == {"key": 2}


# In a store, which cannot rename.


class StoreCrash:
    """Let the process end before one of the changes of a store."""

    def __init__(self, patch: pytest.MonkeyPatch, change: int) -> None:
        self.left = change
        ask = RemotePath._ask

        def asking(path: RemotePath, question):  # type: ignore[no-untyped-def]
            if {"pipe_file", "rm_file"} & {*question.__code__.co_names}:
                self.left -= 1
                if self.left <= 0:
                    raise CrashError
            return ask(path, question)

        patch.setattr(RemotePath, "_ask", asking)


def make_in_store(folder: AnyPath, key: int, files: dict[str, bytes], **rules: bool) -> bool:
    with produced(folder, {"key": key}, mark="mark", names=[*files], **rules) as new:
        for name, content in files.items() if new else ():
            artifact.File(new / name).write_bytes(content)
    return new is not None


@pytest.mark.parametrize("old_key", [0, 1])
def test_in_a_store_a_crash_at_any_change_is_mended_by_the_same_call(old_key: int) -> None:
    old, files = {"a": b"0", "old": b"0", "mark": b"0"}, {"a": b"1", "b": b"2", "mark": b"1"}
    for change in range(1, 40):
        folder = folder_at(f"memory://{uuid4().hex}/it")
        make_in_store(folder, old_key, old)
        assert not make_in_store(folder, old_key, old)
        (folder / "a").unlink()
        rest = {name: content for name, content in old.items() if name != "a"}
        with pytest.MonkeyPatch.context() as patch:
            crash = StoreCrash(patch, change)
            try:
                make_in_store(folder, 1, files, overwrite=not old_key)
            except CrashError:
                patch.undo()
                there = {path.name: path.read_bytes() for path in folder.iterdir()}
                assert "mark" not in there or all(
                    each.items() <= there.items()
                    for each in (rest, files)
                    if each["mark"] == there["mark"]
                )
                make_in_store(folder, 1, files, overwrite=not old_key)
        assert {p.name: p.read_bytes() for p in folder.iterdir() if p.name != Sums.FILE} == files
        assert not make_in_store(folder, 1, files)
        if crash.left > 0:
            assert change > 6
            return
    pytest.fail("there are more changes than were tried")


# Files that are left in a folder that is shared with a person.


def test_what_was_left_may_be_replaced_and_removed(tmp_path: Path) -> None:
    leave(tmp_path, {"page": b"1", "chart": b"1"})
    sums = Ownership(Sums.read(tmp_path)).replace({"page": b"2"}, gone=["chart"])
    sums.write()
    assert made(tmp_path) == {"page": b"2"}
    assert Sums.read(tmp_path) == sums
    assert Ownership(sums).others({"page": b"3", "chart": b"3"}) == []


def test_what_a_person_made_or_changed_is_told_and_never_removed(tmp_path: Path) -> None:
    leave(tmp_path, {"page": b"1", "chart": b"1", "table": b"1"})
    (tmp_path / "chart").write_bytes(b"mine")
    (tmp_path / "photo").write_bytes(b"mine")
    (tmp_path / "folder").mkdir()
    new = dict.fromkeys(["page", "chart", "photo", "folder", "table", "more"], b"2")
    sums = Sums.read(tmp_path)
    assert Ownership(sums).others(new) == ["chart", "photo", "folder"]
    with pytest.raises(
        DatasetError, match=r"\A[^\n]*chart, [^\n]*photo, [^\n]*folder: made or changed by"
    ):
        leave(tmp_path, new)
    Ownership(sums).replace({"page": b"2"}, gone=["chart", "table"]).write()
    assert made(tmp_path) == {"page": b"2", "chart": b"mine", "photo": b"mine"}
    leave(tmp_path, {"table": b"1"})
    (tmp_path / "table").write_bytes(b"mine")
    with pytest.raises(DatasetError, match="table: damaged or changed, so not overwritten: move"):
        leave(tmp_path, {"table": b"2"})
    (tmp_path / "table").unlink()
    leave(tmp_path, {"chart": b"2"}, overwrite=True)
    assert made(tmp_path)["chart"] == b"2"


@pytest.mark.parametrize("names", [("chart", "page/impossible"), ("page/impossible", "chart")])
def test_files_that_an_interrupted_run_has_written_are_still_known(
    tmp_path: Path, names: tuple[str, str]
) -> None:
    leave(tmp_path, {"page": b"1", "chart": b"1"})
    with pytest.raises(OSError, match="page"):
        Ownership(Sums.read(tmp_path)).replace(dict.fromkeys(names, b"2"))
    assert Ownership(Sums.read(tmp_path)).others({"page": b"3", "chart": b"3"}) == []


def test_a_killed_writer_s_successor_lists_each_file_once_with_its_hash(tmp_path: Path) -> None:
    old, new = {"page": b"1", "chart": b"1"}, {"page": b"2", "more": b"2"}
    for there in (None, {"a": 1}):
        for change in range(100):
            folder = tmp_path / f"{there}-{change}"
            if there:
                leave(folder, old, key=there)
            act = partial(leave, folder, new, key={"a": 1})
            killed = killed_before(change, folder, act)
            if there:  # Another stage may come first.
                leave(folder, {"third": b"3"})
                names = [name for name, _ in Sums.read(folder).hashes]
                assert len(names) == len({*names})
                (folder / "third").unlink()
            act()
            listed = Sums.read(folder)
            files = {name: File(folder / name).sha256() for name in made(folder)}
            assert made(folder) == (old if there else {}) | new
            assert sorted(listed.hashes) == sorted(files.items())
            assert listed.key == {"a": 1}
            assert not [path for path in folder.iterdir() if path.name.startswith(".")]
            if not killed:
                assert change > 3
                break


@pytest.mark.parametrize("act", [make, partial(leave, files=FILES)])
def test_a_damaged_list_is_called_damaged_and_its_advice_works(
    tmp_path: Path, act: Callable[..., object]
) -> None:
    folder, path, away = tmp_path / "it", tmp_path / "it" / Sums.FILE, tmp_path / "away"
    act(folder)
    whole, content = path.read_bytes(), content_of(folder)
    flipped = [whole[:n] + bytes([whole[n] ^ 1]) + whole[n + 1 :] for n in range(len(whole))]
    cut = [whole[:n] for n in range(len(whole))]
    for number, text in enumerate([*flipped, *cut, bytes(len(whole))]):
        path.write_bytes(text)
        with pytest.raises(DatasetError, match="SHA256SUMS is damaged: the stage that made its"):
            Sums.read(folder)
        if number % 17:  # What both ways to make it again do takes longer to see.
            continue
        with pytest.raises(DatasetError, match="SHA256SUMS is damaged: the stage that made its"):
            act(folder)
        if number % 2:
            folder.rename(away)
            act(folder)
            shutil.rmtree(away)
        else:
            refusal = ""
            try:
                act(folder, overwrite=True)
            except DatasetError as error:  # The names of some files cannot be read.
                refusal = str(error)
            if refusal:
                assert re.search("it holds .*, which would be lost: move it elsewhere", refusal)
                shutil.rmtree(folder)
                act(folder)
        assert content_of(folder) == content


def test_a_list_of_an_older_version_without_a_hash_of_itself_is_read(tmp_path: Path) -> None:
    make(tmp_path / "it")
    path = tmp_path / "it" / Sums.FILE
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join([lines[0], *lines[2:]]))
    assert lines[1].startswith("# sha256 of the lines below ")
    assert not make(tmp_path / "it")


@pytest.mark.parametrize("overwrite", [False, True])
def test_nothing_is_written_or_removed_through_a_link(tmp_path: Path, overwrite: bool) -> None:
    folder, elsewhere = tmp_path / "it", tmp_path / "elsewhere"
    leave(folder, {"page": b"1", "deep/chart": b"1"})
    elsewhere.mkdir()
    for name in ("page", "deep", Sums.FILE):
        (folder / name).rename(elsewhere / name)
        (folder / name).symlink_to(elsewhere / name)
    before = content_of(elsewhere)
    with pytest.raises(DatasetError, match="deep is a link, and nothing is written through it"):
        leave(folder, {"deep/chart": b"2"}, overwrite=overwrite)
    with pytest.raises(DatasetError, match="deep is a link"):
        Ownership(Sums.read(folder)).replace({}, gone=["deep/chart"])
    leave(folder, {"page": b"2"}, overwrite=overwrite)
    assert (folder / "page").read_bytes() == b"2"
    assert not (folder / "page").is_symlink()
    Ownership(Sums.read(folder)).replace({}, gone=["page"]).write()
    assert not (folder / "page").exists()
    assert content_of(elsewhere) == before


def test_a_link_to_a_file_that_is_not_ours_is_refused_and_replaced_itself_if_asked_for(
    tmp_path: Path,
) -> None:
    folder, mine = tmp_path / "it", tmp_path / "mine"
    mine.write_bytes(b"mine")
    folder.mkdir()
    for name, place in (("page", mine), ("chart", tmp_path / "nowhere"), ("table", tmp_path)):
        (folder / name).symlink_to(place)
        with pytest.raises(DatasetError, match=f"{name}: made or changed by someone else, so"):
            leave(folder, {name: b"2"})
        leave(folder, {name: b"2"}, overwrite=True)
        assert (folder / name).read_bytes() == b"2"
    (folder / Sums.FILE).unlink()
    (folder / Sums.FILE).symlink_to("nowhere")
    with pytest.raises(DatasetError, match="SHA256SUMS is a link that leads nowhere: remove it"):
        leave(folder, {"page": b"3"})
    assert mine.read_bytes() == b"mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["it", "mine"]


def test_an_artifact_of_links_is_whole_and_replaced_without_their_targets(tmp_path: Path) -> None:
    folder, store = tmp_path / "it", tmp_path / "store"
    make(folder)
    shutil.copytree(folder, store)
    for name in (*FILES, Sums.FILE):
        (folder / name).unlink()
        (folder / name).symlink_to(store / name)
    before = content_of(store)
    assert not make(folder)
    assert make(folder, 2, {"a": b"2"}, overwrite=True)
    assert made(folder) == {"a": b"2"}
    shutil.rmtree(folder / "deep", ignore_errors=True)
    (folder / "deep").symlink_to(store / "deep")
    with pytest.raises(DatasetError, match="it holds deep, which would be lost"):
        make(folder, overwrite=True)
    assert content_of(store) == before


@pytest.mark.parametrize(
    "text", [f"{'0' * 64}  thesis.txt\n", "page is mine\n", "\0\xff", "# mine\n"]
)
def test_a_list_of_somebody_else_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    (tmp_path / Sums.FILE).write_text(text, encoding="latin-1")
    with pytest.raises(DatasetError, match=r"\A.*SHA256SUMS is another program's: move it.*\Z"):
        Sums.read(tmp_path)


@pytest.mark.parametrize(
    ("path", "litter"),
    [
        *((".DS_Store", True), ("Thumbs.db", True), ("desktop.ini", True), ("._page", True)),
        *((".ipynb_checkpoints/notes.txt", True), ("meta/.nfs000000000012ab", True)),
        *(("cache-0123456789abcdef.arrow", True), ("data/cache-1_00000_of_00002.arrow", True)),
        *(("@eaDir/page.png/SYNO", True), ("#recycle/x", True), (".Trash-1000/files/x", True)),
        *((".hidden", False), ("cache.arrow", False), ("cache-notes.txt", False)),
        *(("notes.DS_Store", False), ("Thumbs.db.txt", False), ("desktop/notes.txt", False)),
    ],
)
def test_what_systems_and_readers_leave_is_told_from_files_of_a_person(
    path: str, litter: bool
) -> None:
    assert is_litter(path) == litter
