"""A season that was judged on twice, and the public part of it after its reveal."""

from __future__ import annotations

import shutil

import pytest
from seasons import Performer


@pytest.fixture(scope="package")
def hidden(tmp_path_factory, make_run):
    """A season that was made, and judged on twice, with what was printed; not to be changed."""
    perform = Performer(tmp_path_factory.mktemp("hidden"), make_run)
    perform("season")
    perform("judge")
    perform("judge")
    return perform


@pytest.fixture
def revealed(hidden, tmp_path, make_run):
    """A copy of the public part of the season after it was revealed."""
    perform = Performer(tmp_path, make_run)
    shutil.copytree(hidden.place.public.parent, perform.place.public.parent)
    perform("reveal")
    assert "is revealed, so nothing more can be judged on it" in perform("judge")
    perform.place.secret.unlink()
    shutil.rmtree(perform.place.private)
    return perform
