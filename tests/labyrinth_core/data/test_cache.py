"""The pictures that are kept: the same as without a cache, whatever other processes do."""

import ctypes
import errno
import os
import pickle
import shutil
import threading
from contextlib import contextmanager
from dataclasses import fields, replace

import numpy as np
import pytest

from labyrinth_core import load_transitions
from labyrinth_core.data import SPLITS, Manifest
from labyrinth_core.data import transitions as caching
from labyrinth_core.errors import DatasetError
from labyrinth_core.pictures import observations
from labyrinth_core.storage import LocalFile

FRAMES, SUM = "frames.npy", "sha256"
"""The files of a cache besides the columns."""

LIMIT_VARIABLE = "LABYRINTH_CACHE_GB"
NOT_CACHED = "optimal", "columns"
FIELDS = [field.name for field in fields(caching.Transitions) if field.name not in NOT_CACHED]
NAME, OTHER = (f"5x5-train-2-{digit * 32}" for digit in "01")
"""Names of caches."""


@pytest.fixture(scope="module")
def data_dir(small_dataset):
    return small_dataset.data_dir


@pytest.fixture
def cache(tmp_path):
    return tmp_path / "cache"


def assert_same(some, others):
    for name in FIELDS:
        one, other = getattr(some, name), getattr(others, name)
        assert (one.dtype, one.shape) == (other.dtype, other.shape)
        np.testing.assert_array_equal(one, other)


def only_folder(cache):
    (path,) = cache.iterdir()
    return path


def load_few(folder, made=None):
    """Return two transitions of a cache, noting in a list each part that is made."""

    def content():
        frames = np.arange(4 * 12, dtype=np.uint8).reshape(4, 2, 2, 3)
        for first in (0, 2):
            if made is not None:
                made.append(first)
            steps = np.arange(first, first + 1)
            columns = {name: steps.astype(kind) for name, kind in caching.COLUMNS.items()}
            yield frames[first : first + 2], columns

    return caching.Transitions.of(caching.cached(folder, (4, 2, 2, 3), content()))


def test_the_lock_of_a_process_that_was_killed_just_after_the_cache_was_made_is_removed(cache):
    load_few(cache / NAME)
    (cache / f".{NAME}.lock").touch()
    load_few(cache / NAME)
    assert only_folder(cache).name == NAME
    with LocalFile(cache / f".{NAME}.lock").locked():
        load_few(cache / NAME)
        assert (cache / f".{NAME}.lock").exists()


# What is kept.


@pytest.mark.parametrize("split", SPLITS.base)
def test_what_is_kept_is_what_was_loaded_and_no_shard_is_read_again(
    data_dir, cache, tmp_path, split
):
    copy = shutil.copytree(data_dir, tmp_path / "copy")
    options = {"split": split, "image_size": 16}
    without = load_transitions(copy, "3x3", cache_dir=False, **options)
    cold = load_transitions(copy, "3x3", cache_dir=cache, **options)
    for path in (copy / "3x3").glob("*.parquet"):
        path.unlink()
    warm = load_transitions(copy, "3x3", cache_dir=str(cache), **options)
    assert_same(cold, without)
    assert_same(warm, without)
    assert not any(getattr(warm, name).flags.writeable for name in FIELDS)
    assert only_folder(cache).name.rpartition("-")[0] == f"3x3-{split}-16"
    there = np.load(only_folder(cache) / FRAMES, mmap_mode="r", allow_pickle=False)
    np.testing.assert_array_equal(there, without.frames)


def test_the_users_cache_folder_is_the_default(data_dir, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    load_transitions(data_dir, "3x3", image_size=8)
    assert (only_folder(tmp_path / "xdg" / "labyrinth-datasets") / FRAMES).is_file()
    for unset in ("", "not/absolute"):
        monkeypatch.setenv("XDG_CACHE_HOME", unset)
        load_transitions(data_dir, "3x3", image_size=8)
    assert (only_folder(tmp_path / "home" / ".cache" / "labyrinth-datasets") / FRAMES).is_file()


@pytest.mark.parametrize("cache_dir", [False, None])
def test_without_a_cache_nothing_is_written(data_dir, tmp_path, monkeypatch, cache_dir):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    transitions = load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache_dir)
    assert transitions.frames.base is None
    vectors = load_transitions(data_dir, "3x3", observation="vector")
    for loaded in (transitions, vectors):
        assert not any(getattr(loaded, name).flags.writeable for name in FIELDS)
    assert list(tmp_path.iterdir()) == []


