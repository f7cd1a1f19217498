"""Artifacts: folders that appear complete, and single files in folders shared with the user.

`produced` makes a whole folder under a temporary name, and moves it to its place when it is
finished. `leave` writes single files into a folder that is shared with the user. Both record in
`SHA256SUMS` what they write, and overwrite, remove or publish no file that is not recorded there. A
link to such a folder is followed. A link inside it is replaced itself if it has the name and the
content of a file of ours; nothing is written or removed through it.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, replace
from difflib import get_close_matches
from fnmatch import fnmatchcase
from pathlib import Path, PurePath
from typing import Any, ClassVar, TypeVar

from labyrinth_core.errors import DatasetError, printable_line
from labyrinth_core.folders import WholeFolder
from labyrinth_core.listing import is_litter
from labyrinth_core.storage import AnyPath, File
from pipeline.machinery.console import say

Place = TypeVar("Place", Path, AnyPath)

Key = Mapping[str, Any]
"""The inputs that determine an artifact, in JSON types."""

_OURS, _MADE, _LEFT = "# labyrinth-datasets", "# made from ", "# left beside it"
_ITSELF = "# sha256 of the lines below "
_LINE = re.compile(r"^([0-9a-f]{64})  (?![/\\]|\w:|.*\.\.[/\\])(\S.*)$", re.M)  # Inside the folder.
_KEY = re.compile(f"^{_MADE}(.*)$", re.M)

UNKNOWN = "0" * 64
"""Stands for the hash of a file in a store that is not made yet."""

_UNFINISHED = re.compile(r"(.*/)?\..+\.[0-9a-f]{12}\.[0-9a-f]{8}\.tmp")
"""A name from `LocalFile.temporary`: a process was killed while it wrote the file."""


@dataclass(frozen=True)
class Sums:
    """The files of a folder that the program wrote ("ours"), as pairs of name and SHA-256.

    `SHA256SUMS` lists them in the format of `sha256sum -c`. Its comments hold the key, which is the
    inputs that determine the files, and, except in a release, a hash of the list itself. A file
    that is not listed, or has another hash, belongs to the user.
    """

    FILE: ClassVar = "SHA256SUMS"
    """The name of the list."""

    folder: AnyPath
    key: Key | None = None
    """The inputs that the folder is made from; None if unknown."""
    made: frozenset[tuple[str, str]] = frozenset()
    """The artifact's own files; without one of them it is damaged."""
    left: frozenset[tuple[str, str]] = frozenset()
    """Other files that stages have written there; during a replacement, old and new ones."""
    is_damaged: bool = False
    """Whether the list is damaged, so that it does not show which files the artifact has."""

    @classmethod
    def read(cls, folder: AnyPath, *, overwrite: bool = False) -> Sums:
        """Read the list of a folder; without a list, no file is ours.

        Args:
            folder: The folder.
            overwrite: Whether to use the readable lines of a damaged list, which is replaced.

        Raises:
            DatasetError: The list is damaged, or another program wrote it.
        """
        path = folder / cls.FILE
        try:
            text = path.read_bytes().decode(errors="replace")
        except (FileNotFoundError, NotADirectoryError) as error:
            if path.is_symlink():
                raise DatasetError(f"{path} is a link that leads nowhere: remove it") from error
            return cls(folder)
        parts = text.partition(f"{_LEFT}\n")[::2]
        made, left = (frozenset((n, digest) for digest, n in _LINE.findall(p)) for p in parts)
        key = None
        with suppress(ValueError, RecursionError):
            key = next(map(json.loads, _KEY.findall(text)), None)
        sums = cls(folder, key if isinstance(key, dict) else None, made, left)
        lines = sorted(sums._text(with_hash=False).splitlines())
        is_whole = text == sums._text() or (sorted(text.splitlines()) == lines)
        if is_whole and text.endswith("\n") and (sums.hashes or key):
            return sums
        first = text[: len(_OURS)].strip("\0")
        if not (_OURS.startswith(first) or get_close_matches(first, [_OURS])):
            advice = "move it away, or choose another folder"
            raise DatasetError(f"{path} is another program's: {advice}")
        if not overwrite:
            again = "the stage that made its files makes them again with overwrite=true"
            raise DatasetError(f"{path} is damaged: {again}; or move {folder} away")
        return replace(sums, is_damaged=True)

    @classmethod
    def of(cls, folder: AnyPath, key: Key | None = None, names: Sequence[str] = ()) -> Sums:
        """Hash all files of a folder; those in `names`, by default all, count as `made`."""
        hashes = {(n, File(folder / n).sha256()) for n in File(folder).names() if n != cls.FILE}
        made = frozenset(each for each in hashes if not names or each[0] in names)
        return cls(folder, key, made, frozenset(hashes - made))

    def write(self) -> None:
        """Write the list atomically."""
        File(self.folder / self.FILE).write_bytes(self.content())

    def content(self) -> bytes:
        """Return the content of the list."""
        return self._text().encode()

    def _text(self, *, with_hash: bool = True) -> str:
        """Return the list, with a hash of itself; those of releases and old versions have none."""
        lines = [] if self.key is None else [_MADE + json.dumps(self.key)]
        lines += [f"{digest}  {name}" for name, digest in sorted(self.made)]
        if self.left:
            lines += [_LEFT, *(f"{digest}  {name}" for name, digest in sorted(self.left))]
        rest = "".join(f"{line}\n" for line in lines)
        if with_hash and (self.key is not None or self.left):
            rest = f"{_ITSELF}{hashlib.sha256(rest.encode()).hexdigest()}\n{rest}"
        return f"{_OURS}\n{rest}"

    @property
    def hashes(self) -> frozenset[tuple[str, str]]:
        """The files that are ours."""
        return self.made | self.left

    def has(self, name: str) -> bool:
        """Return whether a file exists with a hash that is listed."""
        return (name, hash_of(self.folder / name)) in self.hashes

    def damaged(self) -> list[str]:
        """Return the files in `made` that are missing or have another hash.

        In a store, where hashing means a download, a file older than the list is taken for whole,
        unless stages left others there, so rewrote the list.
        """
        whole = WholeFolder.of(self.folder, self.FILE)

        def is_whole(name: str, digest: str) -> bool:
            path = self.folder / name
            if not self.left and digest != UNKNOWN and path.is_file():
                return whole.is_covered(File(path).size_and_time()[1]) or self.has(name)
            return self.has(name)

        return sorted(name for name, digest in self.made if not is_whole(name, digest))

    @staticmethod
    def differences(old: Key, asked: Key) -> str:
        """Return how two keys differ, such as `seed=3, not 4`.

        If they share no name, return all of `old`.
        """
        if old and not old.keys() & asked.keys():
            return printable_line("; ".join(f"{name}={value}" for name, value in old.items()))
        return "; ".join(
            printable_line(f"{name}={old.get(name)}, not {asked.get(name)}")
            for name in {**asked, **old}
            if json.dumps(old.get(name)) != json.dumps(asked.get(name))
        )


