"""The fingerprint: the same of the same values and pixels, another of others."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.generation.shard import Fingerprint, Row

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
