"""Runs and options as a command line asks for them."""

from __future__ import annotations

from hydra import compose, initialize_config_dir

from pipeline.command.command_line import HYDRA, as_given, parsed, register
from pipeline.command.composed import CONF, options_of
from support.making import Run, RunConfig, resolve


def composed(*arguments: str) -> Run:
    """Return the run that a command line asks for."""
    register()
    given = parsed(arguments).overrides
    with initialize_config_dir(str(CONF), **HYDRA):
        options = options_of(as_given(compose("config", given), given), given)
    return resolve(RunConfig(**vars(options)))
