"""The checks of the configuration, and that schema, options and YAML say the same."""

from __future__ import annotations

import re
import shlex
from dataclasses import FrozenInstanceError, fields, is_dataclass
from math import prod
from pathlib import Path
from typing import Any

import pytest
import yaml
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.utils import get_class
from hypothesis import given
from hypothesis import strategies as st
from omegaconf import OmegaConf
from support.making import DemonstrationsConfig, RunConfig, SplitsConfig, composed, resolve

from labyrinth_core.data import SPLITS, DatasetConfig
from labyrinth_core.world import ALGORITHMS, Task
from pipeline.command.composed import OPTIONS
from pipeline.command.stages import STAGES
from pipeline.config import ConfigError, TrainingOptions, as_typed
from pipeline.training.identity import find
from scripts.write_options import written

CONF = Path(__file__).parents[3] / "conf"

MOVED = ("test_s0", "test_g", "test_s0_and_g")
"""The shifts to a new start or goal, which the labyrinths of test have with goals=varied."""


def config(**options: Any) -> RunConfig:
    return RunConfig(**{"stages": ["build"], "data_dir": "somewhere"} | options)


def noisy(noise: float, **options: Any) -> dict[str, Any]:
    return {"demonstrations": DemonstrationsConfig(noise=noise)} | options


def dataset(**options: Any) -> DatasetConfig:
    return resolve(config(**options)).dataset


@st.composite
def possible_configs(draw: st.DrawFn) -> RunConfig:
    train = draw(st.integers(1, 98))
    validation = draw(st.integers(1, 99 - train))
    task = draw(st.sampled_from(Task))
    # Ice needs a loop, and a door a cell that is on every route.
    open_walls = st.floats(
        0, 1, exclude_min=task is Task.ICY_FLOOR, exclude_max=task is Task.KEY_AND_DOOR
    )
    return config(
        size=f"{draw(st.integers(2, 299))}x{draw(st.integers(2, 299))}",
        labyrinths=draw(st.none() | st.integers(1, 10**9)),
        solutions=draw(st.sampled_from(["shortest", "all_shortest", "all"])),
        solutions_limit=draw(st.integers(1, 10**9)),
        random_steps=draw(st.integers(1, 10**9)),
        sampler=draw(st.sampled_from(sorted(ALGORITHMS))),
        open_walls=draw(st.none() | open_walls),
        buckets=(train, validation, 100 - train - validation),
        splits=SplitsConfig(draw(st.integers(1, 4))),
        seed=draw(st.integers(0, 2**64 - 1)),
        task=str(task),
        goals=draw(st.sampled_from(["fixed", "varied"])),
    )


@given(possible_configs())
def test_a_dataset_config_survives_the_way_to_json_and_back(possible: RunConfig) -> None:
    resolved = resolve(possible).dataset
    assert DatasetConfig.from_json(resolved.to_json()) == resolved


