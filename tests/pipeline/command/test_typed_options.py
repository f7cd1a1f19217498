"""What is typed is what an option gets: texts, lists of one, true and false.

A name that does not exist is answered with its likely name.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import get_origin

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hypothesis import example, given
from hypothesis import strategies as st
from support.commands import refused as refused_command
from support.making import RunConfig, composed

from pipeline.command import command_line
from pipeline.command.composed import DEFAULTS, KINDS
from pipeline.command.stages import STAGES
from pipeline.config import ConfigError

TEXTS = [name for name, kind in KINDS.items() if kind in (str, str | None)]
LISTS = [name for name, kind in KINDS.items() if get_origin(kind) is tuple]
BOOLS = [name for name, kind in KINDS.items() if kind is bool]
ASKED = {
    "evaluation.splits": ["stages=evaluate", "policy=my:policy"],
    "export.splits": ["stages=export", "export.format=minari"],
}
"""Option -> the command line of which it is an option."""


def typed(argument: str) -> list[str]:
    """Return the values of a command line's argument as OmegaConf writes down a text."""
    parser = OverridesParser.create()
    override = parser.parse_override(command_line.quote_texts(argument))
    if override.is_sweep_override():
        one_by_one = (f"x={value}" for value in override.sweep_string_iterator())
        return [str(parser.parse_override(each).value()) for each in one_by_one]
    return [str(override.value())]


def plain(values: list[str]) -> list[str]:
    return [value.strip("'\"") for value in values]


@given(
    st.text("0123456789.eE_+-", min_size=1, max_size=6)
    | st.sampled_from(["true", "False", "inf", "-inf", "NaN", "1e999", "nulls", "on"]),
    st.sampled_from(TEXTS),
    st.sampled_from(["", "+", "++"]),
)
@example("1.10", "revision", "")
@example("83e2010", "revision", "")
@example("2026_11", "data_dir", "")
def test_a_text_is_what_was_typed(text: str, name: str, start: str) -> None:
    assert plain(typed(f"{start}{name}={text}")) == [text]
    assert plain(typed(f"{start}{name}={text},a,{text}")) == [text, "a", text]
    assert plain(typed(f"{name}=choice({text}, 1.0)")) == [text, "1.0"]
    assert plain(typed(f'{name}="{text}"')) == [text]


def test_texts_are_what_was_typed_in_groups_lists_and_sweeps() -> None:
    options = composed(
        *("revision=1.10", "++data_dir=2026_11", "evaluation.name=true", "size=3"),
        *("evaluation={author:1.10,gifs:60}", "evaluation.splits=[1.50,test]"),
        "dataset=${revision}",
    ).options
    assert (options.revision, options.data_dir) == ("1.10", "2026_11")
    of_evaluation = options.evaluation
    assert (of_evaluation.name, options.size, of_evaluation.author) == ("true", "3", "1.10")
    assert (of_evaluation.gifs, of_evaluation.splits) == (60, ("1.50", "test"))
    assert options.dataset == "1.10"
    assert composed("revision=null").options.revision is None


@pytest.mark.parametrize(
    "argument",
    [
        *("seed=1e3", "method.learning_rate=1e-3", "size=range(3,6)", "hydra.job=1.10"),
        *("--config-dir=1.10", "revision=null", "revision=${oc.env:A,b}", "size=5", "shifts=[g]"),
        *("data_dir=runs/1.10", "evaluation.budget=1.10 routes", "evaluation.name='1.10, 2.0'"),
    ],
)
def test_what_hydra_reads_as_it_is_typed_stays_as_it_is(argument: str) -> None:
    assert command_line.quote_texts(argument) == argument


@pytest.mark.parametrize(
    "name", [name for name in LISTS if name != "export.splits" or "export" in STAGES]
)
def test_a_wrong_value_of_a_list_without_brackets_is_told_what_to_give(name: str) -> None:
    with pytest.raises(ConfigError, match=rf"^{name}=\[?nonsense\]?: (choose from|give) "):
        composed(f"{name}=nonsense", *ASKED.get(name, []))


def test_one_value_of_a_list_is_the_list_of_it() -> None:
    run = composed("shifts=one_wall", "stages=build", "evaluation.splits=s0")
    assert (run.dataset.shifts, run.options.stages) == (("one_wall",), ("build",))
    assert run.options.evaluation.splits == ("s0",)


@pytest.mark.parametrize("name", BOOLS)
@pytest.mark.parametrize("value", ["-1", "1", "yes", "null", "[true]"])
def test_true_and_false_are_no_numbers(name: str, value: str) -> None:
    with pytest.raises(ConfigError, match=rf"^{name}=.*: give true or false$"):
        composed(f"{name}={value}")


def test_true_and_false_may_be_capital_or_come_from_the_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("LABYRINTH_OVERWRITE", "true")
    assert composed("overwrite=${oc.env:LABYRINTH_OVERWRITE}").options.overwrite is True
    assert composed("overwrite=False").options.overwrite is False


