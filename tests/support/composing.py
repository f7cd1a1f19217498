"""Runs and options as a command line asks for them."""

from __future__ import annotations

from hydra import compose, initialize_config_dir

from pipeline.config.command_line import HYDRA, parsed, register
from pipeline.config.method import CONF
from pipeline.config.run import Run, options_of, resolve
from pipeline.config.texts import as_given


def composed(*arguments: str) -> Run:
    """Return the run that a command line asks for."""
    register()
    given = parsed(arguments).overrides
    with initialize_config_dir(str(CONF), **HYDRA):
        return resolve(options_of(as_given(compose("config", given), given), given))
