"""What was seen of the seeds of two splits, in memory and in files.

A file of records, JSON lines or Parquet, has a row for each seed: `split` (train or test), `seed`,
and digests as texts: `first`, and `probes` (a list) and `state`, which may be missing or null. A
row that occurs again tells whether the seed gave the same again. The first line of a JSON file, or
the schema of a Parquet file, may name the environment and versions.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from labyrinth_core.benchmarks.encoding import digest
from labyrinth_core.benchmarks.environment import CertifyError
from labyrinth_core.benchmarks.levels import Digests

SUFFIXES = (".jsonl", ".parquet")
"""The ends of the names of files of records."""
SPLITS = ("train", "test")
LONGEST_LINE = 1 << 20
LONGEST_DIGEST = 128
HEAD = b"labyrinth_benchmark"
"""The key of the head in the schema of a Parquet file."""


@dataclass(frozen=True)
class Split:
    """What was seen of the seeds of a split, those at which the environment failed left out."""

    seeds: tuple[int, ...]
    digests: Mapping[str, Digests]
    """Measure -> the digest of each seed."""
    failed: tuple[tuple[int, str], ...] = ()
    """The seeds at which the environment failed, with the reason."""


@dataclass
class Recorded:
    """The content of a file of records."""

    splits: dict[str, Split]
    head: dict[str, Any] = field(default_factory=dict)
    again: int = 0
    """The number of seeds that were recorded more than once."""
    reasons: dict[str, str] = field(default_factory=dict)
    """Measure that cannot stand -> the reason."""


def read_records(path: Path) -> Recorded:
    """Return the content of a file of records.

    Raises:
        CertifyError: The file cannot be read, or is not a file of records.
    """
    try:
        rows = _json_rows(path) if path.suffix == ".jsonl" else _parquet_rows(path)
        return _gathered(path, rows)
    except OSError as error:
        raise CertifyError(f"{path}: {error.strerror or error}") from error


def _gathered(path: Path, rows: Iterator[tuple[str, Any]]) -> Recorded:
    seen: dict[tuple[str, int], tuple[int | None, ...]] = {}
    repeated: set[tuple[str, int]] = set()
    recorded = Recorded({})
    measures = ("first", "probes", "state")
    for number, (line, row) in enumerate(rows):
        if number == 0 and isinstance(row, dict) and "split" not in row:
            recorded.head = row
            continue
        key, digests = _checked(f"{path}, {line}", row)
        before = seen.setdefault(key, digests)
        if before is not digests:
            repeated.add(key)
            for measure, one, other in zip(measures, before, digests, strict=True):
                text = f"{key[0]} seed {key[1]} was recorded twice, with two values of {measure}"
                if one != other:
                    recorded.reasons.setdefault(measure, text)
    recorded.again = len(repeated)
    for split in SPLITS:
        of_split = {seed: digests for (name, seed), digests in seen.items() if name == split}
        if not of_split:
            raise CertifyError(f"{path}: no row has split {split}")
        columns = dict(zip(measures, zip(*of_split.values(), strict=True), strict=True))
        recorded.splits[split] = Split(
            tuple(of_split),
            {
                measure: np.array(column, np.uint64)
                for measure, column in columns.items()
                if None not in column
            },
        )
    return recorded


def _checked(line: str, row: Any) -> tuple[tuple[str, int], tuple[int | None, ...]]:
    """Return the split, the seed and the three digests of a row.

    Raises:
        CertifyError: The row is not a record.
    """

    def one(name: str, text: Any) -> int | None:
        if text is None:
            return None
        if not isinstance(text, str) or not 0 < len(text) <= LONGEST_DIGEST:
            raise CertifyError(f"{line}: {name}={text!s:.40}: give a digest as a text")
        own = re.fullmatch(r"[0-9a-f]{16}", text, re.ASCII)
        return int(text, 16) if own else digest(text.encode("utf-8", "surrogatepass"))

    if not isinstance(row, dict):
        raise CertifyError(f"{line}: not a record: {row!s:.40}")
    split, seed, probes = row.get("split"), row.get("seed"), row.get("probes")
    if split not in SPLITS:
        raise CertifyError(f"{line}: split={split!s:.40}: give train or test")
    if type(seed) is not int:
        raise CertifyError(f"{line}: seed={seed!s:.40}: give a whole number")
    if probes is not None and (not isinstance(probes, list) or not probes):
        raise CertifyError(f"{line}: probes={probes!s:.40}: give a list of digests")
    numbers = [one("probes", number) for number in probes or ()]
    known = [number for number in numbers if number is not None]
    joined = known[0] if len(known) == 1 else digest(*(b"%d;" % number for number in known))
    all_known = bool(numbers) and len(known) == len(numbers)
    digests = one("first", row.get("first")), joined if all_known else None
    return (split, seed), (*digests, one("state", row.get("state")))


def _json_rows(path: Path) -> Iterator[tuple[str, Any]]:
    with path.open("rb") as file:
        number = 0
        while line := file.readline(LONGEST_LINE + 1):
            number += 1
            if len(line) > LONGEST_LINE:
                raise CertifyError(f"{path}, line {number}: longer than {LONGEST_LINE:,} bytes")
            if not line.strip():
                continue
            try:
                yield f"line {number}", json.loads(line)
            except (ValueError, RecursionError) as error:
                raise CertifyError(f"{path}, line {number}: not JSON") from error


def _parquet_rows(path: Path) -> Iterator[tuple[str, Any]]:
    import pyarrow
    import pyarrow.parquet

    number = 0
    try:
        with pyarrow.parquet.ParquetFile(path) as file:
            if "split" not in file.schema_arrow.names:
                raise CertifyError(f"{path}: not a file of records: it has no column split")
            head = json.loads((file.schema_arrow.metadata or {}).get(HEAD, b"{}"))
            yield "schema", head if isinstance(head, dict) and "split" not in head else {}
            names = {"split", "seed", "first", "probes", "state"} & {*file.schema_arrow.names}
            for batch in file.iter_batches(batch_size=4096, columns=sorted(names)):
                for row in batch.to_pylist():
                    number += 1
                    yield f"row {number}", row
    except (pyarrow.ArrowException, ValueError) as error:
        if isinstance(error, CertifyError):
            raise
        raise CertifyError(f"{path}: not a Parquet file, or a damaged one") from error


def rows_of(splits: Mapping[str, Split]) -> Iterator[dict[str, Any]]:
    """Yield the rows of a file of records."""

    def text(split: Split, measure: str, index: int) -> str | None:
        column = split.digests.get(measure)
        return None if column is None else f"{int(column[index]):016x}"

    for name, split in splits.items():
        for index, seed in enumerate(split.seeds):
            probes = text(split, "probes", index)
            yield {
                "split": name,
                "seed": seed,
                "first": text(split, "first", index),
                "probes": None if probes is None else [probes],
                "state": text(split, "state", index),
            }


def json_lines(rows: Iterable[Mapping[str, Any]]) -> bytes:
    """Return rows as JSON lines."""
    return b"".join(json.dumps(row, separators=(",", ":")).encode() + b"\n" for row in rows)


def parquet(head: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]) -> bytes:
    """Return rows as a Parquet file, with the head in its schema."""
    import pyarrow
    import pyarrow.parquet

    texts = pyarrow.string()
    columns = {"split": texts, "seed": pyarrow.int64(), "first": texts}
    columns |= {"probes": pyarrow.list_(texts), "state": texts}
    schema = pyarrow.schema(columns.items(), metadata={HEAD: json.dumps(head).encode()})
    sink = pyarrow.BufferOutputStream()
    try:
        pyarrow.parquet.write_table(pyarrow.Table.from_pylist(list(rows), schema), sink)
    except OverflowError as error:
        raise CertifyError("Parquet holds seeds below 2**63: write JSON lines instead") from error
    content: bytes = sink.getvalue().to_pybytes()
    return content
