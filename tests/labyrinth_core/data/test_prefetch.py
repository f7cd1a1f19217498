"""Items made ahead in a thread: the same items and errors, and nothing left running."""

import subprocess
import sys
import threading

import pytest

from labyrinth_core.data.loader import prefetched


def counted(until, started, closed):
    """Yield numbers, saying in lists what was started and whether all was closed."""
    try:
        for number in range(until):
            started.append(number)
            yield number
    finally:
        closed.append(True)


def threads():
    return [thread.name for thread in threading.enumerate() if "prefetch" in thread.name]


@pytest.mark.parametrize("ahead", [1, 2, 50])
def test_all_items_come_in_order(ahead):
    started, closed = [], []
    assert list(prefetched(counted(20, started, closed), ahead)) == list(range(20))
    assert started == list(range(20))
    assert closed == [True]
    assert threads() == []


def test_nothing_is_done_before_the_first_item_is_asked_for():
    started = []
    prefetched(counted(20, started, []), 5).close()
    assert started == []
    assert threads() == []


def test_items_are_made_ahead_but_no_more_than_asked_for():
    made = threading.Event()
    started = []

    def items():
        for number in range(20):
            started.append(number)
            if number == 3:
                made.set()
            yield number

    ahead = prefetched(items(), 3)
    assert next(ahead) == 0
    assert made.wait(timeout=60)
    ahead.close()
    assert started == [0, 1, 2, 3]


def test_an_error_comes_after_the_items_before_it():
    def items():
        yield 1
        raise KeyError("no such item")

    ahead = prefetched(items(), 5)
    assert next(ahead) == 1
    with pytest.raises(KeyError, match="no such item"):
        next(ahead)
    assert list(ahead) == []
    assert threads() == []


def test_stopping_early_closes_the_items_and_ends_the_thread():
    started, closed = [], []
    for number in prefetched(counted(1000, started, closed), 2):
        if number == 5:
            break
    assert closed == [True]
    assert len(started) <= 9
    assert threads() == []


def test_an_error_of_whoever_reads_ends_the_thread_too():
    closed = []
    ahead = prefetched(counted(1000, [], closed), 2)
    next(ahead)
    with pytest.raises(RuntimeError, match="enough"):
        ahead.throw(RuntimeError("enough"))
    assert closed == [True]
    assert threads() == []


def test_a_program_may_end_in_the_middle():
    program = (
        "from itertools import count\n"
        "from labyrinth_core.data.loader import prefetched\n"
        "numbers = prefetched((number for number in count()), 2)\n"
        "print(next(numbers))\n"
    )
    command = [sys.executable, "-W", "error", "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert (done.stdout, done.stderr) == ("0\n", "")
