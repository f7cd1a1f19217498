"""The pictures that are kept: the same as without a cache, whatever other processes do."""

import errno
import os
import pickle
import shutil
import signal
import subprocess
import sys
import threading
from dataclasses import fields, replace

import numpy as np
import pytest

from labyrinth_core.data import frame_cache
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.frame_cache import LIMIT_VARIABLE
from labyrinth_core.data.loader import load_transitions
from labyrinth_core.data.locks import locked
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.splits import BASE_SPLITS
from labyrinth_core.data.storage import temporary_beside
from labyrinth_core.data.transitions import (
    COLUMNS,
    Transition,
    TransitionBatch,
    Transitions,
    as_received,
    as_sent,
)

FIELDS = [field.name for field in fields(Transitions) if field.name != "optimal"]


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


def only_file(cache):
    (path,) = cache.iterdir()
    return path


def filled(count):
    """Yield frames and columns for the cache, in two parts, noting each in a list."""
    frames = np.arange(4 * 12, dtype=np.uint8).reshape(4, 2, 2, 3)
    for first in (0, 2):
        count.append(first)
        steps = np.arange(first, first + 1)
        yield frames[first : first + 2], {name: steps.astype(COLUMNS[name]) for name in COLUMNS}


# What is kept.


@pytest.mark.parametrize("split", BASE_SPLITS)
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
    assert [path.name.rpartition("-")[0] for path in cache.iterdir()] == [f"3x3-{split}-16"]


def test_numpy_reads_the_frames_of_the_file(data_dir, cache):
    frames = load_transitions(data_dir, "3x3", image_size=16, cache_dir=cache).frames
    there = np.load(only_file(cache), mmap_mode="r", allow_pickle=False)
    np.testing.assert_array_equal(there, frames)


def test_the_users_cache_folder_is_the_default(data_dir, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    load_transitions(data_dir, "3x3", image_size=8)
    assert only_file(tmp_path / "xdg" / "labyrinth-datasets").suffix == ".npy"
    for unset in ("", "not/absolute"):
        monkeypatch.setenv("XDG_CACHE_HOME", unset)
        load_transitions(data_dir, "3x3", image_size=8)
    assert only_file(tmp_path / "home" / ".cache" / "labyrinth-datasets").suffix == ".npy"


@pytest.mark.parametrize("cache_dir", [False, None])
def test_without_a_cache_nothing_is_written(data_dir, tmp_path, monkeypatch, cache_dir):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    transitions = load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache_dir)
    assert transitions.frames.flags.writeable
    load_transitions(data_dir, "3x3", observation="vector")
    assert list(tmp_path.iterdir()) == []


def test_each_split_size_and_way_to_make_pictures_has_its_own_file(data_dir, cache):
    for options in ({}, {"split": "test"}, {"image_size": 9}, {"draw": True}):
        load_transitions(data_dir, "3x3", cache_dir=cache, **{"image_size": 8} | options)
    assert len(list(cache.iterdir())) == 4


def test_other_shards_have_another_file(data_dir, cache, build, tmp_path):
    other = build(tmp_path / "other", seed=1).data_dir
    for folder in (data_dir, other):
        kept = load_transitions(folder, "3x3", image_size=8, cache_dir=cache)
        assert_same(kept, load_transitions(folder, "3x3", image_size=8, cache_dir=False))
    assert len(list(cache.iterdir())) == 2


def test_a_dataset_that_is_refused_leaves_nothing(data_dir, cache, tmp_path):
    copy = shutil.copytree(data_dir, tmp_path / "copy")
    next((copy / "3x3").glob("train-*.parquet")).write_bytes(b"damaged")
    with pytest.raises(DatasetError, match="damaged"):
        load_transitions(copy, "3x3", image_size=8, cache_dir=cache)
    assert list(cache.iterdir()) == []


# Files that are not right.


