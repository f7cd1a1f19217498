"""The entry point: `labyrinth-datasets size=5`, or `python run.py size=5` in a clone.

`labyrinth-datasets --help` lists the options.
"""

from __future__ import annotations

import sys


def main() -> int:
    """Run what the command line asks for, and return the exit status: 1 for an error."""
    try:
        # Imported within `try`: it takes half a second, in which Ctrl-C may be pressed.
        from pipeline.command import run_command

        return run_command()
    except KeyboardInterrupt:
        print("\ninterrupted: the same command goes on from what is finished", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
