"""The way in: the command `labyrinth`."""

from __future__ import annotations

import sys


def main() -> int:
    """Return the exit status of the command line of the process: 130 after Ctrl-C."""
    try:
        # Imported within `try`: somebody may press Ctrl-C at once.
        from labyrinth_core.command.main import main as run

        return run()
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
