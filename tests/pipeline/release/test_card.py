"""The card: true to the shards, the same for the same data, and kind to what a person wrote."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
import shutil
import sys
import threading
import time
from pathlib import Path

import datasets
import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from huggingface_hub import DatasetCard, DatasetCardData
from PIL import Image
from support.commands import ended
from support.making import (
    DemonstrationsConfig,
    RunConfig,
    SplitsConfig,
    composed,
    make,
    make_both,
    perform,
    resolve,
)
from support.planting import DEFAULT, OTHER, labyrinths, plant
from support.tampering import cut_short

from labyrinth_core import evaluate
from labyrinth_core.data import COLUMNS, SPLITS, TABLE_COLUMNS, Dataset, Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.language import dump, parse
from labyrinth_core.pictures import DEFAULT_STYLE
from labyrinth_core.world import Look, Solver
from pipeline.inspection import DatasetStatistics, front_matter, statistics, statistics_of
from pipeline.machinery import Sums
from pipeline.release import card, texts
from pipeline.release.figures import FIGURES, picture_with_route, pictures_of
from pipeline.release.repository import listed as files_of
from pipeline.release.texts import Release

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]
TEXTS = ("README.md", "CHANGELOG.md", "CITATION.cff", "SHA256SUMS", "croissant.json")


@pytest.fixture
def folder(folder: Path, carded: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of both datasets, to be changed; their pictures, which take longest, are not drawn."""
    drawn = everything(carded)

    def pictures(datasets: list[DatasetStatistics], _: str) -> dict[str, bytes]:
        names = pictures_of([dataset.name for dataset in datasets])
        return {name: drawn.get(name, b"") for name in names}

    monkeypatch.setattr(card, "_pictures", pictures)
    return folder


def text(folder: Path) -> str:
    return (folder / "README.md").read_text(encoding="utf-8")


def front(folder: Path) -> dict[str, object]:
    return yaml.safe_load(text(folder).split("---\n")[1])


def everything(folder: Path) -> dict[str, bytes]:
    """Return the bytes of every file of a folder, by path."""
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def tables(markdown: str) -> list[list[dict[str, str]]]:
    """Return the rows of each table of a text, by heading, without marks of code."""
    found = []
    for lines in re.findall(r"(?:^\|.*\|\n)+", markdown, re.MULTILINE):
        cells = [line.strip("|\n ").split(" | ") for line in lines.splitlines()]
        plain = [[cell.strip("`") for cell in row] for row in cells]
        found.append([dict(zip(plain[0], row, strict=True)) for row in plain[2:]])
    return found


def table(markdown: str, *headings: str) -> list[dict[str, str]]:
    """Return the first table that has all the headings."""
    return next(rows for rows in tables(markdown) if set(headings) <= set(rows[0]))


def test_the_numbers_of_rows_are_those_of_the_shards(carded):
    rows = {row["split"]: row for row in table(text(carded), "split", DEFAULT, OTHER)}
    assert list(rows) == [*SPLITS.base, "all rows", "MB"]
    total = 0
    for name in (DEFAULT, OTHER):
        counts = {}
        for split in SPLITS.base:
            paths = (carded / name).glob(f"{split}-*.parquet")
            counts[split] = sum(pq.read_metadata(path).num_rows for path in paths)
            assert rows[split][name] == f"{counts[split]:,}"
        assert rows["all rows"][name] == f"{sum(counts.values()):,}"
        total += sum(counts.values())
        infos = {info["config_name"]: info for info in front(carded)["dataset_info"]}
        stated = {split["name"]: split["num_examples"] for split in infos[name]["splits"]}
        assert stated == counts
    assert f"**{total:,} rows** in 2 configs" in text(carded)


