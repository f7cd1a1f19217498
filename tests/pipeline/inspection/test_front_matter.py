"""The front matter of the card, which makes the finished datasets of a folder configs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
import yaml
from support.making import Run
from support.tampering import content_of

from labyrinth_core.data import SPLITS, Manifest
from labyrinth_core.errors import DatasetError
from pipeline.inspection import front_matter

Build = Callable[..., Run]


def front_of(data_dir: Path) -> dict[str, Any]:
    _, front, _ = (data_dir / "README.md").read_text().split("---\n", 2)
    return yaml.safe_load(front)


@pytest.mark.slow
def test_the_card_lists_every_finished_config_with_the_sizes_of_its_files(
    build: Build, tmp_path: Path
) -> None:
    options = {"labyrinths": 1, "random_steps": 3}
    for other in ({"size": "4x3"}, {"size": "3", "task": "key_and_door"}, {"size": "3"}):
        build(tmp_path, **options | other)
    front = front_of(tmp_path)
    names = ["3x3-key_and_door", "3x3", "4x3"]
    tables = [f"{name}-labyrinths" for name in names]
    assert [config["config_name"] for config in front["configs"]] == names + tables
    assert [config.get("default") for config in front["configs"]] == [True, *[None] * 5]
    for config, info in zip(front["configs"], front["dataset_info"], strict=True):
        name = config["config_name"]
        folder = name.removesuffix("-labyrinths")
        assert info["config_name"] == name
        for file, counted in zip(config["data_files"], info["splits"], strict=True):
            split = file["split"]
            assert file["path"] in (
                f"{folder}/{split}-*-of-00001.parquet",
                f"{folder}/{Manifest.TABLE}",
            )
            (path,) = tmp_path.glob(file["path"])
            assert counted == {
                "name": split,
                "num_bytes": path.stat().st_size,
                "num_examples": pq.read_metadata(path).num_rows,
            }
        splits = [file["split"] for file in config["data_files"]]
        assert splits == (["labyrinths"] if name in tables else list(SPLITS.base))
        total = sum(counted["num_bytes"] for counted in info["splits"])
        assert info["download_size"] == info["dataset_size"] == total


def test_5x5_is_the_default_wherever_it_is(build: Build, tmp_path: Path) -> None:
    for size in ("3", "5", "6"):
        build(tmp_path, size=size, labyrinths=1, random_steps=1)
    assert [c["config_name"] for c in front_of(tmp_path)["configs"] if c.get("default")] == ["5x5"]


def test_other_keys_and_the_text_below_stay(build: Build, tmp_path: Path) -> None:
    build(tmp_path, labyrinths=1)
    path = tmp_path / "README.md"
    fence, front, _ = path.read_text().split("---\n", 2)
    mine = "\n# Mine\n\n---\n\nAn encyclopaedia of mazes: naïve, 迷路.\n"
    path.write_text(f"---\n{front}tags:\n- maze\nlicense: apache-2.0\n---\n{mine}", "utf-8")
    assert fence == ""
    build(tmp_path, size="2x3", labyrinths=1)
    text = path.read_text("utf-8")
    assert text.endswith(f"---\n{mine}")
    after = front_of(tmp_path)
    assert (after["tags"], after["license"]) == (["maze"], "apache-2.0")
    assert [config["config_name"] for config in after["configs"][:2]] == ["2x3", "3x3"]


@pytest.mark.parametrize(
    "text",
    [
        *(b"# My notes\n", b"", b"---\ntitle: Mine\n---\n", b"---\n- 1\n---\n", b"\xff\xfe"),
        b"---\nconfigs:\n- config_name: default\n  data_files: mine.csv\n---\n# Mine\n",
    ],
)
def test_a_readme_that_is_none_of_ours_stops_the_build(
    build: Build, tmp_path: Path, text: bytes
) -> None:
    (tmp_path / "README.md").write_bytes(text)
    with pytest.raises(DatasetError, match=r"README\.md .*choose another data_dir"):
        build(tmp_path)
    assert content_of(tmp_path) == {"README.md": text}


def test_leftovers_and_copies_of_datasets_are_no_configs(build: Build, tmp_path: Path) -> None:
    run = build(tmp_path, labyrinths=1)
    for name in (".4x4.building", ".3x3.replaced", "backup", "9x9"):
        (tmp_path / name).mkdir()
        (tmp_path / name / Manifest.FILE).write_bytes((run.folder / Manifest.FILE).read_bytes())
    (tmp_path / "web").mkdir()
    (tmp_path / "web" / Manifest.FILE).write_text('{"short_name": "an app"}')
    front_matter.update(tmp_path)
    assert [config["config_name"] for config in front_of(tmp_path)["configs"]] == [
        "3x3",
        "3x3-labyrinths",
    ]


def nested(opening: str, of: str, levels: int = 12) -> str:
    """Return YAML in which each value refers ten times to the one before."""
    names = [f"a{number}: &a{number} " for number in range(levels)]
    values = [of, *(opening % ", ".join([f"*a{n}"] * 10) for n in range(levels - 1))]
    return "".join(f"{name}{value}\n" for name, value in zip(names, values, strict=True))


@pytest.mark.parametrize(
    "added",
    [
        nested("[%s]", "[x]"),
        nested("{<<: [%s]}", "{x: y}"),
        nested("[%s]", "[x]") + "license: *a11\n",
        *("x: &x [*x]\n", "x: &x {a: *x}\n", "x: " + "[" * 9_999, "x: " + "{a: " * 9_999),
        *("x: " + "[" * 40 + "]" * 40 + "\n", f"x: {'a' * 300_000}\n", f"x: [{'1,' * 60_000}]\n"),
        *("x: " + "9" * 5_000, "x: 0x" + "f" * 5_000, "x: 1" + ":59" * 50_000),
        *("x: 2024-99-99", "x: 2001-12-14t21:59:43.10-99:99", "x: !!timestamp abc"),
        *("x: !!float abc", "x: !!int ''", "x: !!bool abc", "x: !!omap [a]", "? [a]\n: b\n"),
        *("x: !!python/object/apply:os.getcwd []", 'x: "\\ud800"', "x: *nowhere", "x: [", "\tx"),
    ],
)
def test_a_front_matter_that_cannot_be_read_is_refused_in_one_line_and_soon(
    tmp_path: Path, added: str
) -> None:
    path = tmp_path / "README.md"
    path.write_text(f"---\nconfigs: []\n{added}\n---\n# Mine\n")
    with pytest.raises(DatasetError, match=r"README\.md: its front matter cannot be read") as told:
        front_matter.read(path)
    assert "\n" not in str(told.value)


def test_aliases_and_dates_of_a_front_matter_are_read(tmp_path: Path) -> None:
    path = tmp_path / "README.md"
    path.write_text("---\nconfigs: []\nx: &x [1]\ny: [*x, *x]\nz: 2024-02-29\n---\n")
    values, _ = front_matter.read(path)
    assert (values["y"], str(values["z"])) == ([[1], [1]], "2024-02-29")


def test_a_readme_of_any_size_is_not_read_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(front_matter, "MOST_TEXT", 100)
    (tmp_path / "README.md").write_text("---\nconfigs: []\n---\n" + "x" * 100)
    with pytest.raises(DatasetError, match=r"README\.md has over 100 characters"):
        front_matter.read(tmp_path / "README.md")
