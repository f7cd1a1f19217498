"""A set of keys in little memory is a set."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from pipeline.generation.identity import IdSet

# Many that share their low bits, where slots are sought.
KEYS = st.one_of(
    st.integers(0, 2**63 - 1),
    st.integers(0, 2**20 - 1).map(lambda number: number << 40),
    st.integers(0, 30),
)


@given(st.lists(KEYS, max_size=200))
def test_a_key_is_new_once(keys: list[int]) -> None:
    ours, theirs = IdSet(), set[int]()
    for key in keys:
        assert ours.add(key) == (key not in theirs)
        theirs.add(key)


def test_it_keeps_all_keys_as_it_grows() -> None:
    ours = IdSet()
    keys = [number * 0x9E3779B97F4A7C15 % 2**63 for number in range(20_000)]
    assert all(ours.add(key) for key in keys)
    assert not any(ours.add(key) for key in keys)