def test_a_card_says_what_each_split_shifts_and_holds_as_the_splits_themselves_do():
    compared = yaml.safe_load(texts.read("splits.yaml"))
    assert list(compared) == list(SPLITS)
    for name, (shifted, held) in compared.items():
        kind = SPLITS[name]
        of_train = name == "train" or (kind.parent == "train" and not kind.new_structure)
        new = {"structure": not of_train, "start": kind.new_start, "goal": kind.new_goal}
        for factor, is_new in new.items():
            assert (factor in re.split(r"\W+", shifted)) == is_new, name
            assert is_new or held == "everything" or factor in re.split(r"\W+", held), name
        assert ("colours" in shifted) == (kind.look is Look.RECOLOURED)
        assert ("walls" in shifted) == (kind.look is Look.THIN_WALLS)


def test_a_card_after_an_analysis_counts_no_row_again_but_finds_a_damaged_shard(
    tmp_path, monkeypatch
):
    data_dir = tmp_path / "labyrinth"
    made = make(data_dir, "2x3", labyrinths=2, random_steps=5)
    perform("analyse", (run := resolve(RunConfig(size="2x3", data_dir=str(data_dir)))))
    with monkeypatch.context() as patch:
        patch.setattr(statistics, "count_shard", None)
        perform("card", run)
    first = everything(data_dir)
    statistics.count_dataset(Dataset.at(make(tmp_path / "other", "2x3", labyrinths=1)))
    card.write_card(data_dir)
    assert everything(data_dir) == first
    statistics.count_dataset(Dataset.at(made))
    cut_short(made / "train-00000-of-00001.parquet")
    with pytest.raises(DatasetError, match=r"train-00000-of-00001\.parquet is damaged"):
        card.write_card(data_dir)


def test_a_card_says_what_route_memory_and_random_steps_solve_of_test(carded):
    told = " ".join(text(carded).split())
    for name in (DEFAULT, OTHER):
        baselines = evaluate(right, carded, name, splits=["test"]).baselines
        solved = [f"{baselines[each]['test']['sr']:.0%}" for each in ("route_memory", "random")]
        spl = f"{baselines['random']['test']['spl']:.0%}"
        assert f"`{name}` {solved[0]} and {solved[1]} (SPL {spl})" in told
    assert told.index("What needs no learning") < told.index("## Load it")


def right(observations):
    return np.ones(len(observations), np.int64)


def test_the_certificate_in_the_text_has_a_line_for_every_pair_of_splits(carded):
    lines = table(text(carded), "config", "splits", "in both")
    assert len(lines) == 2 * 3
    assert {line["in both"] for line in lines} == {"0"}
    assert {line["in both, or as a mirror image"] for line in lines} == {"0"}
    assert {line["structures"] for line in lines} == {"7 and 7", "3 and 3"}


def test_a_card_says_how_near_the_splits_are_once_that_was_analysed(folder):
    assert "walls to the nearest" not in text(folder)
    assert "can differ from one of `train` in a single wall. Small" in text(folder)
    options = {"stages": ["analyse"], "size": DEFAULT, "labyrinths": 7, "data_dir": str(folder)}
    perform("analyse", resolve(RunConfig(**options)))
    card.write_card(folder)
    pairs = json.loads((folder / DEFAULT / Manifest.ANALYSIS).read_bytes())["leakage"]["pairs"]
    lines = table(text(folder), "config", "same route")
    assert [line["splits"].replace("`", "") for line in lines] == [
        f"{pair['first']}, {pair['second']}" for pair in pairs
    ]
    for line, pair in zip(lines, pairs, strict=True):
        walls = sorted(walls for _, walls in pair["nearest"].values())
        assert line["walls to the nearest"] == f"{walls[0]}, {walls[3]}"
        within = [sum(apart <= most for apart in walls) for most in (1, 2, 3)]
        assert [line["1 wall away"], line["2 walls"], line["3 walls"]] == list(map(str, within))
        assert (line["of"], line["turned"]) == ("7", str(len(pair["symmetric"])))
        assert line["same route"] == str(len(pair["same_route"]))
    near = sum(apart <= 1 for _, apart in pairs[1]["nearest"].values())
    assert f"in a single wall: `{DEFAULT}` {near} of 7 do." in text(folder)
    assert f"{DEFAULT}/{Manifest.ANALYSIS}" in (folder / Sums.FILE).read_text(encoding="utf-8")

    path = folder / DEFAULT / Manifest.ANALYSIS
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b'"spread": "', b'"spread": "9', 1))
    refused(folder, r"analysis\.json cannot be read: .*its sha256 is not the one in SHA256SUMS")
    perform("analyse", resolve(RunConfig(**options, overwrite=True)))
    assert path.read_bytes() == whole


