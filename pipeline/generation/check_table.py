"""The check of the table of labyrinths against what the rows of the shards say."""

from __future__ import annotations

from collections.abc import Iterator

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.errors import one_line
from labyrinth_core.data.format import TABLE_COLUMNS
from labyrinth_core.data.manifest import TABLE, Manifest
from labyrinth_core.data.storage import AnyPath, file_sha256
from pipeline.generation.tabulate import Facts, facts_table, opened_table, table_part
from pipeline.generation.write import arrow_schema


def table_file_problems(folder: AnyPath, manifest: Manifest) -> tuple[list[str], bool]:
    """Return what is wrong with the file as a whole, and whether its rows can be compared."""
    import pyarrow as pa

    path = folder / TABLE
    try:
        problems = []
        digest, expected = file_sha256(path), manifest.table.sha256
        if digest != expected:
            problems.append(f"{TABLE}: sha256 {digest}, but the manifest says {expected}")
        with opened_table(path) as file:
            rows, schema = file.metadata.num_rows, file.schema_arrow
    except FileNotFoundError:
        return [f"{TABLE} is missing"], False
    except (OSError, pa.ArrowException) as error:
        return [f"{TABLE} cannot be read: {one_line(error)}"], False
    expected_rows = sum(shard.labyrinths for shard in manifest.shards)
    if not schema.equals(arrow_schema(TABLE_COLUMNS), check_metadata=False):
        problems.append(f"{TABLE}: its columns are not those of a table of labyrinths")
    elif rows != expected_rows:
        problems.append(f"{TABLE}: {rows} rows, but the manifest has {expected_rows} labyrinths")
    else:
        return problems, True
    return problems, False


def table_problems(
    folder: AnyPath,
    config: DatasetConfig,
    split: str,
    facts: Facts,
    first: int,
    first_row: int,
) -> Iterator[str]:
    """Yield the columns of a part of the table that are not what the rows of a shard give.

    Each is named once, with the first row in which it is wrong.

    Args:
        folder: The folder of the dataset.
        config: The configuration of the dataset.
        split: The split of the shard.
        facts: What the rows of the shard say.
        first: The row of the table with the first labyrinth of the shard.
        first_row: The number of the split's rows before those of the shard.
    """
    import pyarrow as pa

    try:
        found = table_part(folder / TABLE, first, len(facts))
    except (OSError, ValueError, pa.ArrowException) as error:
        yield f"{TABLE} cannot be read: {one_line(error)}"
        return
    expected = facts_table(config, split, facts, first_row)
    for name in expected.column_names:
        pairs = zip(found[name].to_pylist(), expected[name].to_pylist(), strict=True)
        for row, (value, right) in enumerate(pairs, first):
            if value != right:
                yield f"{TABLE} row {row} {name}: {value!r:.99}, but the shard gives {right!r}"
                break
