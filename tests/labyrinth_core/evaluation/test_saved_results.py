"""Results of anybody: those that add up are believed, and whatever was changed in one is found."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import reduce
from operator import getitem
from time import process_time

import numpy as np
import pytest
from support.labyrinths_of_datasets import CONFIGS
from support.policies import Rounds
from support.submitted import add_up, content_of, forgetful, of_few, of_run, results_of

from labyrinth_core import memorised
from labyrinth_core.data import SPLITS
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import Description, KnownDataset, Results


@pytest.fixture(scope="module")
def results(small_dataset):
    return results_of(small_dataset.data_dir, "3x3", forgetful(3, 3))


@pytest.fixture
def content(results):
    return content_of(results)


@pytest.fixture(scope="module")
def known(small_dataset):
    return KnownDataset.read(str(small_dataset.data_dir), "3x3")


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    """A function that reads content from a file, and compares it with a dataset if one is given."""
    path = tmp_path_factory.mktemp("results") / "mine.json"

    def read_content(content, known=None):
        path.write_text(json.dumps(content), encoding="utf-8")
        results = Results.load(path, lambda _: known)
        if known is not None:
            results.require_dataset(known)
        return results

    return read_content


def test_in_a_notebook_results_show_their_table_and_send_no_control_characters(read, content):
    content["dataset"]["source"] = "evil\x1b[2J\nforged  100.0"
    found = read(content)
    assert repr(found) == str(found) == "\n".join([found.tables(), "", *found.legend()])
    assert found.tables().splitlines()[0] == r"3x3 of evil\x1b[2J\nforged  100.0"
    content["method"]["details"] = {"a\x1b\nb": "many"}
    with pytest.raises(DatasetError) as error:
        read(content)
    told = r"it.method.details.a\x1b\nb is 'many', not a whole number from 0"
    assert told in str(error.value)
    assert str(error.value.__cause__).isprintable()


def refused(read, content, known, why):
    """Check that content is refused in one line that says why."""
    with pytest.raises((DatasetError, ValueError)) as error:
        read(content, known)
    assert re.fullmatch(rf"(\S*mine\.json is refused: )?{why}", str(error.value)), str(error.value)


# What is believed.


@pytest.fixture(scope="module")
def receipt(small_dataset):
    policy = forgetful(3, 3)
    return memorised(policy, small_dataset.data_dir, "3x3", observation="vector", controls=10)


def test_a_receipt_is_saved_and_read_as_it_was(results, receipt, known, read):
    with_receipt = replace(results, memorised=receipt)
    content = json.loads(with_receipt.to_text(Description("mine")))
    assert "memorised" not in content_of(results)
    assert read(content, known).memorised == receipt
    assert len(receipt.copies) > 1


@pytest.mark.parametrize(
    ("place", "value", "why"),
    [
        ("p", 0.04, "it.memorised: p=0.04 is no rank among 10"),
        ("p", 0.0, "it.memorised: p=0.0 is no rank among 10"),
        ("split", "train", "it.memorised.split is 'train', not .*"),
        ("split", "validation", "it.memorised.split is validation, which has no results"),
        ("drawn", 1, "it.memorised.drawn is 1, not .*"),
        ("copies.0.labyrinth", "<b>", r"it.memorised.copies\[0\].labyrinth is '<b>', not .*"),
        ("copies.0.did", [1], r"it.memorised.copies\[0\].did is \[1\], not a list of 4"),
        ("copies.0.agent", 9, r"it.memorised: a copy is in cell 9 of 9"),
        ("copies.0.passages", [[0, 99]], r"it.memorised: a copy is in cell 99 of 9"),
        ("everywhere", 1, "it.memorised.everywhere is 1, not true or false"),
        ("own_way", None, "it.memorised.own_way is None, not .*"),
    ],
)
def test_a_receipt_that_cannot_be_is_refused_in_one_line(results, receipt, read, place, value, why):
    content = json.loads(replace(results, memorised=receipt).to_text(Description("mine")))
    *way, last = (int(key) if key.isdigit() else key for key in place.split("."))
    if value == "validation":
        del content["splits"]["validation"]
        for figures in content["baselines"].values():
            del figures["validation"]
    reduce(getitem, way, content["memorised"])[last] = value
    refused(read, content, None, why)


ABOUT = {
    "name": "mine",
    "author": "me",
    "url": "https://example.org/mine",
    "budget": "nothing",
    "date": "2026-11-30",
    "details": {"steps": 0, "parameters": 7},
}


@pytest.mark.slow
@pytest.mark.parametrize("config", CONFIGS.values())
def test_what_is_saved_is_read_as_it_was(datasets, tmp_path, config):
    policies = {"planner": (forgetful(3, 4), {}), "rounds": (Rounds(2), {"episodes": 2})}
    for policy, options in policies.values():
        results = results_of(datasets, f"{config}/", policy, **options)
        if policy is not policies["rounds"][0]:
            results = of_run(results)
        path = tmp_path / "a" / "mine.json"
        about = ABOUT if results.run is None else ABOUT | {"name": results.run.name}
        numbers = {name: np.int64(number) for name, number in about["details"].items()}
        results.save(path, **about | {"details": numbers})
        assert json.loads(path.read_text(encoding="utf-8"))["method"] == about
        dataset = KnownDataset.read(str(datasets), config)
        found = Results.load(path, {config: dataset}.get)
        found.require_dataset(dataset)
        assert list(found.splits) == list(SPLITS.evaluated)
        assert found.method == Description(**about)
        assert found.run == results.run
        assert str(found) == str(results)
        assert found.to_json(found.method) == results.to_json(found.method)


@pytest.mark.slow
def test_a_run_that_learnt_from_some_labyrinths_is_judged_on_the_first_ones(results, known, read):
    some = content_of(of_few(of_run(results), 3))
    assert len(read(some, known).splits["s0"].distance) == 3
    some["run"]["train_labyrinths"] = 4
    some["method"]["name"] = "bc-cnn-seed0-labyrinths4"
    refused(read, some, known, "train: 3 labyrinths, but .*/3x3 has 4")


@pytest.mark.slow
def test_a_labyrinth_that_a_split_holds_twice_is_one_in_the_results(build, tmp_path, read):
    build(tmp_path, labyrinths=32, shifts=["one_wall"])
    known = KnownDataset.read(str(tmp_path), "3x3")
    held = sum(shard.labyrinths for shard in known.data.manifest.of("one_wall"))
    content = content_of(results_of(tmp_path, "3x3", forgetful(3, 3), splits=["one_wall"]))
    assert len(read(content, known).splits["one_wall"].distance) == held - 1


def test_some_splits_are_enough(content, known, read):
    content["splits"] = {"test": content["splits"]["test"]}
    for by_split in content["baselines"].values():
        del by_split["train"]
    assert list(read(content, known).splits) == ["test"]


# What is not.


@pytest.mark.parametrize(
    ("make", "about", "message"),
    [
        (replace, {"details": {"steps": 1.5}}, "details: steps=1.5: give a whole number"),
        (of_run, {}, "it is of 'mine', seed 0, but its run is bc-cnn-seed0"),
    ],
)
def test_what_could_not_be_read_again_is_not_saved(results, tmp_path, make, about, message):
    with pytest.raises(ValueError, match=rf"\A{message}"):
        make(results).save(tmp_path / "a" / "mine.json", **ABOUT | about)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    "name", ["random", " Oracle", "FIXED path", "fixed_path", "route memory ", "replanner"]
)
def test_no_policy_is_called_as_a_baseline_is(results, content, read, tmp_path, name):
    told = f"name={name}: a baseline has this name; choose another"
    with pytest.raises(ValueError, match=rf"\A{told}\Z"):
        results.save(tmp_path / "mine.json", name=name)
    content["method"]["name"] = name
    refused(read, content, None, told)


def nudged(value):
    """Return another value of the same kind, which no rounding explains."""
    if isinstance(value, list):
        return [nudged(value[0]), *value[1:]]
    if isinstance(value, dict):
        return {**value, "loop": 99}
    return value + 1e-6 if isinstance(value, float) else 0.5


DERIVED = ["sr", "sr_within_cells", "spl", "aer", "aer_std", "sr_known_route", "sr_new_route"]


@pytest.mark.parametrize("figure", [*DERIVED, "path_efficiency", "failures"])
def test_a_figure_that_does_not_follow_from_the_outcomes_is_refused(content, read, figure):
    told = content["splits"]["s0"]
    told[figure] = nudged(told[figure])
    refused(read, content, None, rf"s0: {figure} is .*, but .* follows from the outcomes")


FIRST = r"moves\[\d\]\[\d\] is \d+: labyrinth [0-9a-f]{16} has"


def forge(told, number, outcome, moves):
    """Change the episode in one labyrinth, and what follows from it."""
    letters = told["outcomes"][0]
    told["outcomes"][0] = letters[:number] + outcome + letters[number + 1 :]
    told["moves"][0][number] = moves
    add_up(told, 9)


@pytest.mark.parametrize(
    ("before", "outcome", "moves", "why"),
    [
        ("s", "s", 1, "a solution of fewer moves than a shortest route"),
        ("s", "s", 361, "more moves than the limit of 360"),
        ("[lw]", "w", 17, "a failure before the limit"),
    ],
)
def test_an_episode_that_cannot_be_is_refused_though_its_figures_add_up(
    content, known, read, before, outcome, moves, why
):
    told = content["splits"]["test"]
    forge(told, re.search(before, told["outcomes"][0]).start(), outcome, moves)
    for dataset in (known, None):
        refused(read, content, dataset, f"test: {FIRST} {why}")


OTHER = r"labyrinth_ids\[0\] is [0-9a-f]{16}, but [0-9a-f]{16} in .*/3x3"


@pytest.mark.parametrize(
    ("part", "change", "why", "possible"),
    [
        (
            "labyrinth_ids",
            lambda ids: ids[1:] + ids[1:2],
            ".* has a labyrinth twice",
            False,
        ),
        ("labyrinth_ids", lambda ids: ids[1::-1] + ids[2:], OTHER, True),
        ("distance", lambda far: [2, *far[1:]], r"distance\[0\] is 2, but \d in .*/3x3", True),
        (
            "known_route",
            lambda marks: str(1 - int(marks[0])) + marks[1:],
            r"known_route\[0\] is \d, but \d in .*/3x3",
            True,
        ),
    ],
)
def test_other_labyrinths_than_those_of_the_dataset_are_refused(
    content, known, read, part, change, why, possible
):
    told = content["splits"]["test"]
    told[part] = change(told[part])
    add_up(told, 9)
    refused(read, content, known, f"test: {why}")
    if possible:
        read(content)
    else:
        refused(read, content, None, f"test: {why}")


def test_of_several_episodes_the_message_names_the_one(small_dataset, known, read):
    results = results_of(small_dataset.data_dir, "3x3", Rounds(1), episodes=3)
    content = content_of(results)
    told = content["splits"]["s0"]
    told["moves"][2][0] = 361
    add_up(told, 9)
    refused(
        read,
        content,
        known,
        r"s0: moves\[2\]\[0\] is 361: .* more moves .*",
    )


NO_RUN = r"it\.run\..* is .*, not .*"


@pytest.mark.parametrize(
    ("place", "value", "why"),
    [
        ("kind", "results", "it.kind is 'results', not 'labyrinth-results'"),
        ("format", 1, "it.format is 1, not 2"),
        ("method.name", " ", "name=' ': say what the policy is called"),
        ("method.name", "a\u202eb", "name=.* printable characters"),
        ("method.author", "a\nb", "author=.* one line of at most 300 printable .*"),
        ("method.budget", "a" * 301, "budget=.* one line of at most 300 printable .*"),
        ("method.url", "javascript:alert(1)", "url=.*: give an address such as https://.*"),
        ("method.date", "2026-02-31", "date=2026-02-31: give a day such as 2026-11-30"),
        ("method.date", "yesterday", "date=yesterday: give a day such as 2026-11-30"),
        ("method.details", {"size": 1}, "details: 'size': choose from labyrinths, .*"),
        ("method.details", {"steps": -1}, "it.method.details.steps is -1, not .*"),
        ("method.details", [], r"it.method.details is \[\], not an object"),
        ("method", None, "it.method is None, not an object with name, .*"),
        ("methods", {}, "it has methods, which is unknown"),
        ("run.seeds", 1, "it.run has seeds, which is unknown"),
        ("splits.test.distances", [], "it.splits.test has distances, which is unknown"),
        ("dataset.config", "3x3-lava", "it.dataset.config is '3x3-lava', not .*"),
        ("dataset.config", "1x3", "size=1x3: give a whole number from 2 to .*"),
        ("dataset.config", "../3x3", "it.dataset.config is '../3x3', not .*"),
        ("dataset.fingerprint", "1" * 64, "it is of another dataset than .*/3x3: .*"),
        ("dataset.fingerprint", "1" * 63, "it.dataset.fingerprint is '1+, not .*"),
        ("evaluated.episodes", 2, "episodes=2: look-ups give one .*"),
        ("evaluated.way", "guesses", "it.evaluated.way is 'guesses', not .*"),
        ("evaluated.seed", 2**64, "it.evaluated.seed is 18446744073709551616, not .*"),
        ("evaluated.image_size", 0, "it.evaluated.image_size is 0, not .*"),
        ("evaluated.version", "=1+1|", r"it.evaluated.version is '=1\+1\|', not .*"),
        ("splits", {}, "it has no results on train, validation, .*"),
        ("splits.exam", {}, "it.splits has a name that is 'exam', not .*"),
        ("splits.test.sr", float("nan"), "NaN is not a JSON number"),
        ("splits.test.aer", float("inf"), "Infinity is not a JSON number"),
        ("splits.test.aer", -(10**400), "it.splits.test.aer is -1000.*"),
        ("splits.test.sr", True, "it.splits.test.sr is True, not .*"),
        ("splits.test.sr_interval", [0.5], r"it.splits.test.sr_interval is .*, not a list of 2"),
        (
            "splits.test.sr_interval",
            [2, 3],
            "test: sr_interval is .*, which is not around sr=.*",
        ),
        (
            "splits.test.aer_interval",
            [1, -4],
            "test: aer_interval is .*, which is not around .*",
        ),
        ("splits.test.known_route", None, "it.splits.test.known_route is None, not .*"),
        ("splits.test.accuracy_elsewhere", 1.5, "it.splits.test.accuracy_elsewhere .*"),
        ("baselines", [], r"it.baselines is \[\], not an object"),
        ("baselines.oracle.test", {}, "it.baselines.oracle.test has no sr"),
        ("baselines.oracle", {}, "it.baselines.oracle has no s0"),
        ("baselines.stranger", {}, "it.baselines has a name that is 'stranger', not .*"),
        (
            "baselines.random.test.train",
            0.1,
            "it.baselines.random.test has train, which is unknown",
        ),
        ("baselines.random.test.spl", -0.1, "it.baselines.random.test.spl is -0.1, .*"),
        ("splits.test.moves.0.3", 2.5, r"it.splits.test.moves\[0\]\[3\] is 2.5, not .*"),
        ("splits.test.moves.0.3", 0, r"it.splits.test.moves\[0\]\[3\] is 0, not .*"),
        ("splits.test.moves.0.3", 10**12, ".*more moves than the limit .*"),
        ("splits.test.labyrinths", 10**15, "test: labyrinth_ids has 8 entries, not 10*"),
        ("splits.test.labyrinth_ids.0", "f" * 16, r"it.splits.test.labyrinth_ids\[0\] .*"),
        ("splits.test.outcomes", ["s" * 8] * 2, "test: outcomes has 2 rows, not 1 as episodes"),
        ("splits.test.moves", [], "test: moves has 0 rows, not 1 as episodes"),
        ("splits.test.outcomes.0", "c" * 8, r"it.splits.test.outcomes\[0\] is 'cccc.*"),
        ("splits.test.step_limit", 10**9, "test: step_limit is 1000000000, but 360 .*"),
        ("run.method", r"\input{/etc/passwd}", NO_RUN),
        ("run.encoder", "<script>alert(1)</script>", NO_RUN),
        ("run.protocol", "a|b", NO_RUN),
        ("run.config", "3x3\n# Mine", NO_RUN),
        ("run.settings", [], NO_RUN),
        ("run.train_labyrinths", 0, NO_RUN),
        ("run.seed", [0], NO_RUN),
        ("run.training.seconds", -1, NO_RUN),
        ("run.training.computed.device", {}, NO_RUN),
        ("run.training.selected", None, NO_RUN),
        ("run.evaluated.weights", "<b>", NO_RUN),
        ("run.as_tried", {"test": {"sr": "1"}}, NO_RUN),
    ],
)
def test_what_is_no_result_is_refused_in_one_line(results, known, read, place, value, why):
    content = content_of(of_run(results) if place.startswith("run.") else results)
    *way, last = (int(key) if key.isdigit() else key for key in place.split("."))
    reduce(getitem, way, content)[last] = value
    refused(read, content, known, why)


@pytest.mark.slow
def test_a_large_file_is_refused_in_a_few_seconds(content, known, read):
    told = content["splits"]["test"]
    told |= {"outcomes": ["s"] * 500_000, "moves": [[4]] * 500_000}
    before = process_time()
    refused(read, content, known, "test: outcomes has 500000 rows, not 1 as episodes")
    count = 50_000
    told |= {"outcomes": ["s" * count], "moves": [[4] * count], "distance": [4] * count}
    told |= {"labyrinth_ids": [f"{n:016x}" for n in range(count)], "known_route": "1" * count}
    add_up(told, 9)
    refused(read, content, known, "test: 50000 labyrinths, but .*/3x3 has 8")
    assert process_time() - before < 5  # It was two minutes.


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", ".*Expecting value.*"),
        ("[" * 100_000, ".*recursion.*"),
        ("[]", "it is .*, not an object with kind, .*"),
        ('{"kind": 1, "kind": 2}', "'kind' appears twice in one object"),
        ("\udcff", ".*codec can't decode.*"),
    ],
)
def test_a_file_that_is_no_json_is_refused_in_one_line(tmp_path, text, why):
    path = tmp_path / "mine.json"
    path.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(DatasetError, match=rf"\A\S*mine\.json is refused: {why}\Z"):
        Results.load(path)


def test_what_is_no_file_or_a_huge_one_is_not_read(tmp_path):
    path = tmp_path / "mine.json"
    path.mkdir()
    with pytest.raises(DatasetError, match=r"mine\.json is refused: it is not a file"):
        Results.load(path)
    path.rmdir()
    with path.open("wb") as file:
        file.truncate(Results.LARGEST + 1)
    with pytest.raises(
        DatasetError, match=rf"is refused: it has more than {Results.LARGEST:,} bytes"
    ):
        Results.load(path)


def test_results_in_hidden_folders_are_not_those_of_runs(tmp_path):
    """A run that is trained lies in a hidden folder until it is complete."""
    for name in ("3x3/bc-seed0", "3x3/.bc-seed1.training", ".old/bc-seed0"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "results.json").touch()
    assert Results.files_of_runs(tmp_path) == [tmp_path / "3x3" / "bc-seed0" / "results.json"]