IMPOSSIBLE: list[tuple[dict[str, Any], list[str]]] = [
    ({"size": "abc"}, ["size=abc", "2 to 1,000", "4x6"]),
    ({"size": "300"}, ["size=300", "299 rows and columns"]),
    ({"size": "2x1000"}, ["size=2x1000", "299 rows and columns"]),
    ({"labyrinths": 0}, ["labyrinths=0", "1 or more"]),
    ({"solutions": "longest"}, ["solutions=longest", "[shortest, all_shortest, all]"]),
    ({"solutions": ""}, ["solutions=: ", "[shortest, all_shortest, all]"]),
    ({"solutions_limit": 0}, ["solutions_limit=0", "from 1 to 10**9"]),
    ({"random_steps": 0}, ["random_steps=0", "from 1 to 10**9"]),
    ({"random_steps": 10**26}, ["random_steps=1000", "from 1 to 10**9"]),
    ({"sampler": "magic"}, ["sampler=magic", "wilson, depth_first"]),
    ({"goals": "random"}, ["goals=random", "[fixed, varied]"]),
    ({"open_walls": -0.01}, ["open_walls=-0.01", "from 0 to 1"]),
    ({"open_walls": 1.01}, ["open_walls=1.01", "from 0 to 1"]),
    ({"open_walls": float("nan")}, ["open_walls=nan", "from 0 to 1"]),
    ({"seed": -1}, ["seed=-1", "0 or more"]),
    ({"seed": 2**64}, ["seed=18446744073709551616", "below 2**64"]),
    ({"workers": 0}, ["workers=0", "from 1 to"]),
    ({"workers": 1_001}, ["workers=1001", "from 1 to"]),
    ({"stages": []}, ["stages=[]", *STAGES]),
    ({"stages": ["build", "sell"]}, ["stages=[build, sell]", *STAGES]),
    ({"splits": SplitsConfig(0)}, ["splits.min_walls=0", "1 to 40"]),
    ({"splits": SplitsConfig(13), "size": "3"}, ["splits.min_walls=13", "1 to 12"]),
    ({"data_dir": ""}, ["data_dir=: ", "give a folder"]),
    ({"data_dir": "  "}, ["data_dir=  : ", "give a folder"]),
    ({"run_dir": " "}, ["run_dir= : ", "give a folder"]),
    ({"task": "chess"}, ["task=chess", "key_and_door"]),
    ({"task": "icy_floor", "open_walls": 0}, ["open_walls=0 task=icy_floor", "more than 0"]),
    ({"task": "key_and_door", "open_walls": 1}, ["open_walls=1 task=key_", "less than 1"]),
    ({"buckets": (50, 33, 33)}, ["buckets=[50,33,33]: give three percentages", "add up to 100"]),
    ({"buckets": (50, 50)}, ["buckets=[50,50]: give three percentages"]),
    ({"buckets": ()}, ["buckets=[]: give three percentages"]),
    ({"buckets": (100, 0, 0)}, ["buckets=[100,0,0]", "1 or more"]),
    ({"buckets": (102, -1, -1)}, ["buckets=[102,-1,-1]", "1 or more"]),
    ({"run_dir": "s3://bucket/runs"}, ["run_dir=s3://bucket/runs", "a folder on this machine"]),
    ({"data_dir": "s3://"}, ["data_dir=s3://", "no bucket"]),
    ({"results_dir": " "}, ["results_dir= : give a folder"]),
    ({"results_dir": "s3://bucket/results"}, ["a folder on this machine"]),
    ({"executor": "slurm"}, ["executor=slurm: give local, dask, or the address of a Dask cluster"]),
    (noisy(1.0), ["demonstrations.noise=1.0: give a probability from 0 to below 1"]),
    (noisy(-0.1), ["demonstrations.noise=-0.1: give a probability from 0 to below 1"]),
    (noisy(0.1, solutions="all"), ["give solutions=shortest, not all"]),
    (noisy(0.1, shifts=("one_wall",)), ["the demonstrated route may not be shortest"]),
    ({"shifts": ("nonsense",)}, ["shifts=[nonsense]: choose from [all, g, "]),
    ({"shifts": ("all", "g")}, ["shifts=[all, g]: give all alone, or some of [g, "]),
    ({"shifts": ("kruskal",), "sampler": "kruskal"}, ["kruskal is not possible: train is"]),
    ({"shifts": ("trees",), "task": "icy_floor"}, ["trees is not possible: without loops ice"]),
    ({"shifts": ("trees",), "open_walls": 0.0}, ["train has no loops already"]),
    ({"shifts": ("open",), "open_walls": 1.0}, ["train has all loops already"]),
    ({"shifts": ("one_wall",), "splits": SplitsConfig(2)}, ["splits.min_walls=2 keeps structures"]),
    ({"shifts": ("thin_walls",), "size": "200"}, ["walls are one pixel thick already"]),
    *(
        (
            {"goals": "varied", "shifts": (shift,)},
            [f"shifts: {shift} is not possible: with goals=varied each labyrinth of test has a"],
        )
        for shift in MOVED
    ),
]

IMPOSSIBLE_TO_TRAIN = [
    ("encoder", "vgg", "[cnn, resnet18, mlp]"),
    ("encoder", "mlp", "observation=vector"),
    ("observation", "sound", "[image, vector, text"),
    ("protocol", "mine", "[default, paper, authors]"),
    ("device", "tpu", "[auto, cpu, cuda]"),
    ("threads", 0, "from 1 to"),
    *(
        ("method", {"name": name}, "choose one of")
        for name in ("", "BC", "os.path", "../bc", "authors/bd", ":Method", "mine:", "a:b:c", None)
    ),
]


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        *IMPOSSIBLE,
        *(
            ({"stages": ["train"], name: value}, [name, allowed])
            for name, value, allowed in IMPOSSIBLE_TO_TRAIN
        ),
    ],
)
def test_what_is_impossible_is_refused_in_one_line(
    options: dict[str, Any], parts: list[str]
) -> None:
    with pytest.raises(ConfigError) as caught:
        resolve(config(**options))
    message = str(caught.value)
    assert all(part in message for part in parts)
    assert "\n" not in message


