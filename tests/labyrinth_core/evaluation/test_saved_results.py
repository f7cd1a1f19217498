"""Results of anybody: those that add up are believed, and whatever was changed in one is found."""

from __future__ import annotations

import json
import re
from time import process_time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labyrinths_of_datasets import CONFIGS
from policies import Rounds
from submitted import add_up, content_of, forgetful, keep, of_few, of_run, results_of

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.evaluation.description import Description
from labyrinth_core.evaluation.known import KnownDataset
from labyrinth_core.evaluation.results import LARGEST, Results, results_in
from labyrinth_core.evaluation.scores import ACCURACIES, EVALUATED_SPLITS


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


def refused(read, content, known, why):
    """Check that content is refused in one line that says why."""
    with pytest.raises((DatasetError, ValueError)) as error:
        read(content, known)
    assert re.fullmatch(rf"(\S*mine\.json is refused: )?{why}", str(error.value)), str(error.value)


# What is believed.

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
        results = results_of(datasets, config, policy, **options)
        if policy is not policies["rounds"][0]:
            results = of_run(results, memory=True)
        path = tmp_path / "a" / "mine.json"
        about = ABOUT if results.run is None else ABOUT | {"name": results.run.name}
        results.save(path, **about)
        assert json.loads(path.read_text(encoding="utf-8"))["method"] == about
        dataset = KnownDataset.read(str(datasets), config)
        found = Results.load(path, {config: dataset}.get)
        found.require_dataset(dataset)
        assert list(found.splits) == list(EVALUATED_SPLITS)
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


def test_a_run_is_saved_under_its_own_name(results, tmp_path):
    with pytest.raises(ValueError, match="is 'mine', but 'bc-cnn-seed0' by it"):
        of_run(results).save(tmp_path / "mine.json", name="mine")
    assert not any(tmp_path.iterdir())


def test_what_an_earlier_version_left_of_a_run_is_refused_with_the_command_that_makes_it_anew(
    results, tmp_path
):
    path = keep(of_run(results), tmp_path)
    older = path.with_name("evaluation.json")
    older.write_text(json.dumps({"format": 1, "run": {}, "training": {}, "splits": {}}))
    assert results_in(tmp_path) == [path]
    path.unlink()
    assert results_in(tmp_path) == [older]
    with pytest.raises(DatasetError, match=r"evaluation\.json is refused: an earlier version"):
        Results.load(older)


def test_some_splits_are_enough(content, known, read):
    content["splits"] = {"test": content["splits"]["test"]}
    for by_split in content["baselines"].values():
        del by_split["train"]
    assert list(read(content, known).splits) == ["test"]


# What is not.


@pytest.mark.parametrize(
    ("about", "message"),
    [
        ({"name": " "}, "name=' ': say what the policy is called"),
        ({"details": {"steps": 1.5}}, "details: steps=1.5: give a whole number"),
        ({"date": "2026-02-31"}, "date=2026-02-31: give a day"),
    ],
)
def test_results_of_which_something_impossible_is_said_are_not_saved(
    results, tmp_path, about, message
):
    with pytest.raises(ValueError, match=rf"\A{message}"):
        results.save(tmp_path / "a" / "mine.json", **ABOUT | about)
    assert not any(tmp_path.iterdir())


def leaves(value, path=()):
    """Return the places of all numbers and texts, of texts letter by letter."""
    if isinstance(value, dict):
        return [leaf for key, each in value.items() for leaf in leaves(each, (*path, key))]
    if isinstance(value, list):
        return [leaf for key, each in enumerate(value) for leaf in leaves(each, (*path, key))]
    if isinstance(value, str):
        return [(*path, place) for place in range(len(value))]
    return [path]


def change(content, path):
    """Change a number or a letter a little."""
    *way, last = path
    inner = content
    for key in way[:-1]:
        inner = inner[key]
    value = inner[way[-1]]
    if isinstance(value, str):
        letter = value[last]
        letters = "slw" if letter in "slw" and "outcomes" in path else "0123456789abcdef"
        other = letters[(letters.index(letter) + 1) % len(letters)]
        inner[way[-1]] = value[:last] + other + value[last + 1 :]
    elif value[last] is None:
        value[last] = 0.5
    else:
        value[last] += 1 if type(value[last]) is int else 1e-6 if value[last] < 0.5 else -1e-6