def hash_of(path: AnyPath) -> str | None:
    """Return the SHA-256 of a file; None if it does not exist."""
    return File(path).sha256() if path.is_file() else None


@dataclass(frozen=True)
class Ownership:
    """What in a folder may be written over or removed: files whose hash the folder's record lists.

    All else is the user's.
    """

    sums: Sums

    def strangers(self, ours: Sequence[str], instead: str) -> list[str]:
        """Return the names of the user's files in an artifact's folder; see `produced`.

        Raises:
            DatasetError: The folder is a file, or a user's file matches a pattern in `ours`.
        """
        sums, folder = self.sums, self.sums.folder
        if folder.exists() and not folder.is_dir():
            raise DatasetError(f"{folder} is a file: move it, or {instead}")
        listed = {Sums.FILE, *(n for n, _ in sums.made), *(n for n, _ in sums.left if sums.has(n))}
        unlisted = [
            name
            for name in File(folder).names()
            if not (name in listed or is_litter(name) or _UNFINISHED.fullmatch(name))
        ]
        if lost := [name for name in unlisted if any(fnmatchcase(name, own) for own in ours)]:
            reason = "which would be lost: move it elsewhere"
            raise DatasetError(f"{folder} holds {named(lost)}, {reason}, or {instead}")
        return unlisted

    def others(self, files: Mapping[str, bytes]) -> list[str]:
        """Return the names in `files` that belong to existing files of the user."""
        known = replace(self.sums, left=self.sums.left | _hashes_of(files))
        return [n for n in files if _is_there(self.sums.folder / n) and not known.has(n)]

    def require_free(
        self, files: Mapping[str, bytes], key: Key | None, overwrite: bool, instead: str
    ) -> None:
        """Raise DatasetError if `leave`, with these arguments, may not write the files."""
        for name in files:
            within(self.sums.folder, *PurePath(name).parent.parts)
        if overwrite:
            return
        old = self.sums.key
        if self.sums.hashes and key is not None and (differing := Sums.differences(old or {}, key)):
            what = f"is made with {differing}" if old else "holds files of another stage"
            advice = f"{instead}, or give overwrite=true to replace it"
            raise DatasetError(f"{self.sums.folder} {what}: {advice}")
        if others := self.others(files):
            were_ours = {*others} <= {name for name, _ in self.sums.hashes}
            reason = "damaged or changed" if were_ours else "made or changed by someone else"
            raise DatasetError(
                f"{named([str(self.sums.folder / name) for name in others])}: {reason}, so not "
                "overwritten: move it away, or give overwrite=true"
            )

    def is_whole(self, key: Key, ours: Sequence[str], overwrite: bool, instead: str) -> bool:
        """Return whether an artifact is complete; raise DatasetError if `produced` would refuse."""
        self.require_free({}, key, overwrite, instead)
        lacking = [] if overwrite else self.sums.damaged()
        begun = {name for name, digest in self.sums.made if digest == UNKNOWN}
        if changed := [n for n in lacking if n not in begun and _is_there(self.sums.folder / n)]:
            reason = "damaged or changed since it was made"
            advice = f"give overwrite=true to make it again, or {instead}"
            raise DatasetError(f"{self.sums.folder} holds {named(changed)}, {reason}: {advice}")
        whole = bool(self.sums.made) and not overwrite and not lacking
        if not whole:
            self.strangers(ours, instead)
        return whole

    def unfinished(self, names: Iterable[str]) -> list[Path]:
        """Return the temporary files of processes that were killed while writing these names."""
        whole = WholeFolder.of(self.sums.folder, Sums.FILE)
        paths = [self.sums.folder / name for name in names]
        parents, in_them = {path.parent for path in paths}, {path.name for path in paths}
        return [path for parent in parents for path in whole.leftovers(parent, in_them)]

    def replace(
        self, files: Mapping[str, bytes], gone: Sequence[str] = (), key: Key | None = None
    ) -> Sums:
        """Write files, remove others, and return the new list for the caller to write.

        During the call, the list on disk names both old and new files.

        Args:
            files: The content of each file, by name.
            gone: The names of files to remove, if they are ours.
            key: The new key of the folder; None to keep the old one.

        Raises:
            DatasetError: The folder of a file is a link; nothing is written.
        """
        sums, new = self.sums, _hashes_of(files)
        ours = replace(sums, key=key or sums.key, is_damaged=False)
        if sums.is_damaged:
            ours = replace(ours, made=frozenset(), left=sums.hashes)
        parents = {PurePath(name).parent for name in (*files, *gone)}
        folders = [within(sums.folder, *parent.parts) for parent in parents]
        for unfinished in self.unfinished([*files, Sums.FILE]):
            unfinished.unlink()
        for each in [sums.folder, *folders]:
            each.mkdir(parents=True, exist_ok=True)
        replace(ours, left=ours.left | new).write()
        for name in filter(sums.has, gone):
            (sums.folder / name).unlink()
        for name, content in files.items():
            File(sums.folder / name).write_bytes(content)
        made = frozenset(each for each in ours.made if each[0] not in {*files, *gone})
        rest = ours.left - new
        kept = frozenset(each for each in rest if hash_of(sums.folder / each[0]) == each[1])
        return replace(ours, made=made, left=kept | new)


