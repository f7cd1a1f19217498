"""Export the demonstrations of more and more labyrinths, and measure time and memory.

    python scripts/benchmark_export.py --folder measured
    python scripts/benchmark_export.py --folder measured --labyrinths 2040 --formats lerobot

Each export is a process of its own, whose peak resident set and processor time are printed. Its
folder is removed afterwards; the datasets stay.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

from measuring import machine

from labyrinth_core.data.manifest import Manifest
from pipeline.config.export import EXPORTS

RUN = Path(__file__).resolve().parents[1] / "run.py"
LABYRINTHS = (2_040, 20_400, 102_000)
"""Some 20,000, 200,000 and 1,000,000 rows of train at 5x5."""


def command(folder: Path, labyrinths: int) -> list[str]:
    """Return the command line of a dataset, without its stages."""
    common = [sys.executable, str(RUN), "size=5", f"labyrinths={labyrinths}", "random_steps=1"]
    return [*common, f"data_dir={folder / str(labyrinths)}"]


def measured(folder: Path, labyrinths: int, format_: str) -> tuple[int, float, float]:
    """Return the peak resident set in MB, and the seconds and processor seconds of an export."""
    place = folder / "exports"
    asked = ["stages=[export]", f"export.format={format_}", "export.splits=[train]"]
    begun = time.perf_counter()
    process = subprocess.Popen(
        [*command(folder, labyrinths), *asked, f"export.folder={place}"], stdout=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"{format_}, {labyrinths} labyrinths: status {status}")
    seconds = time.perf_counter() - begun
    shutil.rmtree(place)
    return usage.ru_maxrss // 1000, seconds, usage.ru_utime + usage.ru_stime


def main() -> None:
    """Make the datasets, export each in every format, and print a row for each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--folder", type=Path, required=True, help="of datasets and exports")
    parser.add_argument("--labyrinths", type=int, nargs="+", default=LABYRINTHS, help="in train")
    parser.add_argument("--formats", nargs="+", choices=EXPORTS, default=list(EXPORTS))
    arguments = parser.parse_args()
    print(machine("minari", "h5py", "datasets", "pyarrow", "numpy"))
    print("| format | rows | peak MB | seconds | processor us a row |\n|---|---|---|---|---|")
    for labyrinths in arguments.labyrinths:
        build = [*command(arguments.folder, labyrinths), "stages=[build]"]
        subprocess.run(build, check=True, stdout=subprocess.DEVNULL)
        manifest = Manifest.read(arguments.folder / str(labyrinths) / "5x5")
        rows = sum(shard.rows for shard in manifest.of("train"))
        for format_ in arguments.formats:
            peak, seconds, processor = measured(arguments.folder, labyrinths, format_)
            each = processor / rows * 1e6
            print(f"| {format_} | {rows:,} | {peak} | {seconds:.0f} | {each:.0f} |", flush=True)


if __name__ == "__main__":
    main()
