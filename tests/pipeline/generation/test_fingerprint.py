"""The fingerprint: the same of the same values and pixels, another of others."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labyrinth_core.pictures.png import Strip, strips_in
from pipeline.generation.fingerprint import Fingerprint, PictureDigest, Row

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
                {"picture_digest": row.picture_digest[:15] + bytes([row.picture_digest[15] ^ 1])},
            ]
        )
    )
    changed = [*some[:place], row._replace(**change), *some[place + 1 :]]
    assert fingerprint(changed) != fingerprint(some)


pictures = st.lists(
    st.tuples(st.binary(min_size=6, max_size=6), st.integers(1, 4)), min_size=1, max_size=6
)


def pixels(bands: list[tuple[bytes, int]]) -> np.ndarray:
    picture = np.frombuffer(b"".join(row * count for row, count in bands), np.uint8)
    return picture.reshape(-1, 2, 3)


def digest(*strips: Strip) -> bytes:
    return PictureDigest(strips).digest({})


@given(pictures)
def test_a_picture_has_the_same_digest_in_bands_and_decoded(bands: list[tuple[bytes, int]]) -> None:
    assert digest(tuple(bands)) == digest(*strips_in(pixels(bands)))


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
    assert PictureDigest(strips).digest(changes) == digest(*changed)


def test_the_digest_is_the_polynomial_that_is_written_down() -> None:
    rows = [b"abcdef", b"ghijkl", b"ghijkl", b"abcdef"]
    base, modulus = 0x4F1BBCDCBFA53E0AF9CE60302E76E41A, 2**127 - 1
    value = 0
    for row in rows:
        hashed = hashlib.blake2b(row, digest_size=16).digest()
        value = (value * base + int.from_bytes(hashed, "little")) % modulus
    assert digest(*(((row, 1),) for row in rows)) == value.to_bytes(16, "little")
