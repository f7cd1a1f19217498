"""`open_policy` opens any policy by its name: a run, a released policy, a graph, a Python object.

A name is a folder, a file, an id on the Hub or `module:name`. `files_of` finds the files that a
name stands for, so that a caller can copy, pin and hash them before anything is loaded.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.evaluation import Origin, PolicyError
from labyrinth_core.learning import PolicySpec
from labyrinth_core.policies.load import (
    GRAPH,
    MOST_BYTES,
    RunRecord,
    check_size,
    downloaded,
    load_policy,
)
from labyrinth_core.storage import File

_KINDS = ((PolicySpec.WEIGHTS, PolicySpec.FILE), (GRAPH,))
"""The files of each kind of policy, the weights first."""

_MODULE = re.compile(r"[\w.]+:[\w.]+")
_SHA256 = re.compile(r"[0-9a-f]{64}")


class PolicyNameError(ValueError):
    """A name of a policy has a form that is not allowed, or names no Python object."""


@dataclass(frozen=True)
class PolicyFiles:
    """The files of a policy, found and not yet read."""

    source: str
    """The folder, the file, or the id on the Hub, without a revision."""
    commit: str | None
    """The commit on the Hub; None for a folder or a file."""
    paths: Mapping[str, Path]
    """Name, such as `config.json` -> path; the weights come first."""

    def origin(self) -> Origin:
        """Hash the files; raise DatasetError if one is too large or cannot be read."""
        hashes = {}
        for name, path in self.paths.items():
            try:
                check_size(path, name, path.stat().st_size)
                hashes[name] = File(path).sha256()
            except OSError as error:
                raise DatasetError(f"{path} cannot be read: {one_line(error)}") from error
        return Origin(source=self.source, commit=self.commit, files=hashes)

    @property
    def is_graph(self) -> bool:
        """Whether the policy is an ONNX graph, not a network of the library."""
        return GRAPH in self.paths

    def copied(self, folder: Path) -> PolicyFiles:
        """Copy the files into a folder, so that the bytes to hash are the bytes to open.

        Raises:
            DatasetError: A file is too large, cannot be read, or is not a regular file.
        """
        for name, path in self.paths.items():
            try:
                size = path.stat().st_size
                if not path.is_file():
                    raise DatasetError(f"{path} is not a regular file")
                check_size(path, name, size)
                with path.open("rb") as file:
                    content = file.read(MOST_BYTES[name] + 1)
                check_size(path, name, len(content))  # It may have grown since.
                (folder / name).write_bytes(content)
            except OSError as error:
                raise DatasetError(f"{path} cannot be read: {one_line(error)}") from error
        return replace(self, paths={name: folder / name for name in self.paths})

    def open(self, named: str) -> Any:
        """Return the policy in the files, which messages call by a name.

        Raises:
            DatasetError, PolicyError: As for `open_policy`.
        """
        if not self.is_graph:
            return load_policy(next(iter(self.paths.values())).parent)
        from labyrinth_core.policies.graph import GraphPolicy

        return GraphPolicy(self.paths[GRAPH].read_bytes(), named)


def open_policy(source: str | Path, *, revision: str | None = None, code: bool = True) -> Any:
    """Return the policy that a name stands for, ready for `evaluate` and `compare`.

    | source | policy |
    |---|---|
    | a folder with `config.json` and `model.safetensors`, such as a run's \
`runs/5x5/bc-cnn-seed0` | as `load_policy` returns it; `run` is the training run that made it, \
if the folder has its `run.json` |
    | a file such as `policy.onnx`, or a folder with `model.onnx` | an ONNX graph, computed in a \
process without access to files and keys; `close()` ends it |
    | an id on the Hub, such as `user/planner-5x5@1.0.0` | one of the last two |
    | `module:name`, installed or in the working directory | that object, or what it returns if it \