def test_limits_say_what_holds_of_these_options_alone(build, tmp_path):
    noise = DemonstrationsConfig(noise=0.3)
    splits = SplitsConfig(min_walls=2)
    looks = ["recoloured", "thin_walls"]
    build(tmp_path / "a", demonstrations=noise, splits=splits, shifts=looks)
    build(tmp_path / "b", solutions="all", solutions_limit=2)
    for name in "ab":
        card.write_card(tmp_path / name)
    first, second = (" ".join(text(tmp_path / name).split()) for name in "ab")
    assert "in as few as 2 walls" in first
    assert "Demonstrations with noise also walk into walls" in first
    assert "all but `recoloured` and `thin_walls` in the same colours" in first
    assert "in a single wall" in second
    assert "no demonstration walks into a wall" in second
    assert "in the same colours and at the same scale" in second
    assert re.search(r"at most `solutions_limit` demonstrations; \d+ labyrinths reach", second)


def test_limits_and_citation_come_before_statistics(carded):
    headings = re.findall(r"^## (.*)$", text(carded), re.MULTILINE)
    assert headings[:5] == ["Load it", "Content", "Limits and biases", "Licence", "Citation"]
    assert headings.index("Statistics") > 5


def test_the_front_matter_is_what_the_hubs_client_reads_and_writes(carded):
    content = DatasetCard(text(carded))
    assert str(content) == text(carded)
    values = content.data.to_dict()
    assert DatasetCardData(**values).to_dict() == values == front(carded)
    names = [DEFAULT, OTHER]
    assert [config["config_name"] for config in values["configs"]] == names + tables_of(names)
    assert [c["config_name"] for c in values["configs"] if c.get("default")] == [DEFAULT]
    assert values["license"] == "mit"
    assert values["pretty_name"] == "Labyrinth"
    assert "arxiv:2509.24784" in values["tags"]
    assert values["task_categories"] == ["reinforcement-learning"]
    assert values["annotations_creators"] == ["machine-generated"]
    assert (values["source_datasets"], values["language"]) == (["original"], ["en"])
    features = datasets.Features._from_yaml_list(values["dataset_info"][0]["features"])
    assert features.to_dict() == {column.name: column.feature for column in COLUMNS}
    features = datasets.Features._from_yaml_list(values["dataset_info"][2]["features"])
    assert features.to_dict() == {column.name: column.feature for column in TABLE_COLUMNS}


def tables_of(names: list[str]) -> list[str]:
    return [f"{name}-labyrinths" for name in names]


def test_the_table_of_labyrinths_is_described(carded):
    described = [rows for rows in tables(text(carded)) if "meaning" in rows[0]][1]
    meanings = [(row["column"], row["meaning"]) for row in described]
    assert meanings == [(column.name, column.meaning) for column in TABLE_COLUMNS]
    assert f"'hf://datasets/user/labyrinth/{DEFAULT}/labyrinths.parquet'" in text(carded)


def test_the_size_categories_are_the_hubs():
    listed = re.search(r"size_categories.*?(?=source_datasets)", DatasetCardData.__doc__, re.DOTALL)
    ours = [card.size_category(10**digits - 1) for digits in range(3, 14)]
    assert re.findall(r"'([^']+)'", listed[0]) == [*ours, "other"]
    counts = (1, 999, 1_000, 99_999, 10**6, 10**13)
    assert [card.size_category(count) for count in counts] == [
        *("n<1K", "n<1K", "1K<n<10K", "10K<n<100K", "1M<n<10M", "n>1T")
    ]


