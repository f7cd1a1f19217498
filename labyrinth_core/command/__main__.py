"""The entry point of the command `labyrinth`."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from labyrinth_core.command.arguments import ERRORS, explain, parser
from labyrinth_core.errors import escape_output


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status: 0, 1 after an error message, or 130 after Ctrl-C.

    Args:
        arguments: The command line after `labyrinth`; None for the process's own arguments.
    """
    escape_output()
    try:
        options = parser().parse_args(arguments)
        from labyrinth_core.command.commands import COMMANDS  # Imports NumPy: not for --help.

        status = COMMANDS[options.command](options)
        sys.stdout.flush()
    except SystemExit as stop:  # From argparse, which has printed the reason.
        return int(stop.code or 0)
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader of the output is gone, so discard what is left in the buffer.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except ERRORS as error:
        explain(error)
        return 1
    return status


if __name__ == "__main__":
    sys.exit(main())