is a class or a function without required arguments |

    All but the last are data: no code in them is executed. They have an attribute `origin` with the
    SHA-256 of each file, which results name, so that anyone can play the policy again. The network
    of a run acts as the library's do; if the run's method is in Python, it may have other rules, so
    `run` is None.

    Args:
        source: The name. On the Hub, `@` and a branch, tag or commit may follow; after a folder or
            a file, `@` and the SHA-256 of the weights, which must agree.
        revision: Another way to give what follows `@`.
        code: Whether `module:name` is allowed; give False for a name from someone else.

    Raises:
        PolicyNameError: The name has a form or a revision that is not allowed, or there is no such
            object.
        DatasetError: The policy does not exist, is damaged, too large or another one than the
            SHA-256 says, or a library is missing.
        PolicyError: The Python module, class or function raises an error, or an ONNX graph has
            other inputs or outputs than a policy.
    """
    name = str(source)
    if _MODULE.fullmatch(name):
        if not code or revision is not None:
            told = "has no revision" if code else "is not executed"
            raise PolicyNameError(f"{name}: a policy in Python {told}")
        policy = imported(name, lambda module: PolicyError.calling(import_module, module))
        return PolicyError.calling(policy) if _makes_one(policy) else policy
    files = files_of(source, revision)
    origin = files.origin()
    policy = files.open(name)
    policy.origin = origin
    return policy


def files_of(
    source: str | Path, revision: str | None = None, *, on_hub: bool = False
) -> PolicyFiles:
    """Return the files of a policy, after downloading them from the Hub if it is there.

    Args:
        source: As for `open_policy`, but not `module:name`.
        revision: As for `open_policy`.
        on_hub: Whether the policy is on the Hub even if a folder has the name.

    Raises:
        PolicyNameError, DatasetError: As for `open_policy`.
    """
    name, _, pinned = str(source).partition("@")
    path = Path(source).expanduser()
    if path.exists():  # A folder may have an @ in its name.
        name, pinned = str(source), ""
    revision = revision or pinned or None
    path = Path(name).expanduser()
    if on_hub or not path.exists():
        return _on_hub(name, revision)
    if revision is not None and not _SHA256.fullmatch(revision):
        told = f"{name} is a {'folder' if path.is_dir() else 'file'}, which has no revisions"
        raise PolicyNameError(f"{told}: @ and the SHA-256 of its weights pin it")
    files = PolicyFiles(name, None, _in_folder(path))
    weights, path = next(iter(files.paths.items()))
    if revision is not None and (sha256 := File(path).sha256()) != revision:
        raise DatasetError(
            f"{name}: {weights} differs from the named revision: it is {sha256:.16}, "
            f"not {revision:.16}"
        )
    return files


def _on_hub(source: str, revision: str | None) -> PolicyFiles:
    """Return the files of a policy on the Hub, after downloading them."""
    from labyrinth_core import hub

    if not hub.ID.fullmatch(source):
        allowed = "neither a folder, a file, nor an id such as user/planner-5x5"
        raise DatasetError(f"{source} is {allowed}")
    for names in _KINDS:
        folder = downloaded(source, revision, names)
        revision = commit = folder.name  # The client's cache has a folder for each commit.
        if all((folder / name).is_file() for name in names):
            return PolicyFiles(source, commit, {name: folder / name for name in names})
    raise _no_policy(source)


def _in_folder(path: Path) -> dict[str, Path]:
    """Return the files of a policy by name: those in a folder, or a single ONNX graph."""
    if path.is_dir():
        held = {path.name for path in path.iterdir()}
        if RunRecord.FILE in held and not held.intersection((PolicySpec.WEIGHTS, GRAPH)):
            RunRecord.read(path)  # It says what to do with a run of an earlier version.
        for names in _KINDS:
            if held >= set(names):
                return {name: path / name for name in names}
        raise _no_policy(str(path))
    if path.suffix != ".onnx":
        raise DatasetError(
            f"{path} is neither a folder nor an ONNX graph, such as {GRAPH}: a policy in Python "
            "is module:name"
        )
    return {GRAPH: path}


def _no_policy(source: str) -> DatasetError:
    kinds = "; ".join(" and ".join(names) for names in _KINDS)
    return DatasetError(f"{source} holds no policy: give {kinds}")


def imported(name: str, load: Callable[[str], Any] = import_module) -> Any:
    """Import and return the object `module:name`, from the working directory or as installed.

    Args:
        name: The module and, after a colon, the name in it, which may have dots.
        load: Imports a module.

    Raises:
        PolicyNameError: The module, or the name in it, does not exist.
    """
    module, _, attribute = name.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:  # As `python -m` does; an installed command has its own folder there.
        sys.path.insert(0, here)
    try:
        value = load(module)
    except (ModuleNotFoundError, PolicyError) as error:
        cause = error.__cause__ or error
        missing = isinstance(cause, ModuleNotFoundError) and cause.name
        if not (missing and f"{module}.".startswith(f"{missing}.")):
            raise
        reason = f"there is no module {missing}, neither in {here} nor installed"
        raise PolicyNameError(reason) from error
    for part in attribute.split("."):
        if not hasattr(value, part):
            known = ", ".join(each for each in vars(value) if not each.startswith("_"))
            raise PolicyNameError(f"there is no {part}, only [{known}]")
        value = getattr(value, part)
    return value


def _makes_one(value: Any) -> bool:
    """Return whether an object is a class or a function without arguments that makes a policy."""
    if inspect.isclass(value):
        return True
    if not inspect.isroutine(value):
        return False
    parameters = inspect.signature(value).parameters.values()
    variable = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return not any(each.default is each.empty and each.kind not in variable for each in parameters)
