"""Remove wings of the program in copies of this checkout, and print what still works, as a table.

    python scripts/remove_wing.py                     # each wing in turn
    python scripts/remove_wing.py season report       # these two, each in a copy of its own
    python scripts/remove_wing.py --together          # all of them from one copy
    python scripts/remove_wing.py season --pytest '-n0 tests/pipeline/config'

A wing is a folder of `pipeline/` with `options.py`, which declares its stages. Removing it deletes
its folder, its tests, its folder in `conf/`, and its name in `pipeline/command/stages.py`; then
`scripts/write_options.py` writes `conf/` and `docs/options.md` again. Lines of `tests/defects.md`
and of the documentation that name a deleted file go with it. In the copy every module is imported,
the main job runs, a stage of the wing is refused, and the fast tests pass.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]

WINGS = ("certify", "export", "questions", "release", "report", "results", "season")
"""The folders of `pipeline/` that can be removed, each with the folders of its name in
`tests/pipeline/` and `tests/scripts/`."""

LIBRARY_OF_WINGS = {"certify": "benchmarks"}
"""Wing -> the folder of the library that no other room uses, and that goes with it."""

TESTS_OF_WINGS = {
    "tests.hub.test_releasing": {"release"},
    "tests.support.asking": {"questions"},
    "tests.support.exporting": {"export"},
}
"""Modules of tests in no folder of a wing -> the wings that they belong to."""

DECLARATION = "pipeline/command/stages.py"
"""The module that names the wings."""

IMPORT_ALL = """
import importlib, pathlib
for package in ("labyrinth_core", "pipeline"):
    for path in pathlib.Path(package).rglob("*.py"):
        if path.name != "__main__.py":
            importlib.import_module(".".join(path.with_suffix("").parts).removesuffix(".__init__"))
"""


class Removed(NamedTuple):
    """What went with some wings."""

    files: int
    """The files of the wings and of their tests."""
    lines: dict[str, int]
    """Other file -> the lines that went from it."""
    scripts: list[str]
    """The maintenance scripts that import the wings."""


def copy_to(copy: Path) -> None:
    """Copy the files of this checkout that git does not ignore."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, copy / name)


def files_of(root: Path, wing: str) -> Iterator[Path]:
    """Yield the folders and modules that belong to a wing alone."""
    library = LIBRARY_OF_WINGS.get(wing, "")
    paths = [root / "pipeline" / wing, root / "conf" / wing]
    if library:
        paths += [root / "labyrinth_core" / library, root / "tests/labyrinth_core" / library]
        paths.append(root / f"docs/reference/{library}.md")
    for tests in ("pipeline", "scripts"):
        paths += [path for path in root.glob(f"tests/{tests}/**/{wing}") if path.is_dir()]
    yield from (path for path in paths if path.exists())
    for module, wings in TESTS_OF_WINGS.items():
        if wing in wings:
            yield root / f"{module.replace('.', '/')}.py"


def without(line: str, is_gone: Callable[[str], bool]) -> str:
    """Return a line of a document without what names a file that is gone.

    From a table's row go the clauses that name it, between semicolons; another line goes whole. In
    a row, a name without a folder lies in that of the name before it.
    """
    folder = ""

    def names_gone(clause: str) -> bool:
        nonlocal folder
        for name in re.findall(r"`([\w./-]+(?:\.\w+|/))(?:::\w+)?`", clause):
            path = name if (ROOT / name).exists() else f"{folder}/{name}"
            folder = path.rstrip("/") if (ROOT / path).is_dir() else path.rpartition("/")[0]
            if is_gone(path):
                return True
        return False

    if not line.startswith("| "):
        return "" if names_gone(line) else line
    *cells, last = line.removesuffix(" |\n").split(" | ")
    every = last.split("; ")
    clauses = [clause for clause in every if not names_gone(clause)]
    if clauses == every:
        return line
    return f"{' | '.join(cells)} | {'; '.join(clauses)} |\n" if clauses else ""


def drop(path: Path, line: str) -> None:
    """Remove the lines of a file that match a pattern."""
    text = path.read_text(encoding="utf-8")
    path.write_text(re.sub(rf"^{line}\n", "", text, flags=re.MULTILINE), encoding="utf-8")


