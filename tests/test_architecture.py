"""Who may import whom: the rules of the house, enforced on every import there is.

Files that come later are picked up as they appear; a rule changes in the tables below.
"""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]

HOMES = {
    "hydra": ("run", "pipeline.config"),
    "omegaconf": ("run", "pipeline.config"),
    "pyarrow": (
        "pipeline.generation",
        "pipeline.schema",
        "pipeline.source",
        "pipeline.release.tally",
    ),
    "datasets": (
        "pipeline.generation",
        "pipeline.schema",
        "pipeline.source",
        "pipeline.release.verify",  # Loads a release the way that strangers will.
    ),
    "fsspec": ("pipeline.storage",),
    "joblib": ("pipeline.executor",),
    "distributed": ("pipeline.executor",),
    "ray": ("pipeline.executor",),
    "huggingface_hub": (
        "pipeline.release",
        "pipeline.source",
        "pipeline.analysis.experts.stable_baselines",  # Archives of experts, by their id.
    ),
    "torch": (
        "pipeline.training",
        "pipeline.analysis.experts.stable_baselines",  # Weights, read without pickle.
    ),
    "safetensors": ("pipeline.training",),
    "gymnasium": (
        "labyrinth_core.env",
        "labyrinth_core.vector_env",
        "pipeline.training",
        "pipeline.analysis.worlds",
    ),
    "mujoco": ("pipeline.analysis.worlds",),
    "matplotlib": (
        "pipeline.analysis.report_figures",
        "pipeline.analysis.variation_report",
        "pipeline.training.record",
    ),
    "pygame": ("labyrinth_core.env", "labyrinth_core.__main__", "labyrinth_core.window"),
    # Nothing that makes or loads a dataset knows the time, so that no clock can mislead it.
    "time": (
        "pipeline.training.loop",  # How long a run took.
        "pipeline.analysis.environments",
        "pipeline.release.publish",  # To wait and try again.
        "pipeline.release.remote",
        "pipeline.release.verify",
    ),
    "datetime": (),
}
"""Where alone a library is imported: in these modules and those within them."""

OF_THE_CORE = {"numpy", "gymnasium", "pygame", "PIL"}
"""All libraries of labyrinth_core; `HOMES` says where in it, and pictures only when asked."""

LAZY_IN_THE_CORE = {"pygame", "PIL", "labyrinth_core.window"}
"""What labyrinth_core imports inside functions only; but a window module is made of pygame."""

HOMES_OF_PIL_IN_THE_CORE = ("labyrinth_core.env", "labyrinth_core.__main__")

SHELLS = ("env", "vector_env", "window", "play")
"""Modules of labyrinth_core that need more than numpy."""

STEPS = [f"pipeline.generation.{step}" for step in ("sample", "solve", "render", "write")]
"""The four steps; only `build` composes them."""


class Import(NamedTuple):
    """One module named by an import statement of another."""

    importer: str
    line: int
    imported: str
    """A module of the project, or a library by the name of its top package."""
    at_once: bool
    """Whether importing the importer imports it; not so in functions and for type checkers."""


# Reading the imports.


def modules_of(root: Path) -> dict[str, Path]:
    """Return the project's modules by name."""
    files = [*root.glob("labyrinth_core/**/*.py"), *root.glob("pipeline/**/*.py")]
    files += [root / "run.py", *root.glob("scripts/**/*.py"), *root.glob("tests/**/*.py")]
    return {
        ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__"): path
        for path in files
        if path.exists()
    }


def imports(root: Path) -> list[Import]:
    """Return all imports of the two packages and of run.py."""
    modules = modules_of(root)
    return [
        found
        for name, path in modules.items()
        if name.split(".")[0] not in ("scripts", "tests")
        for found in imports_of(name, path, modules)
    ]


def imports_of(name: str, path: Path, modules: dict[str, Path]) -> Iterator[Import]:
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node, at_once in statements(tree, at_once=True):
        for imported in named_by(node, package):
            parts = imported.split(".")
            known = [".".join(parts[:end]) for end in range(len(parts), 0, -1)]
            target = next((each for each in known if each in modules), parts[0])
            yield Import(name, node.lineno, target, at_once)


def statements(node: ast.AST, *, at_once: bool) -> Iterator[tuple[ast.AST, bool]]:
    """Yield every node below, and whether it runs when the module is imported."""
    for child in ast.iter_child_nodes(node):
        yield child, at_once
        lazy = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            lazy = True
        yield from statements(child, at_once=at_once and not lazy)