DAMAGE = {
    "cut": lambda content: content[:-1],
    "cut in the frames": lambda content: content[: len(content) // 2],
    "no more than a digest": lambda content: content[-32:],
    "emptied": lambda _: b"",
    "longer": lambda content: content + bytes(64),
    "another file": lambda _: b"not a cache file at all" * 1000,
    "digest changed": lambda content: content[:-1] + bytes([content[-1] ^ 1]),
    "shape changed": lambda content: content.replace(b", 8, 8, 3)", b", 8, 4, 6)", 1),
    "shape beyond all bounds": lambda content: content.replace(
        b", 8, 8, 3), }     ", b"1" * 5 + b", 8, 8, 3), }", 1
    ),
    "objects instead of numbers": lambda content: content.replace(b"'<i8'", b"'|O8'", 1),
    "header changed": lambda content: content.replace(b"'|u1'", b"'|i1'", 1),
    "column changed": lambda content: content[:-100] + bytes([content[-100] ^ 1]) + content[-99:],
}


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_a_file_that_is_not_right_is_made_again(data_dir, cache, damage):
    whole = load_transitions(data_dir, "3x3", image_size=8, cache_dir=False)
    load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)
    path = only_file(cache)
    content = path.read_bytes()
    damaged = damage(content)
    assert damaged != content
    path.unlink()  # What is still mapped is not to be cut.
    path.write_bytes(damaged)
    assert_same(load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache), whole)
    assert only_file(cache).read_bytes() == content


def test_a_file_of_another_key_is_made_again(data_dir, cache):
    for split in ("train", "test"):
        load_transitions(data_dir, "3x3", split=split, image_size=8, cache_dir=cache)
    test, train = sorted(cache.iterdir())
    test.replace(train)
    expected = load_transitions(data_dir, "3x3", image_size=8, cache_dir=False)
    assert_same(load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache), expected)


# Folders that cannot be written.


def test_a_folder_that_cannot_be_is_warned_of_and_done_without(data_dir, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.warns(UserWarning, match="the frame cache cannot be used: .* held in memory"):
        kept = load_transitions(data_dir, "3x3", image_size=8, cache_dir=tmp_path / "file")
    assert_same(kept, load_transitions(data_dir, "3x3", image_size=8, cache_dir=False))


def test_a_full_disk_is_warned_of_and_done_without(data_dir, cache, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.warns(UserWarning, match="No space left on device"):
        kept = load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)
    assert_same(kept, load_transitions(data_dir, "3x3", image_size=8, cache_dir=False))
    assert list(cache.iterdir()) == []


# A bound.


def size_of(image_size, data_dir):
    rows = sum(shard.rows for shard in Manifest.read(data_dir / "3x3").of("train"))
    return 3 * image_size**2 * rows


def test_what_was_not_used_for_longest_makes_room(data_dir, cache, monkeypatch):
    for age, image_size in ((3, 8), (1, 9), (2, 10)):
        load_transitions(data_dir, "3x3", image_size=image_size, cache_dir=cache)
        path = next(cache.glob(f"3x3-train-{image_size}-*"))
        os.utime(path, (path.stat().st_atime, path.stat().st_mtime - 1000 * age))
    load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)  # Used again just now.
    kept = sum(path.stat().st_size for path in cache.iterdir())
    oldest = next(cache.glob("3x3-train-10-*")).stat().st_size
    limit = kept - oldest + size_of(11, data_dir)
    monkeypatch.setenv(LIMIT_VARIABLE, str(limit / 1e9))
    load_transitions(data_dir, "3x3", image_size=11, cache_dir=cache)
    sizes = sorted(int(path.name.split("-")[2]) for path in cache.iterdir())
    assert sizes == [8, 9, 11]


def test_a_file_larger_than_the_bound_is_refused_and_others_stay(data_dir, cache, monkeypatch):
    load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)
    monkeypatch.setenv(LIMIT_VARIABLE, "0.0001")
    with pytest.raises(DatasetError, match=f"^the pictures are .* GB, .* higher {LIMIT_VARIABLE}"):
        load_transitions(data_dir, "3x3", image_size=500, cache_dir=cache)
    assert "3x3-train-8-" in only_file(cache).name


