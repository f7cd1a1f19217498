"""Folders that take the place of others, also where folders cannot be renamed."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import pytest
from support.crashing import ERRORS, Crash, CrashError, no_folder_is_renamed
from support.tampering import content_of

from labyrinth_core import folders
from labyrinth_core.folders import LocalFolder

MARK = "mark"


def folder_of(folder: Path, **files: str) -> Path:
    """Make a folder with a mark, a file in a folder, and a link that leads nowhere."""
    for name, text in ({MARK: "", "deep/file": ""} | files).items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (folder / "link").symlink_to("nowhere")
    return folder


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("there", [True, False])
def test_what_cannot_be_renamed_is_copied(error: int, there: bool, tmp_path: Path) -> None:
    made, place = folder_of(tmp_path / "work" / "made", new="1"), tmp_path / "place"
    if there:
        folder_of(place, old="0")
    expected = content_of(made)
    with no_folder_is_renamed(error):
        LocalFolder(place, MARK).complete(made)
    assert content_of(place) == expected
    assert (place / "link").readlink() == Path("nowhere")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["place", "work"]
    assert not any((tmp_path / "work").iterdir())


def test_another_error_is_not_hidden(tmp_path: Path) -> None:
    made, place = folder_of(tmp_path / "made"), folder_of(tmp_path / "place", old="0")
    with no_folder_is_renamed(13), pytest.raises(PermissionError):
        LocalFolder(place, MARK).complete(made)
    assert (place / "old").exists()


@pytest.mark.parametrize("error", [0, ERRORS[0]])
def test_a_crash_at_any_change_leaves_one_folder_or_the_other(error: int, tmp_path: Path) -> None:
    for change in range(1, 100):
        folder = tmp_path / str(change)
        made, place = folder_of(folder / "made", new="1"), folder_of(folder / "place", old="0")
        new, old = content_of(made), content_of(place)
        renaming = no_folder_is_renamed(error) if error else nullcontext()
        with renaming, pytest.MonkeyPatch.context() as patch:
            crash = Crash(patch, change)
            try:
                LocalFolder(place, MARK).complete(made)
            except CrashError:
                assert not (place / MARK).exists() or content_of(place) in (old, new)
                patch.undo()
                LocalFolder(place, MARK).recover()
        assert content_of(place) in (old, new)
        assert not list(folder.glob(f".*{folders._COMPLETE}"))
        if crash.left > 0:
            assert content_of(place) == new
            assert change > 3
            return
    pytest.fail("the move has more changes than were tried")