def test_every_python_block_runs_on_the_folder(carded, tmp_path):
    blocks = re.findall(r"```python\n(.*?)```", text(carded), re.DOTALL)
    assert len(blocks) == 3
    local = "def hf_hub_download(folder, name, repo_type):\n    return f'{folder}/{name}'\n"
    program = "\n".join(blocks).replace("user/labyrinth", str(carded))
    program = program.replace("from huggingface_hub import hf_hub_download\n", local)
    program += "\nprint(row['actions'], observation.shape, action, picture.size, len(actions))"
    program += "\nprint(len(steps), min(steps['actions']), min(actions))"
    environment = os.environ | {"HF_HOME": str(tmp_path), "HF_HUB_OFFLINE": "1"}
    done = ended([sys.executable, "-W", "error", "-c", program], env=environment, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    first = pq.read_table(next((carded / DEFAULT).glob("train-*.parquet")))["actions"]
    acted = sum(action >= 0 for action in first.to_pylist())
    assert acted < len(first)
    expected = f"{first[0]} (64, 64, 3) {first[0]} (600, 600) {acted}"
    assert done.stdout.splitlines()[-2:] == [expected, f"{acted} 0 0"]


def test_a_release_is_loaded_by_its_id_and_version(folder):
    card.write_card(folder, Release("somebody/mazes", "1.0.0"))
    assert "user/labyrinth" not in text(folder)
    blocks = re.findall(r"```python\n(.*?)```", text(folder), re.DOTALL)
    assert len(blocks) == 3
    for block in blocks:
        compile(block, "README.md", "exec")
        assert '"somebody/mazes"' in block
        assert 'revision="1.0.0"' in block
    citation = yaml.safe_load((folder / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert (citation["type"], citation["version"]) == ("dataset", "1.0.0")
    assert citation["url"] == "https://huggingface.co/datasets/somebody/mazes"
    assert citation["preferred-citation"]["url"] == "https://arxiv.org/abs/2509.24784"


def test_the_commands_in_it_make_the_same_datasets(carded):
    lines = text(carded).replace(" \\\n", " ")
    commands = re.findall(r"^labyrinth-datasets (.*)$", lines, re.MULTILINE)
    made = [composed(*shlex.split(command)).dataset for command in commands]
    assert made == [Manifest.read(carded / name).config for name in (DEFAULT, OTHER)]


def test_every_link_within_the_folder_leads_to_a_file_or_heading(carded):
    links = re.findall(r"\]\(([^):]+)\)", text(carded))
    headings = re.findall(r"^#+ (.*)$", text(carded), re.MULTILINE)
    anchors = {"#" + heading.lower().replace(" ", "-") for heading in headings}
    assert len(links) == 2 + 2 * len(FIGURES)
    for link in links:
        assert link in anchors or (carded / link).is_file()


def test_the_example_of_the_language_is_the_first_labyrinth_of_test(carded):
    example = "key_and_lock" + text(carded).split("```\nkey_and_lock", 1)[1].split("```", 1)[0]
    assert dump(parse(example)) == labyrinths(carded / DEFAULT, "test")[0]


def test_the_hashes_are_those_of_all_files(carded):
    first, *lines = (carded / "SHA256SUMS").read_text(encoding="utf-8").splitlines()
    assert first[0] == "#"  # A comment, for `sha256sum -c`.
    stated = dict(reversed(line.split("  ", 1)) for line in lines)
    files = {path: data for path, data in everything(carded).items() if "SHA256SUMS" not in path}
    assert stated == {path: hashlib.sha256(data).hexdigest() for path, data in files.items()}
    assert list(stated) == sorted(stated)


def test_the_same_data_give_the_same_bytes_in_another_folder(carded, tmp_path):
    other = make_both(tmp_path / "elsewhere")
    for _ in range(2):
        card.write_card(other)
        assert everything(other) == everything(carded)
    for path in TEXTS:
        content = (carded / path).read_text(encoding="utf-8")
        assert not any(
            name in content for name in (str(carded.parent), str(ROOT), str(Path.home()))
        )


def test_a_build_that_finds_nothing_to_do_changes_no_byte_of_the_card(folder):
    before = everything(folder)
    front_matter.update(folder)
    assert everything(folder) == before


def test_a_build_writes_a_card_in_brief_that_the_stage_replaces(tmp_path):
    make(tmp_path, "2x3", labyrinths=1, random_steps=5)
    brief = text(tmp_path)
    assert front_matter.BEGIN in brief
    assert "## Statistics" not in brief
    card.write_card(tmp_path)
    assert text(tmp_path).count("# Labyrinth\n") == 1
    assert "## Statistics" in text(tmp_path)


def test_a_dataset_that_is_finished_while_the_card_is_written_joins_it(folder, monkeypatch):
    listed, finished = threading.Event(), threading.Event()

    def waiting(*arguments):
        datasets = statistics_of(*arguments)
        listed.set()
        finished.wait()
        return datasets

    monkeypatch.setattr(card, "statistics_of", waiting)
    writer = threading.Thread(target=card.write_card, args=(folder,))
    writer.start()
    listed.wait()
    options = {"labyrinths": 1, "random_steps": 5}
    builder = threading.Thread(target=make, args=(folder, "2x3"), kwargs=options)
    builder.start()
    while builder.is_alive() and not (folder / "2x3" / "manifest.json").exists():
        time.sleep(0.01)
    finished.set()
    writer.join()
    builder.join()
    names = ["2x3", DEFAULT, OTHER]
    configs = [config["config_name"] for config in front(folder)["configs"]]
    assert configs == names + tables_of(names)
    assert "## Statistics" in text(folder)


def test_what_a_person_wrote_around_it_and_into_the_front_matter_is_kept(folder):
    path = folder / "README.md"
    content = text(folder).replace("pretty_name: Labyrinth", "pretty_name: My mazes")
    content = content.replace("tags:\n", "viewer: false\ntags:\n- mine\n")
    content = content.replace(front_matter.BEGIN, f"Before.\n\n{front_matter.BEGIN}\nLost.\n")
    path.write_text(f"{content}\nAfter, with ``` and ---\n", encoding="utf-8")
    card.write_card(folder)
    written = text(folder)
    assert "\nBefore.\n\n" + front_matter.BEGIN in written
    assert written.endswith("\nAfter, with ``` and ---\n")
    assert "Lost." not in written
    values = front(folder)
    assert values["viewer"] is False
    assert values["pretty_name"] == "My mazes"
    assert values["tags"] == [*card.TAGS, "mine"]
    card.write_card(folder)
    assert text(folder) == written


def test_text_without_marks_is_a_persons_and_follows_the_generated_part(folder):
    path = folder / "README.md"
    matter = text(folder).split("---\n")[1]
    path.write_text(f"---\n{matter}---\nMine alone.\n", encoding="utf-8")
    card.write_card(folder)
    assert text(folder).endswith(f"{front_matter.END}\n\nMine alone.\n")
    written = everything(folder)
    card.write_card(folder)
    assert everything(folder) == written


FOREIGN = (
    "CITATION.cff",
    "croissant.json",
    "CHANGELOG.md",
    "pictures/labyrinth.png",
    f"pictures/{DEFAULT}-visits.png",
)


@pytest.mark.parametrize("was_ours", [False, True])
def test_files_that_a_person_made_or_changed_are_left_alone_and_named(folder, was_ours, capsys):
    if not was_ours:
        for path in [*(folder / name for name in TEXTS), *(folder / "pictures").iterdir()]:
            path.unlink()
        front_matter.update(folder)
    for name in FOREIGN:
        (folder / name).write_bytes(b"mine")
    card.write_card(folder)
    assert {name: (folder / name).read_bytes() for name in FOREIGN} == dict.fromkeys(
        FOREIGN, b"mine"
    )
    *_, last = capsys.readouterr().out.splitlines()
    assert "because no card wrote them, or they were damaged or changed since; overwrite" in last
    assert sorted(last.rstrip(".").partition(": ")[2].split(", ")) == sorted(FOREIGN)
    listed = (folder / Sums.FILE).read_text(encoding="utf-8")
    assert not any(name in listed for name in FOREIGN)
    assert not {*FOREIGN} & {*files_of(folder)}
    card.write_card(folder, overwrite=True)
    assert {*FOREIGN} <= {*files_of(folder)}


def test_without_questions_there_is_no_eval_file_and_the_card_removes_its_own_alone(folder):
    path = folder / "eval.yaml"
    for content, is_ours in ((b"ours", True), (b"mine", False)):
        path.write_bytes(content)
        if is_ours:
            with (folder / Sums.FILE).open("a", encoding="utf-8") as file:
                file.write(f"{hashlib.sha256(content).hexdigest()}  eval.yaml\n")
        card.write_card(folder)
        assert path.exists() == (not is_ours)
        assert "eval.yaml" not in (folder / Sums.FILE).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("licence", "named"),
    [
        ("cc-by-4.0", "cc-by-4.0"),
        (["mit", "cc0-1.0"], "mit, cc0-1.0"),
        ("a\x1b[2J\nb", r"a\x1b[2J\nb"),
    ],
)
def test_a_licence_that_a_person_gives_is_kept_and_named_everywhere(folder, licence, named):
    path = folder / "README.md"
    given = yaml.safe_dump({"license": licence})
    path.write_text(text(folder).replace("license: mit\n", given), encoding="utf-8")
    card.write_card(folder)
    assert front(folder)["license"] == licence
    assert f"## Licence\n\n`{named}`" in text(folder)
    assert "opensource.org" not in text(folder)
    assert json.loads((folder / "croissant.json").read_bytes())["license"] == named
    assert "license" not in yaml.safe_load((folder / "CITATION.cff").read_text(encoding="utf-8"))


def refused(folder: Path, message: str) -> None:
    """Check that no card is written, and nothing changed, for a reason in one line."""
    before = everything(folder)
    with pytest.raises(DatasetError, match=message) as caught:
        card.write_card(folder)
    assert "\n" not in str(caught.value)
    assert everything(folder) == before


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("README.md", "# Another project\n", "is not the README of a dataset: choose another"),
        ("SHA256SUMS", f"{'0' * 64}  thesis.txt\n", "SHA256SUMS is another program's: move it"),
        (
            f"{OTHER}/test-00000-of-00001.parquet",
            "damaged",
            "is damaged: it has 7 bytes, and the manifest says [0-9]+; delete it, and build",
        ),
        (f"{DEFAULT}/labyrinths.parquet", "damaged", r"labyrinths\.parquet is damaged: its sha256"),
        (
            f"{DEFAULT}/{Manifest.ANALYSIS}",
            "{",
            r"analysis\.json cannot be read: .*; stages=analyse",
        ),
    ],
)
def test_a_file_that_is_damaged_or_of_something_else_is_refused(folder, name, content, message):
    (folder / name).write_bytes(content.encode("latin-1"))
    refused(folder, message)