def named_by(node: ast.AST, package: str) -> Iterator[str]:
    """Yield the dotted names that an import names; also one made by a call with a plain text."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        parents = package.split(".")
        base = ".".join(parents[: len(parents) - node.level + 1]) if node.level else ""
        base = ".".join(filter(None, [base, node.module]))
        yield from (f"{base}.{alias.name}" for alias in node.names)
    elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(
        ("import_module", "__import__")
    ):
        texts = [each.value for each in node.args if isinstance(each, ast.Constant)]
        yield from (text for text in texts[:1] if isinstance(text, str))


# The rules.


def within(module: str, *homes: str) -> bool:
    return any(module == home or module.startswith(f"{home}.") for home in homes)


def wing_of(module: str, root: Path) -> str | None:
    """Return the package within pipeline that a module belongs to."""
    parts = module.split(".")
    is_wing = parts[0] == "pipeline" and len(parts) > 1 and (root / "pipeline" / parts[1]).is_dir()
    return parts[1] if is_wing else None


def broken_rule(found: Import, root: Path) -> str | None:
    """Return the rule that an import breaks, None if it breaks none."""
    importer, _, imported, at_once = found
    if within(imported, "run", "scripts", "tests"):
        return "run.py, scripts and tests are imported by nothing"
    if imported in HOMES and not within(importer, *HOMES[imported]):
        return f"{imported} only in {', '.join(HOMES[imported])}"
    if within(importer, "labyrinth_core"):
        return broken_rule_of_the_core(importer, imported, at_once)
    own, other = wing_of(importer, root), wing_of(imported, root)
    if within(importer, "pipeline") and other and own != other:
        return "the wings import the shared ground, neither one another nor it them"
    if (
        importer in STEPS
        and other == "generation"
        and imported not in (importer, f"pipeline.{own}")
    ):
        return "a step imports nothing of generation: only build composes"
    return None


def broken_rule_of_the_core(importer: str, imported: str, at_once: bool) -> str | None:
    if within(imported, "labyrinth_core"):
        is_lazy = imported not in LAZY_IN_THE_CORE or not at_once
        return None if is_lazy else f"{imported} only inside functions"
    if imported in sys.stdlib_module_names:
        return None
    if imported not in OF_THE_CORE:
        return f"labyrinth_core imports no {imported}"
    if imported == "PIL" and not within(importer, *HOMES_OF_PIL_IN_THE_CORE):
        return f"PIL only in {', '.join(HOMES_OF_PIL_IN_THE_CORE)}, of the core"
    if imported in LAZY_IN_THE_CORE and at_once and importer not in LAZY_IN_THE_CORE:
        return f"{imported} only inside functions, in labyrinth_core"
    return None


def broken_rules(root: Path) -> list[str]:
    return [
        f"{found.importer}, line {found.line}, imports {found.imported}: {rule}"
        for found in imports(root)
        if (rule := broken_rule(found, root))
    ]


def test_every_import_keeps_the_rules_of_the_house():
    assert broken_rules(ROOT) == []


def test_the_walk_finds_the_modules_and_imports_that_are_known():
    found = {(each.importer, each.imported) for each in imports(ROOT)}
    assert ("labyrinth_core.solver", "labyrinth_core.dynamics") in found
    assert ("labyrinth_core.solver", "numpy") in found
    assert ("labyrinth_core.sampling", "labyrinth_core.grid") in found


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("labyrinth_core/solver", "import pipeline"),
        ("labyrinth_core/solver", "from pipeline.schema import Row"),
        ("labyrinth_core/solver", "from run import main"),
        ("labyrinth_core/solver", "import hydra"),
        ("labyrinth_core/solver", "import pyarrow.parquet as pq"),
        ("labyrinth_core/solver", "def f():\n    import datasets"),
        ("labyrinth_core/solver", "class A:\n    def f(self):\n        import torch"),
        ("labyrinth_core/solver", "try:\n    import rich\nexcept ImportError:\n    rich = None"),
        ("labyrinth_core/solver", "def f():\n    import gymnasium"),
        ("labyrinth_core/solver", "def f():\n    from PIL import Image"),
        ("labyrinth_core/solver", "def f():\n    import pygame"),
        ("labyrinth_core/solver", "import importlib\nimportlib.import_module('torch')"),
        ("labyrinth_core/solver", "__import__('hydra.core')"),
        ("labyrinth_core/solver", "from .. import pipeline"),
        ("labyrinth_core/env", "import pygame"),
        ("labyrinth_core/env", "from labyrinth_core.window import Window"),
        ("labyrinth_core/env", "from . import window"),
        ("labyrinth_core/__main__", "from PIL import Image"),
        ("pipeline/schema", "import pipeline.generation.build"),
        ("pipeline/schema", "from pipeline import generation"),
        ("pipeline/schema", "from .generation import build"),
        ("pipeline/schema", "from omegaconf import OmegaConf"),
        ("pipeline/schema", "import scripts.benchmark"),
        ("pipeline/manifest", "import pyarrow"),
        ("pipeline/loader", "def f():\n    import pyarrow"),
        ("pipeline/executor", "import gymnasium"),
        ("pipeline/release/card", "from pipeline.generation.build import build"),
        ("pipeline/release/card", "from ..generation import build"),
        ("pipeline/release/card", "import torch"),
        ("pipeline/training/train", "from pipeline.release import card"),
        ("pipeline/training/train", "import huggingface_hub"),
        ("pipeline/analysis/leakage", "from gymnasium import make"),
        ("pipeline/generation/sample", "from pipeline.generation.solve import solve"),
        ("pipeline/generation/render", "from . import write"),
        ("pipeline/generation/write", "def f():\n    from .build import build"),
        ("run", "import pyarrow"),
    ],
)
def test_a_forbidden_import_is_found_wherever_it_hides(tmp_path, module, source):
    house(tmp_path, module, source)
    assert len(broken_rules(tmp_path)) == 1


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("labyrinth_core/solver", "import json, numpy.typing"),
        ("labyrinth_core/solver", "from labyrinth_core.grid import Action"),
        ("labyrinth_core/env", "import gymnasium"),
        ("labyrinth_core/env", "def f():\n    import pygame, PIL.Image"),
        ("labyrinth_core/env", "def f():\n    from labyrinth_core.window import Window"),
        ("labyrinth_core/window", "import pygame"),
        (
            "labyrinth_core/env",
            "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from .window import Window",
        ),
        ("pipeline/config", "import hydra, omegaconf"),
        ("pipeline/source", "import datasets, huggingface_hub, pyarrow"),
        ("pipeline/release/card", "from labyrinth_core.solver import distances"),
        ("pipeline/release/card", "from pipeline.schema import Row"),
        ("pipeline/analysis/worlds", "import gymnasium"),
        ("pipeline/training/train", "import torch, gymnasium"),
        ("pipeline/generation/build", "from pipeline.generation import render, sample"),
        ("run", "import hydra\nfrom pipeline.generation.build import build"),
    ],
)
def test_what_the_rules_allow_is_not_complained_of(tmp_path, module, source):
    house(tmp_path, module, source)
    assert broken_rules(tmp_path) == []


def house(root, module, source):
    """Write an empty house, but for one module."""
    rooms = [f"labyrinth_core/{name}" for name in ("__init__", "__main__", "grid", "solver", "env")]
    rooms += ["labyrinth_core/window", "scripts/benchmark", "pipeline/__init__", "run"]
    rooms += [f"pipeline/{name}" for name in ("config", "schema", "loader", "generation/build")]
    rooms += [f"pipeline/{wing}/__init__" for wing in ("generation", "release", "training")]
    rooms += [f"{step.replace('.', '/')}" for step in STEPS]
    rooms += ["pipeline/release/card", "pipeline/analysis/__init__", module]
    for room in rooms:
        path = root / f"{room}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(source if room == module else "", encoding="utf-8")


# What an import brings with it.


def plain_modules():
    return [
        name
        for name in modules_of(ROOT)
        if within(name, "labyrinth_core")
        and not within(name, *(f"labyrinth_core.{shell}" for shell in SHELLS))
    ]


def test_the_plain_modules_of_the_core_need_numpy_alone():
    modules = plain_modules()
    assert {"labyrinth_core", "labyrinth_core.solver", "labyrinth_core.__main__"} <= set(modules)
    program = (
        "import importlib, json, sys\n"
        "before = set(sys.modules)\n"
        f"for name in {modules!r}:\n"
        "    importlib.import_module(name)\n"
        "print(json.dumps(sorted({name.split('.')[0] for name in set(sys.modules) - before})))\n"
    )
    command = [sys.executable, "-W", "error", "-c", program]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(json.loads(run.stdout))
    libraries = {
        *packages_distributions(),
        *HOMES,
        "PIL",
        "cv2",
        "joblib",
        "pandas",
        "rich",
        "yaml",
    }
    assert "numpy" in loaded
    assert loaded & libraries - sys.stdlib_module_names <= {"numpy", "labyrinth_core"}
