"""The fixture `local_hub`: in a conftest.py, `from hub.fixture import local_hub`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from hub.local_hub import LocalHub


@pytest.fixture
def local_hub(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[LocalHub]:
    """Yield a Hub on loopback that is new and empty.

    Its mode is `xet`, or what `@pytest.mark.parametrize("local_hub", MODES, indirect=True)` gives.
    The test fails if the server itself does.
    """
    with LocalHub(tmp_path / "hub", getattr(request, "param", "xet")) as hub:
        yield hub
    assert not hub.failures, "\n".join(hub.failures)