def test_an_analysis_of_other_rows_is_neither_shown_nor_published(folder):
    (folder / DEFAULT / Manifest.ANALYSIS).write_text(
        '{"fingerprint": "of other rows"}', encoding="utf-8"
    )
    card.write_card(folder)
    assert "walls to the nearest" not in text(folder)
    assert f"{DEFAULT}/{Manifest.ANALYSIS}" not in files_of(folder)


@pytest.mark.parametrize("mark", [front_matter.BEGIN, front_matter.END])
def test_a_readme_with_one_mark_only_is_refused(folder, mark):
    (folder / "README.md").write_text(text(folder).replace(mark, ""), encoding="utf-8")
    refused(folder, "one of the two marks of the generated text is missing")


def test_a_dataset_without_its_manifest_is_named_and_not_left_out(folder):
    (folder / "3x4-key_and_door" / Manifest.FILE).unlink()
    refused(folder, r"3x4-key_and_door is a dataset without its manifest\.json: move it away, and")
    shutil.move(folder / "3x4-key_and_door", folder.parent)
    card.write_card(folder)


def test_a_dataset_with_a_leak_gets_no_card(folder):
    copied = labyrinths(folder / DEFAULT, "train")[0]
    plant(folder / DEFAULT, "test", labyrinths(folder / DEFAULT, "test")[0], copied)
    refused(folder, "3x3: train and test share 1 structure, 1 counting mirror images")


