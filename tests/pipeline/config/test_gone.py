"""What is no longer there ends in one line that names what to do instead."""

from __future__ import annotations

from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir

from pipeline.config.errors import ConfigError
from pipeline.config.gone import GONE
from pipeline.config.run import VERSION_BASE, options_of, refusal, register, resolve

CONF = Path(__file__).parents[3] / "conf"


def refused(*arguments: str) -> str:
    """Return the line that a command line ends in."""
    register()
    try:
        with initialize_config_dir(str(CONF), **VERSION_BASE):
            resolve(options_of(compose("config", list(arguments))))
    except ConfigError as error:
        return str(error)
    except Exception as error:
        return refusal(error)
    raise AssertionError(f"{arguments} are accepted")


@pytest.mark.parametrize("gone", GONE)
def test_what_went_is_told_with_what_to_do_instead(gone: str) -> None:
    name, _, value = gone.partition("=")
    listed = f"{name}=[{value}]" if name == "stages" else gone if value else f"{name}=1"
    assert refused(listed) == f"{gone} is no longer there: {GONE[gone]}"


def test_an_option_of_a_group_that_went_is_told_by_its_name() -> None:
    line = f"analysis.seeds is no longer there: {GONE['analysis']}"
    assert refused("analysis.seeds=4") == line
