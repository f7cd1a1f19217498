"""The way in: `labyrinth-datasets size=5`, or `python run.py size=5` in a clone.

`labyrinth-datasets --help` lists the options.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from pathlib import Path

import hydra
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from labyrinth_core.data.errors import DatasetError
from pipeline.config.errors import ConfigError
from pipeline.config.run import STAGES, RunConfig, refusal, register, resolve
from pipeline.machinery.executor import cluster

_INSTALLED = Path(__file__).with_name("conf")
CONF = _INSTALLED if _INSTALLED.is_dir() else Path(__file__).parents[1] / "conf"
"""The folder of the configuration: in the package once installed, else that of the clone."""


@hydra.main(version_base="1.3", config_path=str(CONF.absolute()), config_name="config")
def perform(config: RunConfig) -> None:
    """Perform the stages of one run."""
    try:
        run = resolve(OmegaConf.to_object(config))  # type: ignore[arg-type]
        with cluster(run.executor, run.workers, run.executor_address):
            for stage in run.stages:
                import_module(STAGES[stage]).run(run)
    except OmegaConfBaseException as error:
        raise SystemExit(f"error: {refusal(error)}") from error
    except (ConfigError, DatasetError) as error:
        raise SystemExit(f"error: {error}") from error
    except OSError as error:
        where = error.filename or run.data_dir
        raise SystemExit(f"error: {where}: {error.strerror or error}") from error


def main() -> None:
    """Run what the command line asks for, and exit: 1 for a mistake, which one line explains."""
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