def refused(argument: str) -> str:
    """Return the line that a command line with this argument ends in."""
    with pytest.raises((HydraException, ConfigError)) as caught:
        composed(argument)
    return command_line.refusal(caught.value)


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("sise", "did you mean size?"),
        ("episodes", "did you mean evaluation.episodes?"),
        ("epochs", "did you mean method.epochs?"),
        ("evaluation.name.x", "did you mean evaluation.name?"),
        ("method.epoch", "did you mean method.epochs?"),
        ("method.learning_rat", "did you mean method.learning_rate?"),
        ("hydra.sweeep", "--help lists the options"),
        ("buckets.xyz", "did you mean buckets?"),
        ("zzz", "--help lists the options"),
    ],
)
def test_an_option_that_does_not_exist_is_answered_with_its_likely_name_alone(
    name: str, advice: str
) -> None:
    assert refused(f"{name}=1") == f"{name} is not an option: {advice}"


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("buckets: {train: 34, validation: 33, test: 33}", "buckets.train is no longer an option"),
        ("executor_address: null", "executor_address is no longer an option: give the address"),
        ("leakage: {source: null}", "leakage is no longer an option: give stages=certify"),
        ("stages: {a: 1}", "stages={'a': 1}: give a list of texts"),
        ("splits: [3]", "splits=[3]: give its own options, as splits.NAME=..."),
        ("evaluation: {splits: {a: 1}}", "evaluation.splits={'a': 1}: give a list of texts"),
        ("method: bc", "method: a file chooses it in its defaults, as `- method: bc`"),
    ],
)
def test_a_file_of_options_whose_values_do_not_fit_is_answered_with_the_option(
    tmp_path: Path, line: str, answer: str
) -> None:
    (tmp_path / "mine.yaml").write_text(f"defaults: [base, _self_]\n{line}\n")
    error = refused_command("--config-dir", str(tmp_path), "--config-name", "mine")
    assert error.startswith(f"error: {answer}")


def test_a_file_that_holds_no_options_is_not_taken_for_a_fault_of_the_output(
    tmp_path: Path,
) -> None:
    (tmp_path / "mine.yaml").write_text("3\n")
    error = refused_command("--config-dir", str(tmp_path), "--config-name", "mine")
    assert error.startswith("error: invalid options: ")


@pytest.mark.parametrize(
    "argument", ["buckets.train=50", "+executor_address=tcp://a:1", "leakage.source=x"]
)
def test_an_option_of_an_earlier_version_is_answered_with_what_to_type_now(argument: str) -> None:
    name = argument.lstrip("+").partition("=")[0]
    assert refused(argument).startswith(f"{name} is no longer an option: give ")


@pytest.mark.parametrize(
    "argument", ["method=[]", "method=[bc,dagger]", "evaluation=x", "splits=[3]"]
)
def test_a_group_and_a_method_are_no_list(argument: str) -> None:
    with pytest.raises(ConfigError, match=r": give (one name, such as|its own options, as) "):
        composed(argument)


@pytest.mark.parametrize(
    "arguments",
    [
        "size=3 --cfg hydra labyrinths=4",
        "--config-dir own size=3 --config-name mine labyrinths=4",
        "-cd own size=3 -cn mine labyrinths=4",
        "size=3 --multi labyrinths=4",
        "size=3 --info defaults labyrinths=4",
        "size=3 labyrinths=4",
    ],
)
def test_flags_may_stand_among_the_options(arguments: str) -> None:
    words = arguments.split()
    found = command_line.arranged(words, command_line.parsed(words))
    assert found[:2] == ["size=3", "labyrinths=4"]
    assert sorted(found) == sorted(words)


def test_the_class_of_a_method_in_the_old_form_is_told_in_the_new_one() -> None:
    with pytest.raises(ConfigError) as caught:
        composed("method=mine:Method")
    *_, typed = str(caught.value).partition(": for a method of your own give ")
    assert composed(*typed.split()).options.method_name == "mine:Method"


@pytest.mark.parametrize(
    ("target", "name", "title"),
    [
        ("labyrinth_core.learning.methods.bc.Method", "bc", "bc"),
        (
            "pipeline.training.methods.bc.Method",
            "bc",
            "bc",
        ),  # In the `config.yaml` of earlier runs.
        ("mine.Method", "mine:Method", "mine"),
        ("bc.Method", "bc:Method", "bc"),
        ("lab.mine.Smoothed", "lab.mine:Smoothed", "Smoothed"),
        ("lab.mine.Outer.Method", "lab.mine:Outer.Method", "mine"),
    ],
)
def test_a_method_has_the_name_that_records_know(target: str, name: str, title: str) -> None:
    options = composed("method=custom", f"method._target_={target}").options
    assert (options.method_name, options.method_title) == (name, title)


@pytest.mark.parametrize("given", ["method=custom", "method._target_=x", "~method"])
def test_a_method_without_a_class_is_told_what_to_give(given: str) -> None:
    with pytest.raises(ConfigError, match=r"^method\._target_=.*: give the class of a method as"):
        composed(given)


def test_settings_are_compared_with_those_of_a_run_only_if_they_are_chosen() -> None:
    assert composed("method=planner").options.method == {"name": "planner"}
    assert composed("method=planner", "method.epochs=30").options.method["epochs"] == 30


def test_the_defaults_that_are_documented_are_those_of_the_options() -> None:
    given = [f"{name}={value}" for name, value in DEFAULTS.items() if value]
    given = [each for each in given if not each.endswith("=all") and "stages" not in each]
    assert composed(*given).options == composed().options
    assert DEFAULTS["stages"].split(",") == [*RunConfig().stages]
    assert DEFAULTS["labyrinths"] == DEFAULTS["shifts"] == ""


@pytest.mark.parametrize(
    ("value", "characters"),
    [
        ("Datensätze", "ä"),
        ("a(b,c)", "( , )"),
        ("größe&maß", "ö ß &"),
        ("日本", "日 本"),
        ("[1", "["),
    ],
)
def test_the_characters_that_need_quotation_marks_are_named(value: str, characters: str) -> None:
    expected = f"data_dir={value}: for {characters} Hydra needs quotation marks inside those of "
    line = refused(f"data_dir={value}")
    assert line == f"""{expected}the shell: 'data_dir="{value}"'"""
    (typed,) = shlex.split(line.partition("shell: ")[2])
    assert composed(typed).options.data_dir == value