def test_a_folder_without_a_dataset_gets_no_card(tmp_path):
    refused(tmp_path / "nowhere", "holds no finished dataset")


def test_the_stage_says_in_one_line_what_was_written(folder, capsys):
    run = resolve(RunConfig(stages=["card"], size="3", data_dir=str(folder)))
    card.run(run)
    last = capsys.readouterr().out.splitlines()[-1]
    assert last == f"{folder / 'README.md'} describes 3x3, 3x4-key_and_door."


def test_the_stage_is_performed_unless_told_otherwise():
    assert composed().options.stages == ("build", "validate", "analyse", "card")


def test_every_config_has_every_picture_wide_enough_for_a_phone(carded):
    pictures = {path.name for path in (carded / "pictures").iterdir()}
    expected = {f"{name}-{figure}.png" for name in (DEFAULT, OTHER) for figure in FIGURES}
    assert pictures == expected | {"labyrinth.png"}
    for name in pictures:
        with Image.open(carded / "pictures" / name) as image:
            assert (image.width, image.mode) == (1080, "RGB")
            assert np.asarray(image).mean() > 140


def test_pictures_of_a_dataset_that_is_gone_go_and_a_persons_stay(folder):
    shutil.copy(folder / "pictures" / "labyrinth.png", folder / "pictures" / "mine.png")
    shutil.rmtree(folder / OTHER)
    card.write_card(folder)
    pictures = {path.name for path in (folder / "pictures").iterdir()}
    own = {f"{DEFAULT}-{figure}.png" for figure in FIGURES}
    assert pictures == own | {"labyrinth.png", "mine.png"}
    assert "pictures/mine.png" not in (folder / "SHA256SUMS").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", [DEFAULT, OTHER])
