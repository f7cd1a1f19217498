"""Keep the lengths and numbers of optimal routes that docs/studies/results.md compares.

    python scripts/studies/keep_routes.py data/labyrinth data/twohundred data/thousand

Each folder holds a dataset of 5x5. Writes a file for each into docs/results/routes.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import pyarrow.parquet as pq

from labyrinth_core.data.manifest import MANIFEST
from labyrinth_core.data.schema import read_json
from labyrinth_core.data.storage import write_text

SPLITS = ("train", "test", "longer", "test_new_routes")


def main() -> None:
    """Write the files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--config", default="5x5")
    parser.add_argument("--results", type=Path, default=Path("docs/results/routes"))
    given = parser.parse_args()
    given.results.mkdir(parents=True, exist_ok=True)
    for folder in given.folders:
        source = folder / given.config
        columns = ["split", "labyrinth_id", "moves", "optimal_routes"]
        rows = pq.read_table(source / "labyrinths.parquet", columns=columns).to_pylist()
        fingerprint = read_json(source / MANIFEST)["fingerprint"]
        parts = [f'"fingerprint": {json.dumps(fingerprint)}']
        for split in SPLITS:
            routes = {
                row["labyrinth_id"]: [row["moves"], row["optimal_routes"]]
                for row in rows
                if row["split"] == split
            }
            if routes:
                parts.append(f'"{split}": {json.dumps(routes, separators=(",", ":"))}')
        count = sum(row["split"] == "train" for row in rows)
        write_text(given.results / f"{count}.json", "{\n" + ",\n".join(parts) + "\n}\n")


if __name__ == "__main__":
    main()
