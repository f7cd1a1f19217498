"""The stage `certify`: leakage in labyrinths from elsewhere, and in anyone's benchmark.

It writes one file for each source, in `data_dir/analysis/`.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labyrinth_core.benchmarks import CertifyError, certify
from labyrinth_core.errors import DatasetError, one_line, printable_line
from labyrinth_core.language import Collection, parse
from labyrinth_core.listing import files_in
from labyrinth_core.storage import AnyPath
from labyrinth_core.world import Labyrinth, Structure
from pipeline.certify.options import CertifyStageOptions
from pipeline.config import Job
from pipeline.inspection import as_text, find_leakage, front_matter, id_of
from pipeline.machinery import leave, say, tracked, within

PROBLEMS_SHOWN = 10
"""The maximum number of problems printed in the terminal."""

FOLDER = "analysis"
"""The folder in `data_dir` for the analyses of data from elsewhere."""


def run(job: Job[CertifyStageOptions]) -> None:
    """Certify the source that the options name.

    Raises:
        DatasetError: The source cannot be read, or its environment cannot be certified.
        OSError: The result cannot be written.
    """
    options = job.options.certify
    source = str(options.source)
    if options.is_benchmark:
        given = (options.train, options.test, options.probes, options.steps)
        lines = _certify_benchmark(job, _name_of(source, " ".join(map(str, given))))
    else:
        name = _name_of(source, options.config)
        lines = certify_labyrinths(
            source,
            options.config,
            within(job.data_dir, FOLDER),
            name,
            overwrite=job.options.overwrite,
        )
    for line in lines:
        say(line)


def _certify_benchmark(job: Job[CertifyStageOptions], name: str) -> Iterator[str]:
    """Certify an environment, a file of records or a Minari dataset, and yield lines to print."""
    options = job.options.certify
    try:
        certificate = certify(
            str(options.source).removeprefix("gymnasium:"),
            options.train,
            options.test,
            probes=options.probes,
            steps=options.steps,
            workers=job.options.workers,
        )
    except CertifyError as error:
        raise DatasetError(str(error)) from error
    text = json.dumps(certificate.to_json(), indent=1) + "\n"
    folder = within(job.data_dir, FOLDER)
    leave(folder, {name: text.encode()}, overwrite=job.options.overwrite)
    yield str(certificate)
    yield certificate.sentence
    yield f"{folder / name} has the full results."


def _name_of(source: str, config: str | None) -> str:
    """Return the path in `FOLDER` of an external dataset's analysis, unique to source and config.

    A source with a named config gets a folder, with a file for the config.
    """
    names = []
    for part in (source,) if config is None else (source, config):
        legible = re.sub(r"[^\w.-]+", "-", part).strip("-.")[:99]
        names.append(f"{legible}-{hashlib.sha256(part.encode()).hexdigest()[:8]}")
    return f"{'/'.join(names)}.json"


def certify_labyrinths(
    source: str, config: str | None, folder: AnyPath, name: str, *, overwrite: bool
) -> Iterator[str]:
    """Analyse an external dataset, print the table, and yield the other lines to print.

    Args:
        source: As for `read_elsewhere`.
        config: The config of the dataset, if it has several.
        folder: The folder for the result.
        name: The name of the result in it.
        overwrite: Whether to replace a result that a user has changed.

    Raises:
        DatasetError: The source holds no labyrinth; or some could not be read, which is raised
            after analysing the others.
        OSError: A file cannot be read or written.
    """
    found = read_elsewhere(source, config)
    leakage = find_leakage(found.splits)
    content = {
        "source": source,
        "config": config or found.config,
        "structures_alone": found.structures_alone,
        "problems": found.problems,
        "leakage": leakage.to_json(),
        "files": found.files,
    }
    leave(folder, {name: as_text(content).encode()}, overwrite=overwrite)
    path = folder / name
    say(leakage.table(with_routes=not found.structures_alone))
    yield from leakage.lines(found.files)
    if found.structures_alone:
        yield "Some labyrinths have no start and goal, so only structures are compared."
    yield f"{path} has the full results."
    if found.problems:
        yield from found.problems[1:PROBLEMS_SHOWN]
        raise DatasetError(
            f"{len(found.problems):,} labyrinths or files could not be read, and are not in the "
            f"analysis; {path} lists them all; the first: {found.problems[0]}"
        )


@dataclass(frozen=True)
class Elsewhere:
    """The labyrinths of an external dataset, with the problems in reading it."""

    splits: Mapping[str, Sequence[Labyrinth | Structure]]
    """Split -> its labyrinths, in order; or all structures, if any has no start and goal."""
    files: Mapping[str, Mapping[str, str]]
    """Split -> id of a labyrinth -> its first place in a file; empty if not read from files."""
    problems: Sequence[str]
    """A line for each labyrinth, or file, that could not be read."""
    config: str | None = None
    """The config that was read, if the dataset has named configs."""

    @property
    def structures_alone(self) -> bool:
        """Whether the splits hold structures instead of labyrinths."""
        return any(isinstance(held[0], Structure) for held in self.splits.values() if held)


def read_elsewhere(source: str, config: str | None) -> Elsewhere:
    """Return the labyrinths of an external dataset.

    Args:
        source: A file or a folder for `Collection`; or, for `load_dataset`, a folder with
            Parquet files or an id on the Hub, of which only the column `info` is read.
        config: The config of the dataset, if it has several.

    Raises:
        DatasetError: The source is none of these, or no labyrinth in it can be read.
        OSError: A file cannot be read.
    """
    path = Path(source).expanduser()
    if path.is_file() and not Collection.is_at(path):
        raise DatasetError(
            f"{source}: the name of a file must end in {', '.join(Collection.SUFFIXES)}"
        )
    files = files_in(path) if path.is_dir() else []
    rows = any(file.suffix == ".parquet" for file, _ in files)
    if path.is_file() or (path.is_dir() and not rows):
        found = _in_files(path)
        if found.splits:
            return found
        if found.problems or path.is_file():
            raise DatasetError(next(iter(found.problems), f"{source} holds no labyrinth"))
    if rows:  # `datasets` reads it without limits.
        with suppress(FileNotFoundError):
            front_matter.read_any(path / "README.md")
    # Resolved, because `datasets` finds no name for the folder `.`.
    streams, config = _infos_of(str(path.resolve()) if path.is_dir() else source, config)
    # Different texts may describe the same labyrinth, which then counts once.
    read = tracked(streams.items(), "read", len(streams))
    splits = {split: [*dict.fromkeys(_parsed(infos, split))] for split, infos in read}
    problems = [f"{printable_line(str(file))}: {reason}" for file, reason in files if reason]
    return Elsewhere(splits, {}, problems, config)


def _in_files(path: Path) -> Elsewhere:
    """Return the labyrinths in a file or a folder."""
    entries = list(Collection(path))
    alone = any(isinstance(entry.found, Structure) for entry in entries)
    splits: dict[str, list[Labyrinth | Structure]] = {}
    files: dict[str, dict[str, str]] = {}
    for split, place, found, _ in entries:
        if found is not None:
            held = found.structure if alone and isinstance(found, Labyrinth) else found
            splits.setdefault(split, []).append(held)
            files.setdefault(split, {}).setdefault(id_of(held), place)
    return Elsewhere(splits, files, [entry.problem for entry in entries if entry.problem])


def _parsed(infos: Iterator[str], split: str) -> Iterator[Labyrinth]:
    for info in dict.fromkeys(infos):
        try:
            yield parse(info)
        except ValueError as error:
            # Its first line says what is wrong, the others show where.
            reason = str(error).partition("\n")[0]
            raise DatasetError(f"{split} info: not a labyrinth: {reason}") from error


def _infos_of(source: str, config: str | None) -> tuple[dict[str, Iterator[str]], str | None]:
    """Return the config of a dataset and, streamed, the values of `info` in each split.

    No other column is downloaded. The name of a default config is printed.

    Raises:
        DatasetError: There is no such dataset; or, while streaming, it cannot be read.
    """
    import yaml
    from datasets import load_dataset

    from labyrinth_core import hub

    hub.prepare_client()
    try:
        splits = load_dataset(source, config, streaming=True, columns=["info"])
    except (*hub.FAILED, yaml.YAMLError) as error:  # `datasets` checks little.
        reason = hub.why_unavailable(source, error)
        if isinstance(error, yaml.YAMLError):
            reason = f"{source}: the front matter of its README.md cannot be read"
        elif "BuilderConfig" in str(error):  # No such config; the message lists the others.
            reason = source
        raise DatasetError(f"{reason}: {one_line(error)}") from error
    if config is None and (default := next(iter(splits.values())).config_name) != "default":
        named = printable_line(f"{source}: default config {default}")  # Named in its README.md.
        say(f"{named}; certify.config selects another.")
        config = default
    return {str(split): _infos(source, stream) for split, stream in splits.items()}, config


def _infos(source: str, stream: Any) -> Iterator[str]:
    from labyrinth_core import hub

    tables = stream.with_format("arrow").iter(batch_size=256)
    while True:
        try:
            table = next(tables, None)
            columns = None if table is None else table.to_pydict()  # A text may not be UTF-8.
        except hub.FAILED as error:
            raise DatasetError(f"{source} cannot be read: {one_line(error)}") from error
        if columns is None:
            return
        if "info" not in columns:
            raise DatasetError(f"{source} has no column info")
        for info in columns["info"]:
            if not isinstance(info, str):
                raise DatasetError(f"{source}: info={info!r}: every row needs a text")
            yield info