def test_a_route_is_drawn_through_the_cells_it_visits_and_no_others(carded, name):
    labyrinth = parse(labyrinths(carded / name, "test")[0])
    (actions, *_) = Solver(labyrinth).shortest_routes()
    picture = np.asarray(picture_with_route(labyrinth, actions, 100)).astype(int)
    height, width = labyrinth.structure.height, labyrinth.structure.width
    cell = len(picture) / max(height, width)
    margin = (len(picture) - height * cell) / 2
    visited, at = {labyrinth.start}, labyrinth.start
    for action in actions:
        at = labyrinth.structure.moves[at][action]
        visited.add(at)
    for number in range(height * width):
        row, column = divmod(number, width)
        y, x = len(picture) - margin - (row + 0.5) * cell, (column + 0.5) * cell
        green = np.abs(picture[int(y), int(x)] - DEFAULT_STYLE.agent).max() < 8
        assert green == (number in visited)


def manifests(folder: Path, *names: str) -> list[Manifest]:
    return [Manifest.read(folder / name) for name in names]


def test_a_version_takes_the_place_of_unreleased_and_older_entries_stay(carded):
    content = (carded / "CHANGELOG.md").read_text(encoding="utf-8")
    assert content == card.changelog("", manifests(carded, DEFAULT, OTHER), None)
    for manifest in manifests(carded, DEFAULT, OTHER):
        assert f"`{manifest.fingerprint}`" in content
    first = card.changelog("", manifests(carded, DEFAULT), None)
    assert re.findall(r"^## (.*)$", first, re.MULTILINE) == ["Unreleased"]
    released = card.changelog(first, manifests(carded, DEFAULT), "1.0.0")
    assert released == first.replace("Unreleased", "1.0.0")
    assert card.changelog(released, manifests(carded, DEFAULT), None) == released
    assert card.changelog(released, manifests(carded, DEFAULT), "1.0.0") == released
    longer = card.changelog(released, manifests(carded, DEFAULT, OTHER), None)
    assert re.findall(r"^## (.*)$", longer, re.MULTILINE) == ["Unreleased", "1.0.0"]
    assert longer.endswith(released[released.index("## 1.0.0") :])
    second = card.changelog(longer, manifests(carded, DEFAULT, OTHER), "1.1.0")
    assert re.findall(r"^## (.*)$", second, re.MULTILINE) == ["1.1.0", "1.0.0"]