@pytest.mark.parametrize("text", ["much", "-1", "nan", "inf"])
def test_a_bound_that_is_no_number_is_refused(data_dir, cache, monkeypatch, text):
    monkeypatch.setenv(LIMIT_VARIABLE, text)
    with pytest.raises(DatasetError, match=f"^{LIMIT_VARIABLE}={text}: give a number of gigabytes"):
        load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)


def test_a_large_file_is_announced(cache):
    with pytest.warns(UserWarning, match=r"writing 0\.0 GB of pictures to .*/name"):
        frame_cache.load(cache / "name", "key", 48, lambda: filled([]), large=48)
    frame_cache.load(cache / "name", "key", 48, lambda: filled([]), large=48)
    frame_cache.load(cache / "other", "key", 48, lambda: filled([]), large=49)


# Several processes.

LOAD = """
import sys
from labyrinth_core import load_transitions
transitions = load_transitions(sys.argv[1], "3x3", image_size=8, cache_dir=sys.argv[2])
print(len(transitions), int(transitions.frames.sum()))
"""


def start(program, *arguments, **how):
    command = [sys.executable, "-W", "error", "-c", program, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **how)


@pytest.mark.slow
def test_processes_that_load_at_once_all_get_it_and_leave_one_file(data_dir, cache):
    expected = load_transitions(data_dir, "3x3", image_size=8, cache_dir=False)
    processes = [start(LOAD, data_dir, cache) for _ in range(4)]
    said = {process.communicate(timeout=120)[0] for process in processes}
    assert said == {f"{len(expected)} {int(expected.frames.sum())}\n"}
    assert all(process.returncode == 0 for process in processes)
    assert only_file(cache).suffix == ".npy"


def test_who_waits_takes_what_the_other_has_made(cache):
    written, found = [], []

    def load():
        found.append(frame_cache.load(cache / "name", "key", 48, lambda: filled(written)))

    threads = [threading.Thread(target=load) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert written == [0, 2]
    for transitions in found:
        assert_same(transitions, found[0])


KILLED = """
import os, signal, sys
from pathlib import Path
import numpy as np
from labyrinth_core.data import frame_cache

def fill():
    yield np.zeros((2, 8, 8, 3), np.uint8), {}
    os.kill(os.getpid(), signal.SIGKILL)

frame_cache.load(Path(sys.argv[1]), "key", 1, fill)
"""


@pytest.mark.slow
@pytest.mark.parametrize("again", ["the same file", "another"])
def test_what_a_killed_process_leaves_does_no_harm_and_is_removed(cache, again):
    path = cache / f"name{frame_cache.SUFFIX}"
    killed = start(KILLED, path)
    killed.communicate(timeout=120)
    assert killed.returncode == -signal.SIGKILL
    left = list(cache.iterdir())
    assert sorted(each.suffix for each in left) == [".holder", ".lock", ".tmp"]
    place = path if again == "the same file" else cache / "other"
    assert len(frame_cache.load(place, "key", 48, lambda: filled([]))) == 2
    assert list(cache.iterdir()) == [place]


def test_a_file_that_somebody_is_writing_is_not_taken_for_a_leftover(data_dir, cache):
    cache.mkdir()
    temporary = temporary_beside(cache / "3x3-s0-8-0.frames.npy")
    temporary.touch()
    with locked(cache / ".3x3-s0-8-0.frames.npy.lock"):
        load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)
        assert temporary.exists()


def test_files_of_others_are_left_alone(data_dir, cache, monkeypatch):
    cache.mkdir()
    names = (".other.npy.tmp", "x.frames.npy", "x.tmp", f"5x5-train-64-{'0' * 16}.frames.npy")
    others = [cache / name for name in names]
    for path in others:
        path.write_bytes(bytes(1_000_000))
    monkeypatch.setenv(LIMIT_VARIABLE, "1e-3")
    load_transitions(data_dir, "3x3", image_size=8, cache_dir=cache)
    assert all(path.exists() for path in others)


# Workers of a DataLoader.


@pytest.fixture
def kept(data_dir, cache):
    return load_transitions(data_dir, "3x3", split="random", image_size=32, cache_dir=cache)


