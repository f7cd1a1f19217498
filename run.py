"""The entry point in a clone: `python run.py size=5` is `labyrinth-datasets size=5`."""

import sys

from pipeline.__main__ import main

if __name__ == "__main__":
    sys.exit(main())
