"""The entry point in a clone: `python run.py size=5` is `labyrinth-datasets size=5`."""

import sys

try:
    from pipeline.__main__ import main
except KeyboardInterrupt:  # The module with the signal handlers is not loaded yet.
    sys.stderr.write("interrupted\n")
    sys.exit(130)

if __name__ == "__main__":
    sys.exit(main())
