"""Values as bytes: equal where an agent can tell no difference, and different where it can."""

from __future__ import annotations

import copy
from collections import OrderedDict
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from labyrinth_core.benchmarks import encode
from labyrinth_core.benchmarks.encoding import Tape, leaves

OBJECTS = np.array([["a", [1]], ["b", {2: None}]], object)
PAIRS = np.array([(1, 2.0)], [("a", "i4"), ("b", "f8")])

ALIKE = {
    "the order of keys": ({"a": 1, "b": 2}, {"b": 2, "a": 1}),
    "kinds of dictionaries": ({"a": 1}, OrderedDict(a=1)),
    "the sign of zero": (-0.0, 0.0),
    "in arrays, too": (np.array([-0.0, 1]), np.array([0.0, 1])),
    "NaN": (float("nan"), -float("nan")),
    "NaN in arrays": (np.array([np.nan, 1], "f4"), np.array([-np.nan, 1], "f4")),
    "numbers of NumPy": (3, np.int16(3)),
    "truths of NumPy": (True, np.bool_(True)),
    "memory layout": (np.arange(6).reshape(2, 3), np.asfortranarray(np.arange(6).reshape(2, 3))),
    "objects": (OBJECTS, np.array(OBJECTS.tolist(), object)),
    "sets": ({"x", "y", "z"}, {"z", "y", "x"}),
    "records": (PAIRS, PAIRS.copy()),
    "kinds of sets": ({"x"}, frozenset("x")),
    "kinds of texts": ("a", np.str_("a")),
    "single floats": (np.float32(-0.0), 0.0),
    "dictionaries in arrays": tuple(
        np.array([each], object) for each in ({1: 2, 3: 4}, {3: 4, 1: 2})
    ),
    "views of memory": (memoryview(b"ab"), memoryview(bytes([97, 98]))),
    "lists and tuples": ([1, (2,)], (1, [2])),
}
APART = {
    "where a text ends": (("ab", "c"), ("a", "bc")),
    "nesting": (((1,), 2), ((1, 2),)),
    "text and bytes": ("a", b"a"),
    "one and true": (1, True),
    "one and 1.0": (1, 1.0),
    "shapes": (np.zeros((2, 3)), np.zeros((3, 2))),
    "types": (np.zeros(2, "f4"), np.zeros(2, "f8")),
    "nothing and none": ((), None),
    "spaces": ("a  b", "a b"),
    "nothing below a key": ({"a": {}}, {}),
    "types of whole numbers": (np.zeros(2, "i4"), np.zeros(2, "i8")),
    "empty shapes": (np.zeros((0, 2)), np.zeros((0, 3))),
    "views of memory": (memoryview(b"ab"), memoryview(b"ac")),
    "keys and values": ({"a": "b"}, {"b": "a"}),
    "objects": (OBJECTS, OBJECTS.T.copy()),
    "large numbers": (10**30, 10**30 + 1),
    "long doubles": (np.longdouble(1), np.longdouble(2)),
    "dates": (np.datetime64("2026-01-01"), np.datetime64("2026-01-02")),
    "surrogates": ("\ud800", "\ud801"),
}


@pytest.mark.parametrize(("one", "other"), ALIKE.values(), ids=ALIKE)
def test_what_no_agent_can_tell_apart_has_equal_bytes(one, other):
    assert encode(one) == encode(other)
    assert dict(leaves(one, "x")) == dict(leaves(other, "x"))


@pytest.mark.parametrize(("one", "other"), APART.values(), ids=APART)
def test_what_differs_has_other_bytes(one, other):
    assert encode(one) != encode(other)
    assert dict(leaves(one, "x")) != dict(leaves(other, "x"))


def test_a_value_that_cannot_be_compared_is_refused():
    with pytest.raises(TypeError, match="a value of type Fraction cannot be compared"):
        encode({"a": [Fraction(1, 2)]})


def test_the_parts_of_a_value_are_named_and_shown():
    value = {"image": np.zeros((4, 5), np.uint8), "at": (1, np.array([2.5])), "text": "x" * 99}
    found = dict(leaves(value, "observation"))
    assert found["observation['image']"].startswith("uint8 array of 4 x 5, digest ")
    assert found["observation['at'][1]"] == "[2.5]"
    assert found["observation['text']"].startswith("'" + "x" * 59 + "... digest ")


FLOATS = np.array([-0.0, 1.5, np.nan, -np.nan])
OBSERVATIONS = [
    *(FLOATS.astype(kind) for kind in ("f2", "f4", ">f4", "f8", "c16")),
    *(FLOATS[:3], FLOATS[::2], np.ones(4), np.ones((2, 2)), FLOATS.reshape(2, 2).T),
    *(np.zeros((0, 3)), np.array(-0.0), np.arange(4), np.arange(4, dtype="u1"), FLOATS > 1),
    *(OBJECTS, PAIRS, np.array(["a"]), "text", 3, None, {"a": FLOATS}, (FLOATS, 1)),
]
REWARDS = [1.0, 1, 0.0, -0.0, True, None, np.float32(1), np.float64(1), float("nan"), np.array(1.0)]
STEPS = st.tuples(
    st.sampled_from(OBSERVATIONS),
    st.sampled_from(REWARDS),
    st.sampled_from([False, False, False, True, np.False_, 0, 1]),
    st.sampled_from([False, False, True]),
)
EPISODES = st.tuples(st.sampled_from(OBSERVATIONS), st.lists(STEPS, max_size=5))


@example([(OBSERVATIONS[0], [(OBSERVATIONS[0], None, False, False)])])
@example([(OBSERVATIONS[0], [(OBSERVATIONS[0], each, False, False) for each in (1.0, 1, 1.0)])])
@given(st.lists(EPISODES, max_size=4))
def test_a_tape_has_the_bytes_of_everything_though_it_is_overwritten_afterwards(episodes):
    tape, firsts, codes, arrays = Tape(), [], [], []
    for first, steps in episodes:
        shown = []

        def show(observation, shown=shown):
            """Return an observation in which the last one shown is overwritten."""
            if shown and isinstance(shown[-1], np.ndarray) and shown[-1].dtype.kind in "biuf":
                shown[-1][...] = 7
            shown.append(copy.deepcopy(observation))
            return shown[-1]

        def step(place, steps=steps, show=show):
            observation, *rest = steps[place]
            return show(observation), *rest, {}

        # Without its last step, an episode that fails is not on the tape.
        tape.begin(show(first))
        tape.play(step, range(len(steps)))
        tape.cut(len(firsts))
        tape.begin(show(first))
        tape.play(step, range(len(steps)))
        ends = [bool(terminated or truncated) for *_, terminated, truncated in steps]
        taken = steps[: ends.index(True) + 1] if True in ends else steps
        firsts.append(encode(first))
        codes.append(encode(first) + b"".join(map(encode, taken)))
        seen = [first, *(observation for observation, *_ in taken)]
        arrays += [x for x in seen if isinstance(x, np.ndarray) and x.dtype.kind in "biuf"]
    probes = 1 + (len(episodes) % 2 == 0)
    found = [*tape.seeds(probes)]
    assert [(first, code) for first, code, _ in found] == [
        (firsts[at : at + probes], b"".join(codes[at : at + probes]))
        for at in range(0, len(codes), probes)
    ]
    alike = [each for *_, stacked in found for array in stacked for each in array]
    assert all(map(np.array_equal, alike, arrays, [True] * len(arrays)))
    assert len(alike) == len(arrays)