def test_each_dataset_split_size_and_way_to_make_pictures_has_its_own_cache(
    data_dir, cache, build, tmp_path
):
    other = build(tmp_path / "other", seed=1).data_dir
    for number, (folder, options) in enumerate(
        [
            (data_dir, {}),
            (other, {}),
            (data_dir, {"split": "test"}),
            (data_dir, {"image_size": 9}),
            (data_dir, {"draw": True}),
        ]
    ):
        options = {"image_size": 8} | options
        kept = load_transitions(folder, "3x3", cache_dir=cache, **options)
        assert_same(kept, load_transitions(folder, "3x3", cache_dir=False, **options))
        assert len(list(cache.iterdir())) == number + 1


def test_a_version_that_draws_otherwise_makes_its_own_cache(data_dir, cache, monkeypatch):
    for version in (1, 2):
        monkeypatch.setattr(observations, "PICTURES_VERSION", version)
        load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)
        assert len(list(cache.iterdir())) == version


def test_other_colours_make_their_own_cache_of_drawn_pictures(data_dir, cache, monkeypatch):
    for count, floor in ((2, "white"), (3, "grey")):
        monkeypatch.setattr(observations, "style_for", lambda *_, floor=floor: floor)
        for draw in (False, True):
            load_transitions(data_dir, "3x3", image_size=8, draw=draw, cache_dir=cache)
        assert len(list(cache.iterdir())) == count


# Caches that are damaged.


DAMAGE = {
    (FRAMES, "cut"): lambda content: content[:-1],
    (FRAMES, "emptied"): lambda _: b"",
    (FRAMES, "shape changed"): lambda content: content.replace(b", 8, 8, 3)", b", 8, 4, 6)", 1),
    (FRAMES, "shape beyond all bounds"): lambda content: content.replace(
        b", 8, 8, 3), }" + b" " * 18, b"1" * 18 + b", 8, 8, 3), }", 1
    ),
    (FRAMES, "header changed"): lambda content: content.replace(b"'|u1'", b"'|i1'", 1),
    (FRAMES, "bracket lost"): lambda content: content.replace(b"), }", b" , }", 1),
    ("rows.npy", "objects instead of numbers"): lambda content: content.replace(
        b"'<i8'", b"'|O8'", 1
    ),
    ("rows.npy", "type garbled"): lambda content: content.replace(b"'<i8'", b"',i8'", 1),
    ("rows.npy", "type changed"): lambda content: content.replace(b"'<i8'", b"'>i8'", 1),
    ("actions.npy", "column changed"): lambda content: content[:-8] + b"\x05" + content[-7:],
    (SUM, "changed"): lambda content: content[:-1] + bytes([content[-1] ^ 1]),
}


@pytest.mark.slow
@pytest.mark.parametrize(("file", "damage"), DAMAGE, ids=" ".join)
def test_a_cache_that_is_damaged_is_made_again(data_dir, cache, file, damage):
    whole = load_transitions(data_dir, "3x3", image_size=8, cache_dir=False)
    load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)
    path = only_folder(cache) / file
    content = path.read_bytes()
    damaged = DAMAGE[file, damage](content)
    assert damaged != content
    path.unlink()  # What is still mapped is not to be cut.
    path.write_bytes(damaged)
    assert_same(load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache), whole)
    assert path.read_bytes() == content


@pytest.mark.parametrize("file", [FRAMES, "rewards.npy", SUM])
def test_a_cache_without_one_of_its_files_is_made_again(data_dir, cache, file):
    whole = load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)
    (only_folder(cache) / file).unlink()
    assert_same(load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache), whole)
    assert (only_folder(cache) / file).is_file()


# Folders that cannot be written.


@pytest.mark.parametrize(
    ("obstacle", "message"),
    [("a file", "held in memory"), ("full", "No space left on device: .*3x3-train-8-")],
)
def test_a_folder_that_cannot_be_written_is_warned_of_and_done_without(
    data_dir, cache, monkeypatch, obstacle, message
):
    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    if obstacle == "full":
        monkeypatch.setattr(os, "fsync", full)
    else:
        cache.write_text("")
    with pytest.warns(UserWarning, match=f"the frame cache cannot be used: .*{message}"):
        kept = load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)
    assert_same(kept, load_transitions(data_dir, "3x3", image_size=8, cache_dir=False))
    assert cache.is_file() or list(cache.iterdir()) == []


# A bound.


