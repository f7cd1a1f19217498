"""Check that this tree and another commit produce the same datasets, loads, weights and results.

    python scripts/corpus.py             # compare with the commit in `BASE`
    python scripts/corpus.py COMMIT      # compare with another commit
    python scripts/corpus.py --keep DIR  # keep the outputs of both in DIR
    python scripts/corpus.py --compare DIR  # only compare kept outputs again

Datasets are built, loaded, trained on and evaluated with this environment, in the current tree and
in a worktree of the other commit, at the same time. The table says for each part whether it is the
same, or what differs. No file hash is committed, because hashes depend on zlib and the processor.
The exit status is 1 if anything differs.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from hashlib import sha256
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from safetensors.numpy import load_file

ROOT = Path(__file__).resolve().parents[1]

BASE = "6d6da1f"
"""The commit to compare the current tree with by default."""

TREES = ("current", "base")
"""The folders with the outputs of the two trees."""

DATASETS = {
    "plain": ["size=3"],
    "key": ["size=4 task=key_and_door labyrinths=24 random_steps=60 shifts=all"],
    "shifted": ["size=5 shifts=all"],
    "ice": ["size=5 task=icy_floor solutions=all shifts=all"],
    "partial": ["size=4x6 task=partial_observability goals=varied"],
    "noise": ["size=5 demonstrations.noise=0.3"],
    "shards": ["size=20 labyrinths=1400 random_steps=1 stages=build"],
    "long": ["size=100 labyrinths=2 random_steps=4000 sampler=depth_first stages=build"],
    "grown": ["size=5 labyrinths=50 stages=build", "size=5 stages=build [grow=true]"],
    "mended": ["size=3 stages=build", "DAMAGE", "size=3 stages=build"],
    "parts": [*(f"size=5 stages=build part={part}/3" for part in (1, 2, 3)), "size=5"],
}
"""Dataset -> the options of the runs that build it. Options in brackets are dropped in a tree that
does not know them; `DAMAGE` changes a byte in a shard and in the table. Dataset `shards` has more
labyrinths than fit into a shard, and several chunks of candidates; in `long` an episode spans
several row groups."""

EVALUATIONS = {
    "planner": "method=planner",
    "chance": "policy=corpus_part:chance evaluation.name=chance evaluation.episodes=5",
}
"""Evaluation -> the options of a policy: the released planner, and uniformly random actions."""

TRAININGS = {
    f"{method}-seed{seed}": f"method={method} method.epochs=3 seed={seed}"
    for method, seed in product(("bc", "planner"), (0, 1))
}
"""Policy -> the options of its training."""

SHOWN = 5
"""The maximum number of differences that the table names per part."""


# Producing the outputs.


class Tree:
    """A tree of the project, and the folder of its outputs."""

    def __init__(self, code: Path, folder: Path) -> None:
        self.code, self.folder = code, folder
        folder.mkdir(parents=True)
        self.environment = os.environ | {
            "PYTHONPATH": os.pathsep.join([str(code), str(ROOT / "scripts")]),
            "XDG_CACHE_HOME": str(folder / "work/cache"),
            "HF_HUB_OFFLINE": "1",
            "CUDA_VISIBLE_DEVICES": "",
        }
        self.options = self.call("run.py", "--help")

    def call(self, script: str | Path, *arguments: str) -> str:
        """Run a Python script of the tree, or one with an absolute path; return its output.

        Raises:
            RuntimeError: The script fails.
        """
        command = [sys.executable, str(self.code / script), *arguments]
        done = subprocess.run(
            command, cwd=self.folder, env=self.environment, capture_output=True, text=True
        )
        if done.returncode:
            end = "\n".join((done.stdout + done.stderr).splitlines()[-20:])
            raise RuntimeError(f"{self.folder.name}: {shlex.join(command)}\n{end}")
        return done.stdout

    def run(self, options: str) -> None:
        """Run stages with those options that the tree knows."""
        named = [
            option.strip("[]")
            for option in shlex.split(options)
            if option[0] != "[" or f" {option[1:].partition('=')[0]} " in self.options
        ]
        self.call("run.py", *named, "workers=1")

    def make(self) -> None:
        """Produce all parts of the corpus."""
        for name, runs in DATASETS.items():
            for options in runs:
                if options == "DAMAGE":
                    damage(self.folder / f"data/{name}/3x3")
                else:
                    self.run(f"{options} data_dir=data/{name}")
        self.call(ROOT / "scripts/corpus_part.py", "memory", "data/memory")
        self.call(ROOT / "scripts/corpus_part.py", "loads", "loads.json")
        self._learn()
        self._evaluate()
        shutil.rmtree(self.folder / "work")

    def _learn(self) -> None:
        weights = self.folder / "weights"
        weights.mkdir()
        for name, options in TRAININGS.items():
            runs = f"work/trained/{name}"
            self.run(f"stages=train size=5 {options} data_dir=data/parts run_dir={runs} threads=1")
            (policy,) = (self.folder / runs).glob("5x5/*/*.safetensors")
            shutil.copy(policy, weights / f"{name}.safetensors")

    def _evaluate(self) -> None:
        """Evaluate policies, and add them to a copy of the tree's leaderboard."""
        shutil.copytree(self.code / "docs/results", self.folder / "work/results")
        shutil.copytree(self.code / "docs/results/released", self.folder / "work/runs")
        places = "size=5 data_dir=data/parts run_dir=work/runs results_dir=work/results threads=1"
        for name, options in EVALUATIONS.items():
            self.run(f"stages=evaluate {options} {places}")
            (results,) = (self.folder / "work/runs/5x5").glob(f"{name}*/results.json")
            (self.folder / "evaluations").mkdir(exist_ok=True)
            shutil.copy(results, self.folder / f"evaluations/{name}.json")
        self.run(f"stages=results {places}")
        (self.folder / "board").mkdir()
        for board in (self.folder / "work/results").glob("*.csv"):
            shutil.copy(board, self.folder / "board")


