"""The way in: `labyrinth-datasets size=5`, or `python run.py size=5` in a clone.

`labyrinth-datasets --help` lists the options.
"""

from __future__ import annotations

import os
import sys
import traceback
from importlib import import_module

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.evaluation.answers import PolicyError
from labyrinth_core.version import __version__
from pipeline.config.errors import ConfigError
from pipeline.config.run import options_of, refusal, register, resolve, with_brackets
from pipeline.config.training import CONF
from pipeline.machinery.executor import cluster


def below(error: PolicyError) -> str:
    """Return the traceback of the error of a policy itself, which is a stranger's code."""
    cause = error.__cause__
    if cause is None:
        return ""
    trace = cause.__traceback__ and cause.__traceback__.tb_next  # Without our own call.
    return "\n" + "".join(traceback.format_exception(type(cause), cause, trace)).rstrip()


@hydra.main(version_base="1.3", config_path=str(CONF.absolute()), config_name="config")
def perform(config: DictConfig) -> None:
    """Perform the stages of one run."""
    try:
        options = options_of(config)
        run = resolve(options)
        with cluster(options.executor, options.workers, options.executor_address):
            for stage in options.stages:
                import_module(run.module_of(stage)).run(run)
    except OmegaConfBaseException as error:
        raise SystemExit(f"error: {refusal(error)}") from error
    except (ConfigError, DatasetError) as error:
        raise SystemExit(f"error: {error}") from error
    except PolicyError as error:
        raise SystemExit(f"error: {error}{below(error)}") from error
    except OSError as error:
        where = error.filename or options.data_dir
        raise SystemExit(f"error: {where}: {error.strerror or error}") from error


def main() -> None:
    """Run what the command line asks for, and exit: 1 for a mistake, which one line explains."""
    if "--version" in sys.argv[1:]:  # Hydra would print its own.
        print(f"labyrinth-datasets {__version__}")
        return
    sys.argv[1:] = map(with_brackets, sys.argv[1:])
    register()
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises; we print the one line that counts.
    try:
        perform()
    except (HydraException, OmegaConfBaseException) as error:
        sys.exit(f"error: {refusal(error)}")
    except ValueError as error:
        if "Config group override" not in str(error):  # What Hydra says of `task=null`.
            raise
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        print("\ninterrupted: the same command goes on from what is finished", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