def leave(
    folder: AnyPath,
    files: Mapping[str, bytes],
    *,
    key: Key | None = None,
    overwrite: bool = False,
    instead: str = "choose another folder",
) -> None:
    """Write files into a folder that is shared with the user, and replace those left before.

    Args:
        folder: The folder, created if it does not exist.
        files: The content of each file, by name; they are written in this order.
        key: The key that the folder must have if files in it are ours; None for any key.
        overwrite: Whether to overwrite a user's files, or files with another key.
        instead: Advice for the error message.

    Raises:
        DatasetError: A user's file, a link, or a file with another key is in the way; nothing is
            written.
        OSError: The folder cannot be written.
    """
    path = folder.absolute()
    with held(path.parent, path.name):
        own = Ownership(Sums.read(folder, overwrite=overwrite))
        own.require_free(files, key, overwrite, instead)
        own.replace(files, key=key).write()


@contextmanager
def produced(
    folder: Place,
    key: Key,
    *,
    mark: str = Sums.FILE,
    names: Sequence[str] = (),
    ours: Sequence[str] = ("*",),
    overwrite: bool = False,
    instead: str = "choose another folder",
) -> Iterator[Place | None]:
    """Yield a folder to fill that becomes the artifact; None if the artifact is complete already.

    One process at a time does so. The caller may put temporary files beside a local folder. An
    object store cannot rename, so files are written to their final place, and listed at the end.

    Args:
        folder: The final place; a symbolic link to it stays.
        key: The inputs that determine the artifact.
        mark: The file whose absence tells readers that the artifact is unfinished.
        names: The files without which the artifact is damaged, by default all that are made. For a
            store they must be given, and no other file may be made.
        ours: Patterns of names that the artifact may use. A user's files with other names stay.
        overwrite: Whether to make the artifact even if it is complete, has another key, or has
            files that were changed.
        instead: Advice for the error message.

    Raises:
        DatasetError: A user's files would be lost, or an artifact with another key; or a file was
            damaged or changed.
        OSError: The folder cannot be written.
    """
    whole = WholeFolder.of(folder.absolute(), mark)
    path: Any = whole.folder
    with held(path.parent, path.name):
        whole.recover()
        own = Ownership(Sums.read(folder, overwrite=overwrite))
        if own.is_whole(key, ours, overwrite, instead):
            yield None
            return
        if not overwrite and (missing := own.sums.damaged()):
            say(f"{folder} is made again, because missing: {named(missing)}.")
        if not whole.is_replaced_at_once:
            # Empty the folder, and list the files to be made with an unknown hash.
            old = {name for name, _ in own.sums.hashes}
            claimed = frozenset((name, UNKNOWN) for name in old.union(names))
            replace(own.sums, made=claimed, left=frozenset()).write()
            for name in sorted(old, key=lambda name: name != mark):
                (folder / name).unlink(missing_ok=True)
        with whole.made() as made:
            yield made
            Sums.of(made, key, names).write()
            if made == path:
                return
            for name in own.strangers(ours, instead):  # The user may have added more.
                (made / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(path / name, made / name, follow_symlinks=False)


def _hashes_of(files: Mapping[str, bytes]) -> frozenset[tuple[str, str]]:
    """Return the name and the SHA-256 of each file."""
    return frozenset((n, hashlib.sha256(content).hexdigest()) for n, content in files.items())


def _is_there(path: AnyPath) -> bool:
    """Return whether a path exists, as a link that leads nowhere does."""
    return path.exists() or path.is_symlink()


def named(names: Sequence[str]) -> str:
    """Return the first three of some names, and how many more there are."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return f"{', '.join(names[:3])}{more}"


def held(folder: AnyPath, name: str) -> AbstractContextManager[bool]:
    """Hold the lock of `folder / name` as `File.held` does; say so before waiting for it."""
    waiting = f"waiting for another process that works on {folder / name}"
    return File(folder).held(name, lambda: say(waiting))


def within(folder: Place, *names: str) -> Place:
    """Return a folder inside a folder of ours, for files to be written to or removed from.

    Args:
        folder: The folder of ours, which may be a link.
        names: The names of the folders on the way, and of the folder itself.

    Raises:
        DatasetError: One of them is a link: what is behind it is not ours.
    """
    for name in names:
        folder = folder / name
        if folder.is_symlink():
            reason = "is a link, and nothing is written through it"
            raise DatasetError(f"{folder} {reason}: put a folder in its place, or remove it")
    return folder
