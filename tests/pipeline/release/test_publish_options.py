"""Options of what is published that are missing, or that go with no others."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from support.making import RunConfig, resolve
from support.publishing import REPO

from pipeline.command.composed import unused
from pipeline.command.stages import STAGES
from pipeline.config import ConfigError, ExportOptions
from pipeline.release.options import PublishOptions

WHERE = {"repo_id": REPO, "version": "1.0.0"}
MODEL = {"model": "user/planner-3x3", "version": "1.0.0"}
EXPORT = {"export": "user/labyrinth-lerobot", "version": "1.0.0"}


@pytest.mark.parametrize(
    ("publish", "others", "message"),
    [
        ({}, {}, "publish.repo_id="),
        (WHERE | {"repo_id": "labyrinth"}, {}, "publish.repo_id=labyrinth: give the id"),
        (WHERE | {"repo_id": "user/a/b"}, {}, "publish.repo_id=user/a/b: give the id"),
        (WHERE | {"version": ""}, {}, "publish.version=: give three numbers, such as 1.0.0"),
        (WHERE | {"version": "v1"}, {}, "publish.version=v1: give three numbers"),
        (WHERE | {"version": "01.0.0"}, {}, "publish.version=01.0.0: give three numbers"),
        (MODEL | {"model": "planner"}, {}, "publish.model=planner: give the id of a model on the"),
        (MODEL, {}, "dataset=: give the id on the Hub of the dataset that the policy or the"),
        *(
            (
                WHERE | {"repo_id": "", name: REPO},
                {"dataset": id_},
                f"dataset={id_}: give the id on",
            )
            for name, id_ in (
                ("env", "/data/labyrinth"),
                ("env", "user"),
                ("env", "user/a'b"),  # In env.py the id is code.
                ("env", 'user/a"+exit()+"'),
                ("env", "user/a\nimport os"),
            )
        ),
        (EXPORT, {}, "export.format=: choose one of "),
        (
            EXPORT,
            {"export": ExportOptions("imitation")},
            "export.format=imitation: publish.export releases lerobot and minari, whose",
        ),
        (
            EXPORT,
            {"export": ExportOptions("lerobot")},
            "export.splits=[]: a repository holds one LeRobot dataset, so ",
        ),
        (
            EXPORT,
            {"export": ExportOptions("lerobot", splits=("train", "test"))},
            "export.splits=[train, test]: a repo",
        ),
    ],
)
def test_options_that_cannot_be_published_are_refused_in_one_line(
    publish: dict[str, str], others: dict[str, Any], message: str
) -> None:
    options = RunConfig(stages=["publish"], publish=PublishOptions(**publish), **others)
    with pytest.raises(ConfigError) as caught:
        resolve(options)
    assert str(caught.value).startswith(message)


def test_a_publication_says_what_loads_it_and_a_rehearsal_nothing() -> None:
    options = RunConfig(stages=("publish",), publish=PublishOptions(**WHERE))
    rehearsed = replace(options, publish=replace(options.publish, dry_run=True))
    told = [
        STAGES["publish"].next_step(resolve(each), ["publish"]) for each in (options, rehearsed)
    ]
    line = "Next: load_transitions takes the id of the dataset, from any machine."
    assert [*map(tuple, told)] == [(line,), ()]


def test_a_dataset_in_an_object_store_cannot_be_published() -> None:
    options = {"data_dir": "memory://a", "publish": PublishOptions(**WHERE)}
    with pytest.raises(ConfigError, match=r"memory://a.*publish need a local folder") as caught:
        resolve(RunConfig(stages=["publish"], **options))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "stages", "others", "users"),
    [
        ("method", ["build"], {}, ("publish", "train", "evaluate")),
        ("method.epochs", ["validate"], {}, ("publish", "train", "evaluate")),
        ("publish.version", ["build", "card"], {}, ("publish",)),
        ("method", ["publish"], {}, ("publish with publish.model", "train", "evaluate")),
        ("method", ["publish"], {"publish": PublishOptions(model="a/b")}, None),
        ("method", ["publish", "train"], {}, None),
        (
            *("export.format", ["publish"], {}),
            ("publish with publish.export", *["export"] * ("export" in STAGES)),
        ),
        ("export.format", ["publish"], {"publish": PublishOptions(export="a/b")}, None),
        ("revision", ["publish"], {"publish": PublishOptions(env="a/b")}, None),
        (
            "encoder",
            ["evaluate"],
            {"policy": "a:b"},
            ("publish", "train", "evaluate without policy"),
        ),
        ("device", ["evaluate"], {"policy": "a:b"}, None),
        ("policy", ["evaluate"], {}, None),
        ("policy", ["validate"], {}, ("evaluate",)),
        ("size", ["validate"], {}, None),
    ],
)
def test_an_option_that_no_requested_stage_uses_is_told(
    name: str, stages: list[str], others: dict[str, Any], users: tuple[str, ...] | None
) -> None:
    options = RunConfig(stages=stages, **others)
    assert unused([name], options) == ({name: users} if users else {})
