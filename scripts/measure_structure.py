"""Print what ties the rooms of the project together, and how far a command reaches through them.

    python scripts/measure_structure.py           # the names, from the source
    python scripts/measure_structure.py --run     # also what some stages execute

A room is a folder of a package, such as `pipeline.training`. A name crosses a door if a file of
another room imports it. `tests/test_architecture.py` holds these figures as ceilings.
"""

from __future__ import annotations

import argparse
import ast
import json
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("labyrinth_core", "pipeline")

SMALL = ["size=3", "labyrinths=4"]
TRAINED = [*SMALL, "stages=[build,train]", "method.epochs=1"]
LOAD = "load_transitions"
"""In place of options: the dataset that a build has left is loaded, and cached."""
SEASON = ["size=3", "labyrinths=16", "season.name=a", "season.date=2026-01-01"]
RUNS = {
    "stages=build": [[*SMALL, "stages=build"]],
    "load_transitions, cold": [[*SMALL, "stages=build"], [LOAD]],
    "main job": [SMALL],
    "stages=evaluate": [TRAINED, [*SMALL, "stages=evaluate"]],
    "stages=judge": [
        TRAINED,
        [*SEASON, "stages=season"],
        [*SEASON, "stages=judge", "season.submission=runs/3x3/bc-cnn-seed0"],
    ],
}
"""What is executed -> the options of each command, the last of which is measured."""

_PROFILED = """
import inspect, json, sys
root, out, *options = sys.argv[1:]
sys.path.insert(0, root)
called, deepest = set(), 0
def watch(frame, event, argument):
    global deepest
    if event != "call" or not frame.f_code.co_filename.startswith((root + "/pipe", root + "/laby")):
        return
    code = frame.f_code
    # Neither the body of a module or class nor a comprehension.
    if code.co_flags & inspect.CO_OPTIMIZED and not code.co_name.startswith("<"):
        called.add((code.co_filename, code.co_qualname))
    depth, at = 0, frame
    while at is not None:
        depth += at.f_code.co_filename.startswith((root + "/pipe", root + "/laby"))
        at = at.f_back
    deepest = max(deepest, depth)
sys.argv = ["labyrinth-datasets", *options]
if options == ["load_transitions"]:
    from labyrinth_core import load_transitions
    main = lambda: load_transitions("data/labyrinth", "3x3", cache_dir="cache")
else:
    from pipeline.__main__ import main
sys.setprofile(watch)
try:
    main()
except SystemExit:
    pass
sys.setprofile(None)
with open(out, "w") as file:
    json.dump([len({path for path, _ in called}), len(called), deepest], file)
"""


class Structure(NamedTuple):
    """The figures that `tests/test_architecture.py` bounds."""

    crossing: int
    """Names that a room of the packages imports from another room."""
    from_library: int
    """Names of the library that the program imports."""
    modules_per_file: float
    """Modules of ours that a file of the packages imports, on average."""
    in_tests: int
    """Names of modules inside rooms that tests import."""
    called_once: int
    """Private functions of the packages that are named once, besides their definition."""


def room_of(module: str) -> str:
    """Return the room of a module, such as `pipeline.training`."""
    return ".".join(module.split(".")[:2])


def sources(*folders: str) -> dict[str, ast.Module]:
    """Return the syntax trees of the Python files of folders, by module."""
    trees = {}
    for path in sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py")):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        trees[name] = ast.parse(path.read_text(encoding="utf-8"))
    return trees


def structure() -> Structure:
    """Measure the source of this checkout."""
    ours = sources(*PACKAGES)
    crossing, from_library = names_across(ours)
    imported = [len({target for target, _ in imports(tree, ours)}) for tree in ours.values()]
    in_tests = {
        name
        for tree in sources("tests").values()
        for name in imports(tree, ours)
        if name[0].count(".") > 1
    }
    return Structure(
        crossing=len(crossing),
        from_library=len(from_library),
        modules_per_file=round(sum(imported) / len(imported), 1),
        in_tests=len(in_tests),
        called_once=sum(map(_called_once, ours.values())),
    )


def names_across(
    ours: dict[str, ast.Module],
) -> tuple[set[tuple[str, str]], set[tuple[str, str]]]:
    """Return the names that cross doors, and those that the program takes from the library."""
    crossing: set[tuple[str, str]] = set()
    from_library: set[tuple[str, str]] = set()
    for module, tree in ours.items():
        if module != "labyrinth_core":  # Its names are the library's door.
            names = imports(tree, ours)
            across = {name for name in names if room_of(name[0]) != room_of(module)}
            crossing |= across
            if module.startswith("pipeline"):
                from_library |= {name for name in across if name[0].startswith("labyrinth_core")}
    return crossing, from_library


def imports(tree: ast.Module, ours: dict[str, ast.Module]) -> list[tuple[str, str]]:
    """Return the module and the name of each import of ours in a file, at any depth."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in PACKAGES:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                found.append((whole if whole in ours else str(node.module), alias.name))
    return found


def _called_once(tree: ast.Module) -> int:
    """Return the number of private functions that a file names once, besides their definition."""
    nodes = list(ast.walk(tree))
    used = Counter(node.id for node in nodes if isinstance(node, ast.Name))
    used += Counter(node.attr for node in nodes if isinstance(node, ast.Attribute))
    functions = (node for node in nodes if isinstance(node, ast.FunctionDef))
    private = (each.name for each in functions if each.name.startswith("_"))
    return sum(used[name] == 1 for name in private if not name.startswith("__"))


def executed(commands: list[list[str]]) -> tuple[int, int, int]:
    """Return the files and functions of ours that the last command executes, and the deepest call.

    Args:
        commands: The options of each command; they run in one new folder.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "figures.json")
        for options in commands:
            command = [sys.executable, "-c", _PROFILED, str(ROOT), str(out), *options]
            subprocess.run(command, cwd=folder, check=True, capture_output=True)
        files, functions, depth = json.loads(out.read_text(encoding="utf-8"))
    return files, functions, depth


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--run", action="store_true", help="also execute some stages, in minutes")
    asked = parser.parse_args()
    measured = structure()
    print(f"names that cross the doors of rooms            {measured.crossing:>6}")
    print(f"names that the program takes from the library  {measured.from_library:>6}")
    print(f"modules of ours that a file imports, on average{measured.modules_per_file:>6}")
    print(f"names inside rooms that tests import           {measured.in_tests:>6}")
    print(f"private functions that are named once          {measured.called_once:>6}")
    for name, commands in RUNS.items() if asked.run else ():
        files, functions, depth = executed(commands)
        print(f"{name}: {files} files, {functions} functions, {depth} calls deep")


if __name__ == "__main__":
    main()