@pytest.mark.slow
@given(data=st.data())
def test_one_change_to_whatever_is_told_of_a_split_is_found(results, known, read, data):
    content = content_of(results)
    split = data.draw(st.sampled_from(sorted(content["splits"])))
    told = content["splits"][split]
    part = data.draw(st.sampled_from([name for name in told if "accuracy" not in name]))
    places = leaves(told[part], ("splits", split, part))
    if not places:
        return
    change(content, data.draw(st.sampled_from(places)))
    refused(read, content, known, rf".*\b{split}\b.*")


FIRST = r"labyrinth [0-9a-f]{16} has"


def solved(told):
    return told["outcomes"][0].index("s")


def failed(told):
    return re.search("[lw]", told["outcomes"][0]).start()


def too_short(told):
    told["moves"][0][solved(told)] = 1


def too_long(told):
    told["moves"][0][solved(told)] = 361


def beyond_the_states(told):
    told["moves"][0][solved(told)] = 9


def given_up(told):
    told["moves"][0][failed(told)] = 17


def on_ice(told):
    letters = told["outcomes"][0]
    told["outcomes"][0] = "i" + letters[1:]


def far_away(told):
    told["distance"][0] = 9


def one_less(told):
    for name in ("labyrinth_ids", "distance"):
        told[name].pop()
    told["outcomes"][0] = told["outcomes"][0][:-1]
    told["moves"][0].pop()


def twice(told):
    told["labyrinth_ids"][1] = told["labyrinth_ids"][0]


def in_another_order(told):
    told["labyrinth_ids"][:2] = told["labyrinth_ids"][1::-1]


def by_a_detour(told):
    told["moves"][0][solved(told)] += 1


def elsewhere_known(told):
    told["known_route"] = told["known_route"].translate(str.maketrans("01", "10"))


def easier(told):
    told["distance"] = [2 - moves % 2 for moves in told["distance"]]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("forge", "why", "without_dataset"),
    [
        (too_short, f"{FIRST} a solution of fewer moves than a shortest route: solved .*", True),
        (too_long, f"{FIRST} more moves than the limit of 360: solved after 361 moves, .*", True),
        (beyond_the_states, f"{FIRST} more than 8 moves to an end by look-ups: .*", True),
        (given_up, f"{FIRST} a failure before the limit of 360 moves: .* after 17 moves,.*", True),
        (on_ice, f"{FIRST} an end on ice, which this task has not: ice after .*", True),
        (twice, r"labyrinth [0-9a-f]{16} is there twice", True),
        (far_away, f"{FIRST} a shortest route of .*", True),
        (by_a_detour, f"{FIRST} a detour of an odd number of moves: solved after .*", True),
        (elsewhere_known, "known_route does not say which routes train of .*/3x3 demo.*", False),
        (one_less, "7 labyrinths, but .*/3x3 has 8", False),
        (in_another_order, "labyrinth 1 is [0-9a-f]{16}, but [0-9a-f]{16} in .*/3x3", False),
        (easier, f"{FIRST} a shortest route of [12] moves, but of [2-8] in .*/3x3", False),
    ],
)
def test_a_forgery_that_adds_up_is_refused_for_what_cannot_be(
    content, known, read, forge, why, without_dataset
):
    told = content["splits"]["test"]
    forge(told)
    add_up(told, 9)
    refused(read, content, known, f"test: {why}")
    if without_dataset:
        refused(read, content, None, f"test: {why}")
    else:
        read(content)


def forge(told, number, outcome, moves, cells):
    """Change the episode in one labyrinth, and what follows from it."""
    letters = told["outcomes"][0]
    told["outcomes"][0] = letters[:number] + outcome + letters[number + 1 :]
    told["moves"][0][number] = moves
    accuracies = {name: told[name] for name in ACCURACIES}
    add_up(told, cells)
    told |= accuracies


def test_an_end_on_ice_is_as_far_away_as_there_is_ice(datasets, read):
    known = KnownDataset.read(str(datasets), "3x4-icy_floor")
    content = content_of(results_of(datasets, "3x4-icy_floor", forgetful(3, 4)))
    told, right = content["splits"]["test"], known.split("test")
    even, odd = right.to_ice[0].tolist()
    assert (even, odd) == (481, 3)  # More than the limit: no ice is an even number of moves away.
    for moves, why in ((1, "which is farther away"), (4, "where so many moves lead to none")):
        forge(told, 0, "i", moves, 12)
        refused(read, content, known, f"test: {FIRST} ice, {why}: ice after .*")
    forge(told, 0, "i", 5, 12)
    read(content, known)


