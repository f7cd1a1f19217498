"""croissant.json, as mlcroissant reads it."""

from __future__ import annotations

import io
import json
import logging

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image
from planting import DEFAULT, OTHER

from labyrinth_core.data.labyrinth_table import TABLE
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.splits import BASE_SPLITS
from labyrinth_core.data.storage import file_sha256
from pipeline.release import card
from pipeline.release.provenance import Release

pytestmark = [
    pytest.mark.slow,
    # Of rdflib and of pandas, about how mlcroissant 1.1 calls them.
    pytest.mark.filterwarnings("ignore:ConjunctiveGraph is deprecated:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:The inplace keyword"),
]

RESPONSIBLE = (
    *("dataLimitations", "dataBiases", "personalSensitiveInformation", "dataUseCases"),
    *("dataSocialImpact", "hasSyntheticData", "dataCollection", "dataCollectionType"),
)


def read(folder):
    import mlcroissant

    mapping = {"repo": str(folder)} if "containedIn" in content(folder)["distribution"][-1] else {}
    return mlcroissant.Dataset(jsonld=str(folder / "croissant.json"), mapping=mapping)


def content(folder):
    return json.loads((folder / "croissant.json").read_text(encoding="utf-8"))


def test_it_validates_without_a_warning(carded, caplog):
    with caplog.at_level(logging.WARNING):
        context = read(carded).metadata.ctx
    issues = context.issues
    assert context.is_v1_1()
    assert (set(issues.errors), set(issues.warnings), caplog.messages) == (set(), set(), [])


@pytest.mark.parametrize("name", [DEFAULT, OTHER])
def test_every_record_that_is_streamed_is_the_row(carded, name):
    records = list(read(carded).records(name))
    expected = []
    for path in sorted((carded / name).glob("*-of-*.parquet")):
        split = path.name.split("-")[0]
        expected += [row | {"split": split} for row in pq.read_table(path).to_pylist()]
    assert len(records) == len(expected) > 0
    for record, row in zip(records, expected, strict=True):
        assert set(record) == {f"{name}/{field}" for field in row}
        assert record[f"{name}/split"].decode() == row["split"]
        assert record[f"{name}/info"].decode() == row["info"]
        for field in ("actions", "rewards", "episode_starts"):
            assert record[f"{name}/{field}"] == row[field]
    for record, row in list(zip(records, expected, strict=True))[::23]:
        picture = Image.open(io.BytesIO(row["obs"]["bytes"]))
        assert np.array_equal(np.asarray(record[f"{name}/obs"]), np.asarray(picture))


@pytest.mark.parametrize("name", [DEFAULT, OTHER])
def test_every_record_of_the_table_of_labyrinths_is_its_row(carded, name):
    rows = pq.read_table(carded / name / TABLE).to_pylist()
    records = list(read(carded).records(f"{name}-labyrinths"))
    assert len(records) == len(rows) > 0
    for record, row in zip(records, rows, strict=True):
        assert set(record) == {f"{name}-labyrinths/{field}" for field in row}
        for field, value in row.items():
            found = record[f"{name}-labyrinths/{field}"]
            if value is None:
                assert found is None or found != found
            else:
                assert (found.decode() if isinstance(found, bytes) else found) == value


def test_every_parquet_file_is_there_with_its_hash_and_size(carded):
    files = {
        part["contentUrl"]: part for part in content(carded)["distribution"] if "/" in part["@id"]
    }
    there = {path.relative_to(carded).as_posix() for path in carded.glob("*/*.parquet")}
    assert set(files) == there
    assert len(there) == 2 * len(BASE_SPLITS) + 2
    for path, part in files.items():
        assert part["sha256"] == file_sha256(carded / path)
        assert part["contentSize"] == f"{(carded / path).stat().st_size} B"


def test_the_responsible_ai_fields_are_filled(carded):
    values = content(carded)
    assert all(values[f"rai:{name}"] for name in RESPONSIBLE)
    assert len(values["prov:wasGeneratedBy"]) == 2
    assert values["prov:wasDerivedFrom"]
    assert values["rai:hasSyntheticData"] is True
    assert read(carded).metadata.data_limitations == values["rai:dataLimitations"]


def test_what_is_not_released_points_at_nothing_on_the_hub(carded):
    values = content(carded)
    assert values["url"] == "README.md"
    assert "huggingface.co" not in json.dumps(values["distribution"])


def test_a_release_is_named_with_its_version_and_is_read_from_a_copy(folder):
    rows = len(list(read(folder).records(OTHER)))
    card.write_card(folder, Release("somebody/mazes", "1.2.0"))
    assert content(folder)["distribution"][0]["contentUrl"].endswith("/datasets/somebody/mazes")
    assert len(list(read(folder).records(OTHER))) == rows
    metadata = read(folder).metadata
    assert metadata.version == "1.2.0"
    assert metadata.url == "https://huggingface.co/datasets/somebody/mazes"
    assert not metadata.ctx.issues.warnings


def test_a_file_of_no_split_is_not_read(folder):
    manifest = Manifest.read(folder / DEFAULT)
    (folder / DEFAULT / "other-00000-of-00001.parquet").write_bytes(b"not a Parquet file")
    assert len(list(read(folder).records(DEFAULT))) == sum(s.rows for s in manifest.shards)