def damage(folder: Path) -> None:
    """Change a byte in the middle of a dataset's first shard, and of its table."""
    for path in (next(folder.glob("train-*.parquet")), folder / "labyrinths.parquet"):
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)


@contextmanager
def worktree(commit: str) -> Iterator[Path]:
    """Yield the folder of a worktree of a commit, and remove the worktree afterwards."""
    with TemporaryDirectory(prefix="corpus-") as folder:
        code = Path(folder, "base")
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(code), commit], check=True)
        try:
            yield code
        finally:
            subprocess.run([*git, "remove", "--force", str(code)], check=True)


def make(commit: str, folder: Path) -> None:
    """Produce the corpus with the current tree and with a commit, both at the same time."""
    with worktree(commit) as base, ThreadPoolExecutor(2) as threads:
        trees = [Tree(code, folder / name) for code, name in zip((ROOT, base), TREES, strict=True)]
        for made in [threads.submit(tree.make) for tree in trees]:
            made.result()


# Comparing.


def parts(folder: Path) -> dict[str, Callable[[], list[str]]]:
    """Return the parts of a corpus by name, each with a function that lists its differences."""
    both = [folder / name for name in TREES]
    names = sorted({path.name for tree in both for path in tree.glob("data/*")})
    found = {f"data/{name}": True for name in names}
    found |= dict.fromkeys(("loads.json", "evaluations", "board", "weights"), False)
    return {
        name: lambda name=name, exact=exact: differences(*(tree / name for tree in both), exact)
        for name, exact in found.items()
    }