def test_by_look_ups_there_is_no_detour_in_a_labyrinth_without_a_loop(content, known, read):
    told, right = content["splits"]["test"], known.split("test")
    single, loop = (int(np.flatnonzero(right.single_route == kind)[0]) for kind in (True, False))
    forge(told, loop, "s", 8, 9)
    read(content, known)
    forge(told, single, "s", int(right.distance[single]) + 2, 9)
    refused(read, content, known, f"test: {FIRST} a detour, where only one route leads on: .*")


@pytest.mark.parametrize("share", [0.123, None])
def test_an_accuracy_is_a_share_of_the_states_of_the_split(content, known, read, share):
    content["splits"]["test"]["accuracy_elsewhere"] = share
    refused(read, content, known, f"test: accuracy_elsewhere is {share}, which is no share of .*")
    read(content)


def test_of_several_episodes_the_message_names_the_one(small_dataset, known, read):
    results = results_of(small_dataset.data_dir, "3x3", Rounds(1), episodes=3)
    content = content_of(results)
    told = content["splits"]["s0"]
    told["moves"][2][0] = 361
    add_up(told, 9)
    refused(read, content, known, "s0: episode 3, labyrinth .* more moves than the limit .*")


@pytest.mark.parametrize(
    ("place", "value", "why"),
    [
        (("kind",), "results", "it.kind is 'results', not 'labyrinth-results'"),
        (("format",), 1, "it.format is 1, not 2"),
        (("format",), True, "it.format is True, not 2"),
        (("method", "name"), " ", "name=' ': say what the policy is called"),
        (("method", "name"), "a\u202eb", "name=.* all of which can be seen"),
        (("method", "author"), "a\nb", "author=.* one line of 300 characters at most, .*"),
        (("method", "budget"), "a" * 301, "budget=.* one line of 300 characters at most, .*"),
        (("method", "url"), "javascript:alert(1)", "url=.*: give an address such as https://.*"),
        (("method", "date"), "2026-02-31", "date=2026-02-31: give a day such as 2026-11-30"),
        (("method", "date"), "yesterday", "date=yesterday: give a day such as 2026-11-30"),
        (("method", "details"), {"size": 1}, "details: 'size': choose from labyrinths, .*"),
        (("method", "details"), {"steps": -1}, "it.method.details.steps is -1, not .*"),
        (("method", "details"), [], r"it.method.details is \[\], not an object"),
        (("method",), None, "it.method is None, not an object with name, .*"),
        (("dataset", "config"), "3x3-lava", "config=3x3-lava: there is none of this name"),
        (("dataset", "config"), "03x3", "config=03x3: there is none of this name"),
        (("dataset", "config"), "../3x3", "it.dataset.config is '../3x3', not .*"),
        (("dataset", "fingerprint"), "1" * 64, "it is of another dataset than .*/3x3: .*"),
        (("dataset", "fingerprint"), "1" * 63, "it.dataset.fingerprint is '1+, not .*"),
        (("evaluated", "episodes"), 2, "episodes=2: a policy has one in each .* by look-ups"),
        (("evaluated", "way"), "guesses", "it.evaluated.way is 'guesses', not .*"),
        (("evaluated", "way"), "steps", "[a-z0-9_]+: accuracy_on_demonstrations is .*, which a .*"),
        (("evaluated", "seed"), 2**64, "it.evaluated.seed is 18446744073709551616, not .*"),
        (("evaluated", "image_size"), 64, "image_size=64: observation=vector has none"),
        (("evaluated", "version"), "=1+1|", r"it.evaluated.version is '=1\+1\|', not .*"),
        (("splits",), {}, "it has no results on train, validation, .*"),
        (("splits", "exam"), {}, "a name in it.splits is 'exam', not .*"),
        (("splits", "test", "sr"), float("nan"), "NaN is no number of JSON"),
        (("splits", "test", "aer"), float("inf"), "Infinity is no number of JSON"),
        (("splits", "test", "aer"), -(10**400), "test: aer is -1000.*"),
        (("splits", "test", "sr"), "1.0", "test: sr is '1.0', but .* follows from the outcomes"),
        (("splits", "test", "sr"), True, "test: sr is True, but .*"),
        (("splits", "test", "sr_interval"), [0.5], r"test: sr_interval is \[0.5\], but .*"),
        (("splits", "test", "accuracy_elsewhere"), 1.5, "it.splits.test.accuracy_elsewhere .*"),
        (("baselines",), [], r"it.baselines is \[\], not an object"),
        (("baselines", "oracle", "test"), {}, "it.baselines.oracle.test is .*, not an object .*"),
        (("baselines", "oracle", "test", "aer"), float("nan"), "NaN is no number of JSON"),
        (("baselines", "stranger"), {}, "a name in it.baselines is 'stranger', not .*"),
        (("baselines", "random", "test", "spl"), -0.1, "it.baselines.random.test.spl is -0.1, .*"),
        (("splits", "test", "moves", 0, 3), 2.5, r"it.splits.test.moves\[0\]\[3\] is 2.5, not .*"),
        (("splits", "test", "moves", 0, 3), 0, r"it.splits.test.moves\[0\]\[3\] is 0, not .*"),
        (("splits", "test", "moves", 0, 3), 10**12, ".*more moves than the limit .*"),
        (
            ("splits", "test", "labyrinths"),
            10**15,
            "test: 1000000000000000 labyrinths, but .* has 8",
        ),
        (("splits", "test", "labyrinth_ids", 0), "f" * 16, r"it.splits.test.labyrinth_ids\[0\] .*"),
        (("splits", "test", "outcomes"), ["s" * 8] * 2, "test: outcomes are of 2 episodes .*"),
        (("splits", "test", "moves"), [], "test: moves are of 0 episodes in each .*, not 1"),
        (("splits", "test", "outcomes", 0), "c" * 8, r"it.splits.test.outcomes\[0\] is 'cccc.*"),
        (("splits", "test", "step_limit"), 10**9, "test: step_limit is 1000000000, not 360"),
        (("splits", "test", "failures"), {"bored": 1}, "test: failures is .*"),
    ],
)
def test_what_is_no_result_is_refused_in_one_line(content, known, read, place, value, why):
    *way, last = place
    inner = content
    for key in way:
        inner = inner[key]
    inner[last] = value
    refused(read, content, known, why)


