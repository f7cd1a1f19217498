"""Export the demonstrations of more and more labyrinths, and measure time and memory.

    python scripts/benchmark_export.py --folder measured
    python scripts/benchmark_export.py --folder measured --labyrinths 2040 --formats lerobot

Each export is a process of its own, whose peak resident set and processor time are printed. Its
folder is removed afterwards; the datasets stay.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from measuring import machine, run_command

from labyrinth_core.data.manifest import Manifest
from pipeline.config.export import EXPORTS

LABYRINTHS = (2_040, 20_400, 102_000)
"""Some 20,000, 200,000 and 1,000,000 rows of train at 5x5."""


def main() -> None:
    """Make the datasets, export each in every format, and print a row for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, required=True, help="of datasets and exports")
    parser.add_argument("--labyrinths", type=int, nargs="+", default=LABYRINTHS, help="in train")
    parser.add_argument("--formats", nargs="+", choices=EXPORTS, default=list(EXPORTS))
    arguments = parser.parse_args()
    exports = arguments.folder / "exports"
    print(machine("minari", "h5py", "datasets", "pyarrow", "numpy"))
    print("| format | rows | peak MB | seconds | processor us a row |\n|---|---|---|---|---|")
    for labyrinths in arguments.labyrinths:
        data = arguments.folder / str(labyrinths)
        common = ["size=5", f"labyrinths={labyrinths}", "random_steps=1", f"data_dir={data}"]
        run_command(*common, "stages=[build]")
        rows = sum(shard.rows for shard in Manifest.read(data / "5x5").of("train"))
        for format_ in arguments.formats:
            options = [f"export.format={format_}", "export.splits=[train]"]
            cost = run_command(*common, "stages=[export]", *options, f"export.folder={exports}")
            shutil.rmtree(exports)
            each = cost.cpu / rows * 1e6
            print(f"| {format_} | {rows:,} | {cost.memory} | {cost.seconds:.0f} | {each:.0f} |")


if __name__ == "__main__":
    main()