def differences(current: Path, base: Path, exact: bool) -> list[str]:
    """Return a short text for each difference between two folders or files.

    Args:
        current: The output of the current tree.
        base: The output of the other commit.
        exact: Whether bytes have to be equal, or only the values in JSON, CSV and safetensors.
    """
    first, second = _files(current), _files(base)
    found = [] if first or second else ["neither tree has made it"]
    for name in sorted(first | second):
        if name not in first or name not in second:
            found.append(f"{name}: only in {TREES[name not in first]}")
            continue
        one, other = _content(first[name]), _content(second[name])
        if one == other:
            continue
        values = _values_differ(first[name], second[name])
        found += [f"{name}: {value}" for value in values or ["other bytes"] * exact]
    return found


def _files(path: Path) -> dict[str, Path]:
    """Return the files of a folder by name, without the card's text; or a single file."""
    if path.is_file():
        return {path.name: path}
    inner = (each for each in path.rglob("*") if each.is_file() and each.name != "README.md")
    return {each.relative_to(path).as_posix(): each for each in inner}


def _content(path: Path) -> bytes:
    """Return the bytes of a file; of SHA256SUMS, without comments and the card's line."""
    content = path.read_bytes()
    if path.name == "SHA256SUMS":
        return re.sub(rb"(?m)^(#.*|\w+  README\.md)\n", b"", content)
    return content


def _values_differ(current: Path, base: Path) -> list[str]:
    """Return which values differ between two files; "other bytes" if only bytes are comparable."""
    read = VALUES.get(current.suffix)
    if read is None:
        return ["other bytes"]
    one, other = read(current), read(base)
    missing = "nothing"
    return [
        f"{name}: {one.get(name, missing)!s:.40}, was {other.get(name, missing)!s:.40}"
        for name in dict.fromkeys([*one, *other])
        if one.get(name, missing) != other.get(name, missing)
    ]


def _json(path: Path) -> dict[str, Any]:
    """Return the values of a JSON file by their paths in it, such as `splits.test.sr.0`."""

    def walk(value: Any, place: str) -> Iterator[tuple[str, Any]]:
        if isinstance(value, dict | list):
            items = value.items() if isinstance(value, dict) else enumerate(value)
            for name, inner in items:
                yield from walk(inner, f"{place}.{name}")
        else:
            yield place[1:], value

    return dict(walk(json.loads(path.read_text(encoding="utf-8")), ""))


def _cells(path: Path) -> dict[str, str]:
    """Return the cells of a CSV file by row number and column name."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {
        f"row {number} {column}": cell
        for number, row in enumerate(rows, start=2)
        for column, cell in row.items()
    }


def _tensors(path: Path) -> dict[str, str]:
    """Return the tensors in a file by name, as text: type, shape and SHA-256."""
    return {
        name: f"{tensor.dtype}{tensor.shape} {sha256(tensor.tobytes()).hexdigest()}"
        for name, tensor in load_file(path).items()
    }


VALUES: dict[str, Callable[[Path], dict[str, Any]]] = {
    ".json": _json,
    ".csv": _cells,
    ".safetensors": _tensors,
}
"""Suffix -> the function that reads a file value by value."""


def compare(folder: Path) -> int:
    """Print a table of the parts of a corpus, and return how many differ."""
    differing = 0
    for name, differ in parts(folder).items():
        found = differ()
        differing += bool(found)
        print(f"{name:16}{f'{len(found)} differences' if found else 'same'}")
        for difference in found[:SHOWN]:
            print(f"  {difference}")
    return differing


def main() -> int:
    """Compare the current tree with another commit; return 1 if anything differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("base", nargs="?", default=BASE, help=f"commit to compare with ({BASE})")
    parser.add_argument("--keep", type=Path, help="new folder for the outputs of both")
    parser.add_argument("--compare", type=Path, help="folder of --keep to compare again")
    options = parser.parse_args()
    if options.compare:
        return bool(compare(options.compare))
    with TemporaryDirectory(prefix="corpus-") as temporary:
        folder = (options.keep or Path(temporary)).resolve()
        try:
            make(options.base, folder)
        except RuntimeError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
        return bool(compare(folder))


if __name__ == "__main__":
    sys.exit(main())
