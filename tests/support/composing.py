"""Runs and options as a command line asks for them."""

from __future__ import annotations

from hydra import compose, initialize_config_dir

from pipeline.command import command_line
from pipeline.command.composed import CONF, options_of
from support.making import Run, RunConfig, resolve


def composed(*arguments: str) -> Run:
    """Return the run that a command line asks for."""
    command_line.register()
    given = command_line.parsed(arguments).overrides
    with initialize_config_dir(str(CONF), **command_line.HYDRA):
        options = options_of(command_line.as_given(compose("config", given), given), given)
    return resolve(RunConfig(**vars(options)))