def test_processes_are_sent_the_name_of_the_file_and_not_the_frames(kept):
    sent = pickle.dumps(kept)
    assert kept.frames.nbytes > 1_000_000
    assert len(sent) < 2_000
    received = pickle.loads(sent)
    assert_same(received, kept)
    assert len(pickle.dumps(received)) < 2_000


def test_a_choice_of_transitions_is_sent_as_chosen(kept):
    chosen = replace(kept, **{name: getattr(kept, name)[5:60:3] for name in FIELDS[1:]})
    received = pickle.loads(pickle.dumps(chosen))
    assert_same(received, chosen)
    assert len(pickle.dumps(chosen)) < 5_000


@pytest.mark.parametrize("chosen", [slice(3, 9), slice(0, 0), slice(None, None, -1)])
def test_a_part_of_a_mapped_array_is_received_as_that_part(kept, chosen):
    part = kept.frames[chosen]
    received = as_received(pickle.loads(pickle.dumps(as_sent(part))))
    np.testing.assert_array_equal(received, part)


@pytest.mark.parametrize("content", [None, b"", b"short"])
def test_transitions_whose_file_is_gone_say_so(kept, cache, content):
    sent = pickle.dumps(kept)
    path = only_file(cache)
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(DatasetError, match=r"\A\S+\.npy is gone since it was loaded: [^\n]+\Z"):
        pickle.loads(sent)


WORKERS = """
import multiprocessing, sys
from labyrinth_core import load_transitions

def work(transitions, indices, results):
    steps = transitions.__getitems__(indices)
    sums = [(int(step.observation.sum()), step.action, int(step.next_observation.sum()))
            for step in steps]
    results.put((indices, sums))

if __name__ == "__main__":
    folder, cache, method, count = sys.argv[1:]
    context = multiprocessing.get_context(method)
    t = load_transitions(folder, "3x3", split="random", image_size=32, cache_dir=cache)
    results = context.Queue()
    workers = [
        context.Process(target=work, args=(t, list(range(number, len(t), int(count))), results))
        for number in range(int(count))
    ]
    for worker in workers:
        worker.start()
    got = {}
    for _ in workers:
        got |= dict(zip(*results.get(timeout=60)))
    for worker in workers:
        worker.join()
    expected = [(int(s.sum()), a, int(s_next.sum())) for s, a, s_next in t]
    assert [got[index] for index in range(len(t))] == expected
    print(len(got))
"""


@pytest.mark.slow
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_workers_forked_or_spawned_get_the_same(data_dir, kept, cache, tmp_path, method):
    script = tmp_path / "workers.py"
    script.write_text(WORKERS)
    command = [sys.executable, "-W", "error", str(script), data_dir, cache, method, "3"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False, timeout=120
    )
    assert (done.stdout, done.stderr) == (f"{len(kept)}\n", "")


def test_what_a_worker_makes_a_tensor_of_is_its_own_to_write_to(kept):
    steps = kept.__getitems__([3, 0, 3])
    for step, index in zip(steps, [3, 0, 3], strict=True):
        assert type(step) is Transition
        assert type(step.action) is int
        for array, expected in zip((step[0], step[2]), kept[index][::2], strict=True):
            assert array.flags.writeable
            assert array.flags.c_contiguous
            np.testing.assert_array_equal(array, expected)


@pytest.mark.parametrize(
    "indices", [[5, 2, 2, -1], np.array([7, 0]), slice(2, 9, 3), slice(None), [], np.zeros(0, int)]
)
def test_a_batch_is_the_transitions_of_its_indices(kept, indices):
    if isinstance(indices, list) and not indices:
        indices = np.array(indices, np.int64)
    batch = kept[indices]
    assert type(batch) is TransitionBatch
    each = [kept[index] for index in np.arange(len(kept))[indices].tolist()]
    for place, array in enumerate(batch):
        expected = np.array([step[place] for step in each], array.dtype)
        np.testing.assert_array_equal(array, expected.reshape(array.shape))
        assert array.flags.writeable
    assert batch.observation.shape == (len(each), 32, 32, 3)
