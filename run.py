"""The way in: `python run.py size=5`. `python run.py --help` lists the options."""

import os
import sys
from importlib import import_module

import hydra
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from pipeline.config import STAGES, ConfigError, RunConfig, refusal, register, resolve
from pipeline.executor import cluster
from pipeline.manifest import DatasetError


@hydra.main(version_base="1.3", config_path="conf", config_name="config")
def main(config: RunConfig) -> None:
    """Perform the stages of one run."""
    try:
        run = resolve(OmegaConf.to_object(config))
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


if __name__ == "__main__":
    register()
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises; we print the one line that counts.
    try:
        main()
    except (HydraException, OmegaConfBaseException) as error:
        sys.exit(f"error: {refusal(error)}")
    except ValueError as error:
        if "Config group override" not in str(error):  # What Hydra says of `task=null`.
            raise
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        print("\ninterrupted: the same command goes on from what is finished", file=sys.stderr)
        sys.exit(130)
