"""What is no longer there ends in one line that names what to do instead."""

from __future__ import annotations

import pytest
from composing import composed

from pipeline.config.command_line import refusal
from pipeline.config.errors import ConfigError
from pipeline.config.gone import GONE


def refused(*arguments: str) -> str:
    """Return the line that a command line ends in."""
    try:
        composed(*arguments)
    except ConfigError as error:
        return str(error)
    except Exception as error:
        return refusal(error)
    raise AssertionError(f"{arguments} are accepted")


@pytest.mark.parametrize("gone", GONE)
def test_what_went_is_told_with_what_to_do_instead(gone: str) -> None:
    name, _, value = gone.partition("=")
    listed = f"{name}=[{value}]" if name == "stages" else gone if value else f"{name}=1"
    assert refused(listed) == f"{gone} was removed: {GONE[gone]}"


def test_an_option_of_a_group_that_went_is_told_by_its_name() -> None:
    line = f"analysis.seeds was removed: {GONE['analysis']}"
    assert refused("analysis.seeds=4") == line
