"""Runs and options as a command line asks for them."""

from __future__ import annotations

from hydra import compose, initialize_config_dir

from pipeline.config.command_line import HYDRA, keep_texts, register
from pipeline.config.run import Run, options_of, resolve
from pipeline.config.training import CONF


def composed(*arguments: str) -> Run:
    """Return the run that a command line asks for."""
    register()
    with initialize_config_dir(str(CONF.absolute()), **HYDRA):
        return resolve(options_of(compose("config", [*map(keep_texts, arguments)])))
