"""The command line: from what was typed to the jobs of stages, their run, and its end.

Hydra and OmegaConf are used here alone; stages are loaded by name. This first code of a command
answers signals before libraries are imported.
"""

from __future__ import annotations

import sys

try:
    from pipeline.command.ending import (
        answer_signals,
        end,
        end_interrupted,
        end_without_output,
        show_start,
    )
except KeyboardInterrupt:  # No signal handler is installed yet.
    from pipeline.command.ending import end_interrupted

    end_interrupted()


def main() -> int:
    """Run the command line and return the exit status, 1 after an error."""
    answer_signals(end_interrupted)  # Imports take seconds, and may swallow exceptions.
    try:
        from labyrinth_core.errors import escape_output

        escape_output()
        show_start()
        from pipeline.command.launch import run_command

        status = run_command()
        sys.stdout.flush()
    except ModuleNotFoundError as error:
        if error.name != "hydra":
            raise
        end(1, "error: hydra is not installed: `pip install .` in the clone installs all libraries")
    except KeyboardInterrupt as interruption:
        end_interrupted(*interruption.args)
    except OSError as error:
        end_without_output(error)
    return status