@pytest.mark.slow
def test_a_large_file_is_refused_before_its_figures_are_computed(content, known, read):
    told = content["splits"]["test"]
    told |= {"outcomes": ["s"] * 500_000, "moves": [[4]] * 500_000}
    before = process_time()
    refused(read, content, known, r"it.splits.test.outcomes is .*, not a list of 1000 at most")
    count = 50_000
    told |= {"outcomes": ["s" * count], "moves": [[4] * count], "distance": [4] * count}
    told |= {"labyrinth_ids": [f"{n:016x}" for n in range(count)], "labyrinths": count}
    refused(read, content, known, "test: 50000 labyrinths, but .*/3x3 has 8")
    assert process_time() - before < 5  # It was two minutes.


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", ".*Expecting value.*"),
        ("[" * 100_000, ".*recursion.*"),
        ("[]", "it is .*, not an object with kind, .*"),
        ('{"kind": 1, "kind": 2}', "'kind' is there twice in one object"),
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
        file.truncate(LARGEST + 1)
    with pytest.raises(DatasetError, match=rf"is refused: it has more than {LARGEST:,} bytes"):
        Results.load(path)


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("method",), r"\input{/etc/passwd}"),
        (("encoder",), "<script>alert(1)</script>"),
        (("protocol",), "a|b"),
        (("config",), "3x3\n# Mine"),
        (("settings",), []),
        (("memory",), 1),
        (("train_labyrinths",), 0),
        (("seed",), [0]),
        (("training", "seconds"), -1),
        (("training", "computed", "device"), {}),
        (("training", "selected"), None),
        (("evaluated", "weights"), "<b>"),
        (("as_tried",), {"test": {"sr": "1"}}),
    ],
)
def test_what_is_no_run_is_refused_in_one_line(results, read, place, value):
    content = content_of(of_run(results))
    *way, last = place
    inner = content["run"]
    for key in way:
        inner = inner[key]
    inner[last] = value
    refused(read, content, None, r"(it|a name in it)\.run\..* is .*, not .*")
