"""The entry point: `labyrinth-datasets size=5`, or `python run.py size=5` in a clone.

`labyrinth-datasets --help` lists the options.
"""

import sys

from pipeline.command import main

if __name__ == "__main__":
    sys.exit(main())
