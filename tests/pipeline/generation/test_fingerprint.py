"""The fingerprint: the same of the same values and pixels, another of others."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labyrinth_core.data.columns import Row
from pipeline.generation.fingerprint import (
    Fingerprint,
    PictureDigest,
    decoded_picture_digest,
    picture_digest,
)

rows = st.builds(
    Row,
    obs=st.just(b""),
    obs_path=st.just(""),
    actions=st.integers(-1, 3),
    rewards=st.floats(width=32, allow_nan=False),
    episode_starts=st.booleans(),
    info=st.text(max_size=9),
    picture_digest=st.binary(min_size=16, max_size=16),
)


def fingerprint(some_rows: list[Row]) -> str:
    fingerprint = Fingerprint()
    fingerprint.update(some_rows)
    return fingerprint.hexdigest()


@pytest.mark.slow
@given(st.lists(rows, max_size=4), st.lists(rows, max_size=4))
def test_other_rows_have_another_fingerprint(some: list[Row], others: list[Row]) -> None:
    # The value minus zero is equal to zero, and yet not the same bytes.
    same = [(row, str(row.rewards)) for row in some] == [(row, str(row.rewards)) for row in others]
    assert (fingerprint(some) == fingerprint(others)) == same


@pytest.mark.slow
@given(st.lists(rows, min_size=1, max_size=4), st.data())
def test_any_change_of_a_row_changes_the_fingerprint(some: list[Row], data: st.DataObject) -> None:
    place = data.draw(st.integers(0, len(some) - 1))
    row = some[place]
    change = data.draw(
        st.sampled_from(
            [
                {"actions": row.actions + 1},
                {"rewards": row.rewards + 1 if abs(row.rewards) < 1e6 else 0.5},
                {"episode_starts": not row.episode_starts},
                {"info": row.info + " "},
                {"picture_digest": bytes(15) + bytes([row.picture_digest[15] ^ 1])},
            ]
        )
    )
    if "picture_digest" in change:
        change["picture_digest"] = row.picture_digest[:15] + change["picture_digest"][15:]
    changed = [*some[:place], row._replace(**change), *some[place + 1 :]]
    assert fingerprint(changed) != fingerprint(some)


pictures = st.lists(
    st.tuples(st.binary(min_size=6, max_size=6), st.integers(1, 4)), min_size=1, max_size=6
)


def pixels(bands: list[tuple[bytes, int]]) -> np.ndarray:
    picture = np.frombuffer(b"".join(row * count for row, count in bands), np.uint8)
    return picture.reshape(-1, 2, 3)


@given(pictures)
def test_a_picture_has_the_same_digest_in_bands_and_decoded(bands: list[tuple[bytes, int]]) -> None:
    assert picture_digest([tuple(bands)]) == decoded_picture_digest(pixels(bands))


@given(pictures, st.integers(0))
def test_a_digest_does_not_depend_on_where_bands_are_cut(
    bands: list[tuple[bytes, int]], place: int
) -> None:
    row, count = bands[place % len(bands)]
    cut = [*bands[: place % len(bands)], *[(row, 1)] * count, *bands[place % len(bands) + 1 :]]
    assert picture_digest([tuple(cut)]) == picture_digest([tuple(bands)])


@given(pictures, pictures)
def test_other_pixels_have_another_digest(
    some: list[tuple[bytes, int]], others: list[tuple[bytes, int]]
) -> None:
    same = pixels(some).tobytes() == pixels(others).tobytes()
    assert (picture_digest([tuple(some)]) == picture_digest([tuple(others)])) == same


@given(pictures, st.lists(pictures, min_size=1, max_size=4), st.data())
def test_a_picture_with_strips_exchanged_has_the_digest_it_has_anew(
    above: list[tuple[bytes, int]], others: list[list[tuple[bytes, int]]], data: st.DataObject
) -> None:
    strips = [tuple(above), *map(tuple, others)]
    places = data.draw(st.sets(st.integers(0, len(strips) - 1)))
    changes = {
        place: tuple(
            (data.draw(st.binary(min_size=6, max_size=6)), count) for _, count in strips[place]
        )
        for place in sorted(places)
    }
    changed = [changes.get(place, strip) for place, strip in enumerate(strips)]
    assert PictureDigest(strips).digest(changes) == picture_digest(changed)


def test_the_digest_is_the_polynomial_that_is_written_down() -> None:
    rows = [b"abcdef", b"ghijkl", b"ghijkl", b"abcdef"]
    base, modulus = 0x4F1BBCDCBFA53E0AF9CE60302E76E41A, 2**127 - 1
    value = 0
    for row in rows:
        hashed = hashlib.blake2b(row, digest_size=16).digest()
        value = (value * base + int.from_bytes(hashed, "little")) % modulus
    assert picture_digest([((row, 1),) for row in rows]) == value.to_bytes(16, "little")


@pytest.mark.parametrize("apart", [1, 2, 127, 254, 381])
def test_rows_exchanged_far_from_each_other_change_the_digest(apart: int) -> None:
    rows = [bytes([number % 251, number // 251]) * 3 for number in range(600)]
    exchanged = rows.copy()
    exchanged[0], exchanged[apart] = rows[apart], rows[0]
    digests = [picture_digest([((row, 1),) for row in some]) for some in (rows, exchanged)]
    assert digests[0] != digests[1]