def test_options_of_training_are_asked_for_where_something_is_trained() -> None:
    for name, value, _ in IMPOSSIBLE_TO_TRAIN:
        resolve(config(**{name: value}))


def test_what_a_run_leaves_by_default_is_in_folders_that_git_ignores() -> None:
    run = composed()
    options = run.options
    left = (run.data_dir, options.run_dir, options.results_dir)
    ignored = (CONF.parent / ".gitignore").read_text(encoding="utf-8").split()
    for folder in left:
        assert f"/{Path(str(folder)).parts[0]}/" in ignored


def test_the_folder_of_a_dataset_is_not_taken_for_one_that_holds_datasets(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").touch()
    with pytest.raises(ConfigError, match=r"is the folder of one dataset: give the folder that"):
        resolve(config(data_dir=str(tmp_path)))


@pytest.mark.parametrize(
    ("options", "left_out"),
    [
        ({"sampler": "prim", "task": "icy_floor"}, {"prim", "trees"}),
        ({"goals": "varied"}, {*MOVED, "wilson"}),
    ],
)
def test_all_shifts_are_those_that_make_sense(options: dict[str, Any], left_out: set[str]) -> None:
    refused = set()
    for shift in SPLITS.shifts:
        try:
            dataset(size="5", shifts=(shift,), **options)
        except ConfigError:
            refused.add(shift)
    every = dataset(size="5", shifts=("all",), **options).shifts
    assert set(SPLITS.shifts) - set(every) == refused >= left_out


@pytest.mark.parametrize("task", list(Task))
def test_a_task_is_part_of_the_name_unless_it_is_navigation(task: Task) -> None:
    expected = "5x5" if task is Task.NAVIGATION else f"5x5-{task}"
    assert dataset(task=str(task)).name == expected


@pytest.mark.parametrize(
    ("size", "labyrinths", "open_walls"),
    [
        ("3", 32, 0.12),
        ("4", 100, 0.09),
        ("5", 100, 0.08),
        ("3x4", 100, 0.08),
    ],
)
def test_sizes_have_their_presets(size: str, labyrinths: int, open_walls: float) -> None:
    resolved = dataset(size=size)
    assert (resolved.labyrinths, resolved.open_walls) == (labyrinths, open_walls)


def test_what_is_given_wins_over_the_presets() -> None:
    resolved = dataset(size="3", labyrinths=7, open_walls=0)
    assert (resolved.labyrinths, resolved.open_walls) == (7, 0)


def test_a_run_knows_its_folder() -> None:
    assert resolve(config(data_dir="a", size="4x6")).folder == Path("a/4x6")
    assert resolve(config(data_dir="~/a")).data_dir == Path.home() / "a"


def test_the_folder_of_a_run_tells_what_was_trained() -> None:
    plain = resolve(config(stages=["train"], seed=3))
    other = resolve(
        config(
            stages=["train"],
            method={"name": "iupe", "epochs": 7},
            encoder="resnet18",
            protocol="paper",
            run_dir="~/runs",
        )
    )
    assert plain.training_folder == Path("runs/5x5/bc-cnn-seed3")
    assert other.training_folder.parent == Path.home() / "runs" / "5x5"
    assert other.run_name.name == "iupe-resnet18-seed0-paper"


@pytest.mark.parametrize(
    ("given", "title"),
    [
        ("bc", "bc"),
        ("mine:Method", "mine"),
        ("lab.mine:Method", "mine"),
        ("mine:Smoothed", "Smoothed"),
        ("mine:Outer.Method", "mine"),
    ],
)
def test_a_method_has_the_name_of_its_class_or_its_module(given: str, title: str) -> None:
    assert RunConfig(method={"name": given}).method_title == title


def test_the_options_of_a_method_are_those_that_are_given() -> None:
    options = composed("method=iupe", "method.epochs=7").options
    assert options.method == {"name": "iupe", "epochs": 7}


def test_options_document_exactly_the_fields_of_the_schema() -> None:
    documented = set()
    for name, default in vars(RunConfig()).items():
        nested = (
            {f"{name}.{field.name}" for field in fields(default)}
            if is_dataclass(default)
            else set()
        )
        documented |= nested if nested & set(OPTIONS) else {name}
    assert set(OPTIONS) == documented
    assert all(OPTIONS.values())


def test_files_that_repeat_declarations_are_those_that_the_script_writes() -> None:
    for path, text in written().items():
        assert path.read_text(encoding="utf-8") == text, "run scripts/write_options.py"
    names = {path.stem for path in (CONF / "method").iterdir()}
    assert names == {*TrainingOptions.METHODS, "custom"}


@pytest.mark.parametrize("name", TrainingOptions.METHODS)
def test_the_file_of_a_method_names_the_class_that_is_trained(name: str) -> None:
    target = yaml.safe_load((CONF / "method" / f"{name}.yaml").read_text())["_target_"]
    assert get_class(target) is find(name, {}, "default")[0]


@pytest.mark.parametrize("path", sorted((CONF / "experiment").iterdir()), ids=lambda p: p.stem)
def test_an_experiment_can_be_run_and_says_how_many_runs_it_has(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# @package _global_\n")
    params = {
        name: str(values).split(",")
        for name, values in yaml.safe_load(text)["hydra"]["sweeper"]["params"].items()
    }
    runs = prod(map(len, params.values()))
    assert f"{runs} runs" in text or "in eight parts" in text
    for number in (0, -1):
        swept = (f"{name}={values[number]}" for name, values in params.items())
        composed(f"+experiment={path.stem}", *swept)
    for page in re.findall(r"docs/[\w/.-]+\.md", text):
        assert (CONF.parent / page).is_file()


def test_the_values_of_the_files_are_the_defaults_of_the_declarations() -> None:
    assert composed().options == RunConfig()


def test_options_are_frozen_as_are_their_groups() -> None:
    options = composed().options
    for each in (options, options.splits):
        assert is_dataclass(each)
        with pytest.raises(FrozenInstanceError):
            each.train = 1  # type: ignore[attr-defined]


WRONG_KINDS: dict[str, list[Any]] = {
    "height": [None, "5", 5.0, True, -5, 0, 300, 10**30],
    "width": [None, "5", 1],
    "task": [None, "chess", 3, ["navigation"]],
    "labyrinths": [None, "8", 0, 1.5, True],
    "solutions": [None, "longest", 1],
    "solutions_limit": [None, 0, "x"],
    "random_steps": [None, 0, 1e3],
    "sampler": [None, "magic", {}],
    "open_walls": [None, "0.1", -1.0, 2.0, float("nan"), True],
    "buckets": [None, 34, [34, 33], [34, 33, 33, 0], [34.0, 33, 33], [90, 33, 33], "abc", {}],
    "seed": [None, -1, 2**64, "0", False],
}
WRONG_KINDS_OF_OTHERS: dict[str, list[Any]] = {
    "goals": [None, 1, "random", ["varied"]],
    "min_walls": [None, 0, -1, 41, "2", 2.0, True, [2]],
}
"""Of fields that are only written where they are not the default."""


@pytest.mark.parametrize(
    ("name", "value"),
    [
        (name, value)
        for name, values in (WRONG_KINDS | WRONG_KINDS_OF_OTHERS).items()
        for value in values
    ],
)
def test_json_of_another_kind_is_no_dataset_config(name: str, value: Any) -> None:
    good = dataset().to_json()
    with pytest.raises(ValueError, match=r"a dataset's config|give|choose one of|at most"):
        DatasetConfig.from_json(good | {name: value})


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"splits": SplitsConfig(3)}, "min_walls"),
        ({"goals": "varied"}, "goals"),
        ({"shifts": ("g",)}, "shifts"),
        (noisy(0.1), "noise"),
    ],
)
def test_an_option_that_is_not_used_is_not_written_as_before_it_was_there(
    options: dict[str, Any], name: str
) -> None:
    assert set(dataset(**options).to_json()) == {*WRONG_KINDS, name}


def test_json_with_other_fields_is_no_dataset_config() -> None:
    good = dataset().to_json()
    assert set(WRONG_KINDS) == set(good)
    for changed in [good | {"extra": 1}, {k: v for k, v in good.items() if k != "seed"}, {}]:
        with pytest.raises(ValueError, match="a dataset's config must have the fields"):
            DatasetConfig.from_json(changed)


@pytest.mark.slow
@given(
    st.text(st.sampled_from("ab'\",\\\\ =(){}[]#$*:~;&|é"), min_size=1).map(lambda text: f"x{text}")
)
def test_an_option_is_typed_so_that_shell_and_hydra_give_its_value(value: str) -> None:
    (argument,) = shlex.split(as_typed("data_dir", value))
    found = OverridesParser.create().parse_override(argument).value()
    assert OmegaConf.create({"read": found}).read == value