def test_what_was_not_used_for_longest_makes_room(data_dir, cache, monkeypatch):
    for age, image_size in ((3, 8), (1, 9), (2, 10)):
        load_transitions(data_dir, "3x3", image_size=image_size, cache_dir=cache)
        path = next(cache.glob(f"3x3-train-{image_size}-*/{FRAMES}"))
        os.utime(path, (path.stat().st_atime, path.stat().st_mtime - 1000 * age))
    load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)  # Used again just now.
    files = [path for path in cache.rglob("*") if path.is_file()]
    oldest = next(cache.glob("3x3-train-10-*"))
    kept = sum(path.stat().st_size for path in files if path.parent != oldest)
    rows = sum(shard.rows for shard in Manifest.read(data_dir / "3x3").of("train"))
    limit = kept + 3 * 11**2 * rows
    monkeypatch.setenv(LIMIT_VARIABLE, str(limit / 1e9))
    load_transitions(data_dir, "3x3", image_size=11, cache_dir=cache)
    sizes = sorted(int(path.name.split("-")[2]) for path in cache.iterdir())
    assert sizes == [8, 9, 11]


def test_a_cache_larger_than_the_bound_is_refused_and_others_stay(data_dir, cache, monkeypatch):
    load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)
    monkeypatch.setenv(LIMIT_VARIABLE, "0.0001")
    with pytest.raises(DatasetError, match=f"^the pictures take .* GB, .* higher {LIMIT_VARIABLE}"):
        load_transitions(data_dir, "3x3", image_size=500, cache_dir=cache)
    assert "3x3-train-8-" in only_folder(cache).name


@pytest.mark.parametrize("text", ["much", "-1", "nan", "inf"])
def test_a_bound_that_is_no_number_is_refused(cache, monkeypatch, text):
    monkeypatch.setenv(LIMIT_VARIABLE, text)
    with pytest.raises(DatasetError, match=f"^{LIMIT_VARIABLE}={text}: give a number of gigabytes"):
        load_few(cache / NAME)


def test_a_large_cache_is_announced_when_it_is_made(cache, monkeypatch):
    monkeypatch.setattr(caching, "LARGE", 48)
    with pytest.warns(UserWarning, match=rf"writing 0\.0 GB of pictures to .*/{NAME}"):
        load_few(cache / NAME)
    load_few(cache / NAME)
    monkeypatch.setattr(caching, "LARGE", 49)
    load_few(cache / OTHER)


# Several processes.


def test_who_waits_takes_what_the_other_has_made(cache, monkeypatch):
    written, found, barrier = [], [], threading.Barrier(8)

    locked = LocalFile.locked

    def locked_by_one_of_all(lock):
        barrier.wait(timeout=60)
        return locked(lock)

    monkeypatch.setattr(LocalFile, "locked", locked_by_one_of_all)
    threads = [
        threading.Thread(target=lambda: found.append(load_few(cache / NAME, written)))
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert written == [0, 2]
    assert len(found) == 8
    for transitions in found:
        assert_same(transitions, found[0])


@pytest.mark.parametrize("again", [NAME, OTHER])
def test_what_a_killed_process_leaves_does_no_harm_and_is_removed(cache, again):
    unfinished = LocalFile(cache / NAME).temporary() / NAME
    unfinished.mkdir(parents=True)
    (unfinished / FRAMES).write_bytes(b"half of it")
    (cache / f".{NAME}.lock").touch()
    assert len(load_few(cache / again)) == 2
    assert only_folder(cache).name == again


def test_what_a_process_leaves_that_is_killed_while_another_waits_is_removed(cache, monkeypatch):
    locked = LocalFile.locked

    @contextmanager
    def after_a_kill(lock, **options):
        with locked(lock, **options):
            LocalFile(cache / NAME).temporary().mkdir()
            yield

    monkeypatch.setattr(LocalFile, "locked", after_a_kill)
    load_few(cache / NAME)
    assert only_folder(cache).name == NAME


def test_a_folder_that_another_process_writes_is_not_taken_for_a_leftover(cache):
    unfinished = LocalFile(cache / NAME).temporary() / NAME
    unfinished.mkdir(parents=True)
    (unfinished / FRAMES).touch()
    with LocalFile(cache / f".{NAME}.lock").locked():
        load_few(cache / OTHER)
        assert (unfinished / FRAMES).exists()


def test_files_of_others_are_left_alone(data_dir, cache, monkeypatch):
    others = [cache / "x" / FRAMES, cache / OTHER / FRAMES, cache / OTHER / "mine", cache / NAME]
    for path in others:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(1_000_000))
    monkeypatch.setenv(LIMIT_VARIABLE, "1e-3")
    load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)
    assert all(path.exists() for path in others)


def test_a_damaged_cache_that_a_killed_process_had_put_aside_is_removed(cache):
    load_few(cache / NAME)
    aside = LocalFile(cache / NAME).temporary(".replaced")
    shutil.copytree(cache / NAME, aside)
    (cache / f".{NAME}.lock").touch()
    load_few(cache / NAME)
    assert only_folder(cache).name == NAME


