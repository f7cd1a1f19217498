"""croissant.json, as mlcroissant reads it."""

from __future__ import annotations

import io
import json
import logging
import re

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image
from support.planting import DEFAULT, OTHER

from labyrinth_core.data import SPLITS, Manifest
from labyrinth_core.storage import File
from pipeline.release import card
from pipeline.release.texts import Release

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


def is_same(found, value):
    """Return whether mlcroissant gives a value of a row."""
    if value is None:
        return found is None or found != found
    if isinstance(value, dict):
        picture = np.asarray(Image.open(io.BytesIO(value["bytes"])))
        return np.array_equal(np.asarray(found), picture)
    return (found.decode() if isinstance(found, bytes) else found) == value


@pytest.mark.parametrize("name", [DEFAULT, OTHER])
def test_every_record_that_is_streamed_is_the_row(carded, name):
    states = []
    for path in sorted((carded / name).glob("*-of-*.parquet")):
        split = path.name.split("-")[0]
        states += [row | {"split": split} for row in pq.read_table(path).to_pylist()]
    labyrinths = pq.read_table(carded / name / Manifest.TABLE).to_pylist()
    for config, rows in ((name, states), (f"{name}-labyrinths", labyrinths)):
        records = list(read(carded).records(config))
        assert len(records) == len(rows) > 0
        for number, (record, row) in enumerate(zip(records, rows, strict=True)):
            assert set(record) == {f"{config}/{field}" for field in row}
            for field, value in row.items():
                if field != "obs" or number % 23 == 0:  # Pictures take long to be decoded.
                    assert is_same(record[f"{config}/{field}"], value), (config, field)


def test_every_parquet_file_is_there_with_its_hash_and_size(carded):
    files = {
        part["contentUrl"]: part for part in content(carded)["distribution"] if "/" in part["@id"]
    }
    there = {path.relative_to(carded).as_posix() for path in carded.glob("*/*.parquet")}
    assert set(files) == there
    assert len(there) == 2 * len(SPLITS.base) + 2
    for path, part in files.items():
        assert part["sha256"] == File(carded / path).sha256()
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
    assert not any("containedIn" in part for part in values["distribution"])


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


def test_card_and_croissant_say_that_goals_vary(tmp_path, build):
    build(tmp_path, random_steps=5, goals="varied")
    build(tmp_path, size="4", labyrinths=3, random_steps=5)
    card.write_card(tmp_path)
    readme, croissant = (
        (tmp_path / name).read_text(encoding="utf-8") for name in ("README.md", "croissant.json")
    )
    command, other = (
        line
        for line in re.sub(r"\\\n +", "", readme).splitlines()
        if line.startswith("labyrinth-datasets size")
    )
    assert "size=3x3 " in command
    assert command.endswith(" goals=varied")
    assert "goals" not in other
    for text in (readme, croissant):
        assert "With `goals=varied` (`3x3`) each labyrinth has its own start and goal" in text
        assert "But for `3x3`, in `train`, `validation`, `test` and `random` the" in text
    assert "With varied start and goal (`3x3`), any rotation" in readme