def remove(copy: Path, wings: Sequence[str]) -> Removed:
    """Delete wings from a copy of the checkout."""
    before = {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()}
    for path in [path for wing in wings for path in files_of(copy, wing)]:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    gone = [path for path in before if not path.exists()]
    names = "|".join(wings)
    libraries = "|".join(LIBRARY_OF_WINGS[wing] for wing in wings if wing in LIBRARY_OF_WINGS)
    drop(copy / DECLARATION, rf'    "({names})",')
    if libraries:
        drop(copy / "labyrinth_core/__init__.py", rf".*\b({libraries})\..*")
        drop(copy / "mkdocs.yml", rf".* reference/({libraries})\.md")
        public = run(copy, "-c", "import labyrinth_core; print(*labyrinth_core.__all__)").stdout
        kept = "|".join(public.split())
        drop(copy / "docs/reference/library.md", rf"::: labyrinth_core\.(?!({kept})$)\w+")
    for path in copy.rglob("*.md"):
        if path.name != "CHANGELOG.md":
            lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
            kept = (
                without(line, lambda name: (ROOT / name).exists() and not (copy / name).exists())
                for line in lines
            )
            path.write_text("".join(kept), encoding="utf-8")
    if (written := run(copy, "scripts/write_options.py")).returncode:
        raise RuntimeError(written.stderr)
    changed = {}
    for path in (path for path in before if path.exists()):
        kept = Counter(path.read_bytes().splitlines())
        if lost := (Counter(before[path].splitlines()) - kept).total():
            changed[path.relative_to(copy).as_posix()] = lost
    rooms = rf"pipeline\.({names})\b" + rf"|labyrinth_core\.({libraries})\b" * bool(libraries)
    imported = re.compile(rf"^\s*(from|import) ({rooms})", re.MULTILINE)
    scripts = [
        path.relative_to(copy / "scripts").as_posix()
        for path in sorted(copy.glob("scripts/**/*"))
        if path.is_file() and imported.search(path.read_text(encoding="utf-8"))
    ]
    return Removed(len(gone), changed, scripts)


def run(copy: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python in a copy, with the copy's modules."""
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=copy,
        env=os.environ | {"PYTHONPATH": str(copy)},
        capture_output=True,
        text=True,
        check=False,
    )


def said(done: subprocess.CompletedProcess[str]) -> str:
    """Return "yes" if a process succeeded, else its last line."""
    text = (done.stdout + done.stderr).strip()
    return "yes" if not done.returncode else text.splitlines()[-1]


def tried(wings: Sequence[str], tests: Sequence[str]) -> str:
    """Remove wings from a new copy, and return a row of the table."""
    stages = [stage for wing in wings for stage in import_module(f"pipeline.{wing}.options").STAGES]
    with tempfile.TemporaryDirectory(prefix="labyrinth-wing-") as folder:
        copy = Path(folder)
        copy_to(copy)
        removed = remove(copy, wings)
        imports = said(run(copy, "-c", IMPORT_ALL))
        job = said(run(copy, "run.py", "size=3", "labyrinths=4", "data_dir=made", "run_dir=runs"))
        refusals = [run(copy, "run.py", f"stages={stage}").stderr for stage in stages]
        refused = all("choose from [build, " in each for each in refusals)
        tested = run(copy, "-m", "pytest", "-m", "not slow", *tests)
        print(tested.stdout[-8000:] if tested.returncode else "", file=sys.stderr)
    cells = (
        ", ".join(wings),
        str(removed.files),
        ", ".join(f"`{path}` {count}" for path, count in removed.lines.items()),
        ", ".join(f"`{script}`" for script in removed.scripts),
        imports,
        job,
        "yes" if refused else refusals[0].strip(),
        tested.stdout.strip().splitlines()[-1],
    )
    return f"| {' | '.join(cells)} |".replace("|  |", "| |")


HEADING = """\
| wing | files | lines elsewhere | scripts of it | imports | main job | refused | fast tests |
|---|--:|---|---|---|---|---|---|"""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("wings", nargs="*", choices=[*WINGS, []], help="all by default")
    parser.add_argument("--together", action="store_true", help="remove them from one copy")
    parser.add_argument("--pytest", default="", help="more arguments, such as '-n0 tests/scripts'")
    asked = parser.parse_args()
    wings = asked.wings or WINGS
    print(HEADING)
    for each in [tuple(wings)] if asked.together else [(wing,) for wing in wings]:
        print(tried(each, shlex.split(asked.pytest)), flush=True)


if __name__ == "__main__":
    main()