def test_a_file_under_the_name_of_a_cache_is_left_and_done_without(cache):
    cache.mkdir()
    (cache / NAME).write_text("mine")
    with pytest.raises(NotADirectoryError):
        load_few(cache / NAME)
    assert only_folder(cache).read_text() == "mine"


def test_a_folder_under_the_name_of_a_cache_with_a_file_of_another_is_left_and_done_without(
    data_dir, cache
):
    whole = load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)
    folder = only_folder(cache)
    for path in folder.iterdir():
        path.unlink()
    (folder / "mine").write_text("")
    with pytest.warns(UserWarning, match=r"cannot be used: .*/mine.*held in memory"):
        again = load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)
    assert_same(again, whole)
    assert [path.name for path in only_folder(cache).iterdir()] == ["mine"]


# What is written to a picture.


@pytest.mark.parametrize("memory", [True, False], ids=["enough memory", "a file too large for it"])
def test_a_cache_is_mapped_so_that_a_write_stays_in_the_process(
    data_dir, cache, monkeypatch, memory
):
    """NumPy refuses a write; what ignores that must neither crash nor change the file."""
    memmap = np.memmap

    def limited(path, *, mode, **layout):
        if mode == "c" and not memory:
            raise OSError(errno.ENOMEM, "Cannot allocate memory")
        return memmap(path, mode=mode, **layout)

    load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)
    before = (only_folder(cache) / FRAMES).read_bytes()
    monkeypatch.setattr(np, "memmap", limited)
    loaded = load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)
    picture = loaded[0].observation
    with pytest.raises(ValueError, match="read-only"):
        picture += 1
    if memory:
        first = int(picture[0, 0, 0])
        ctypes.c_uint8.from_address(picture.ctypes.data).value = first ^ 1
        assert loaded[0].observation[0, 0, 0] == first ^ 1
    assert (only_folder(cache) / FRAMES).read_bytes() == before


# Workers of a DataLoader.


@pytest.fixture
def kept(data_dir, cache):
    return load_transitions(data_dir, "3x3", split="random", image_size=32, cache_dir=cache)


def test_processes_are_sent_the_names_of_the_files_and_not_the_frames(kept):
    sent = pickle.dumps(kept)
    assert kept.frames.nbytes > 1_000_000
    assert len(sent) < 3_000
    received = pickle.loads(sent)
    assert_same(received, kept)
    assert len(pickle.dumps(received)) < 3_000


@pytest.mark.parametrize("frames", [slice(None), slice(3, 9), slice(0, 0), slice(None, None, -1)])
def test_a_choice_of_transitions_is_sent_as_chosen(kept, frames):
    columns = {name: getattr(kept, name)[5:60:3] for name in FIELDS[1:]}
    chosen = replace(kept, frames=kept.frames[frames], **columns)
    assert_same(pickle.loads(pickle.dumps(chosen)), chosen)


@pytest.mark.parametrize("content", [None, b"short"])
def test_transitions_whose_file_is_gone_say_so(kept, cache, content):
    sent = pickle.dumps(kept)
    path = only_folder(cache) / FRAMES
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(DatasetError, match=r"\A\S+\.npy is gone since it was loaded: [^\n]+\Z"):
        pickle.loads(sent)


def test_what_a_worker_makes_a_tensor_of_is_its_own_to_write_to(kept):
    for step, index in zip(kept.__getitems__([3, 0, 3]), [3, 0, 3], strict=True):
        assert step._fields == ("observation", "action", "next_observation")
        assert type(step.action) is int
        for array, expected in zip(step[::2], kept[index][::2], strict=True):
            assert array.flags.writeable
            assert array.flags.c_contiguous
            np.testing.assert_array_equal(array, expected)


@pytest.mark.parametrize(
    "indices", [[5, 2, 2, -1], np.array([7, 0]), slice(2, 9, 3), slice(None), np.zeros(0, int)]
)
def test_a_batch_is_the_transitions_of_its_indices(kept, indices):
    batch = kept[indices]
    assert batch._fields == ("observation", "action", "next_observation")
    each = [kept[index] for index in np.arange(len(kept))[indices].tolist()]
    for place, array in enumerate(batch):
        expected = np.array([step[place] for step in each], array.dtype)
        np.testing.assert_array_equal(array, expected.reshape(array.shape))
        assert array.flags.writeable
    assert batch.observation.shape == (len(each), 32, 32, 3)
    with pytest.raises(IndexError):
        kept[len(kept)]
