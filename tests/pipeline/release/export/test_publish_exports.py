"""Exports and the environment of a dataset on the Hub, and what their libraries do with them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from hub.local_hub import LocalHub
from support.exporting import export
from support.making import Run, resolve
from support.publishing import (
    REPO,
    built,
    changes,
    error_of,
    held,
    kill_in,
    publish,
    published,
    run_script,
)

from labyrinth_core.errors import DatasetError
from pipeline.config import ConfigError, ExportOptions
from pipeline.release.derived import stage_export
from pipeline.release.options import PublishOptions

GROUP, LEROBOT = "user/labyrinth-minari", "user/labyrinth-lerobot"

USED = """
import json, sys
from importlib.util import module_from_spec, spec_from_file_location
import minari
import numpy as np
from huggingface_hub import hf_hub_download
from labyrinth_core import dump, load_arrays, load_episodes

minari.download_dataset("labyrinth-minari/2x3/test-v0")
downloaded = minari.load_dataset("labyrinth-minari/2x3/test-v0")
ours = load_episodes(sys.argv[1], "2x3", split="test", image_size=8)
same = [
    np.array_equal(theirs.observations, own.observations)
    and np.array_equal(theirs.actions, own.actions)
    for theirs, own in zip(downloaded, ours, strict=True)
]

path = hf_hub_download("user/labyrinth", "env.py")
spec = spec_from_file_location("hub_env", path)
module = module_from_spec(spec)
spec.loader.exec_module(module)
shown = {}
for split in ("test", "s0"):
    cfg = {} if split == "test" else {"cfg": type("Config", (), {"task": split})()}
    env = module.make_env(n_envs=2, use_async_envs=False, **cfg)
    texts = [text for _ in range(3) for text in env.reset()[1]["labyrinth"]]
    shown[split] = sorted(set(texts)) == sorted(
        dump(each) for each in load_arrays(sys.argv[1], "2x3", split).labyrinths
    )
print(json.dumps({"minari": same, "env": shown}))
"""
"""What a person does with the group and the environment, compared with the dataset in a folder.

EnvHub imports `env.py` in this way, and passes a `cfg` where its user made one.
"""


@pytest.mark.slow
def test_exports_and_the_environment_are_released_whole_once_and_followed_by_lerobots_tag(
    local_hub: LocalHub, releasable: Path, tmp_path: Path
) -> None:
    exports = tmp_path / "exports"
    common = ("stages=[export,publish]", "size=2x3", f"export.folder={exports}")
    common += ("export.image_size=8",)
    minari = (*common, "export.format=minari", f"publish.export={GROUP}", f"publish.env={REPO}")
    printed = published(local_hub, releasable, "1.0.0", *minari, verify=True)
    assert "MINARI_REMOTE=hf://user minari download labyrinth-minari/2x3/train-v0" in printed
    assert "not part of the release" not in printed
    assert f'make_env("{REPO}", trust_remote_code=True)' in printed
    assert f"datasets/{GROUP})" in local_hub.content(REPO, "README.md").decode()
    card = local_hub.content(GROUP, "README.md").decode()
    assert yaml.safe_load(card.split("---\n")[1])["source_datasets"] == [REPO]
    assert local_hub.refs(REPO)["refs/tags/1.0.0"] in card
    minari_folders = {
        "MINARI_REMOTE": "hf://user",
        "MINARI_DATASETS_PATH": str(tmp_path / "minari"),
    }
    done = run_script(local_hub, USED, releasable, **minari_folders)
    used = json.loads(done.stdout.splitlines()[-1])
    assert used == {"minari": [True] * 3, "env": {"test": True, "s0": True}}

    lerobot = (*common, "export.format=lerobot", f"publish.export={LEROBOT}")
    train, test = ((*lerobot, f"export.splits=[{split}]") for split in ("train", "test"))
    printed = published(local_hub, releasable, "1.0.0", *train, verify=True)
    assert f'LeRobotDataset("{LEROBOT}")' in printed
    here = built(exports / "lerobot" / "labyrinth" / "2x3" / "train-v0")
    there = held(local_hub, "v3.0", LEROBOT)
    del here["config.yaml"]  # The options name folders of this machine.
    assert there.keys() - here.keys() == {"README.md"}
    assert {path for path in here if here[path] != there[path]} == {"SHA256SUMS"}

    # The third tag that is made: after those of the dataset and of the export.
    rule = local_hub.faults.hold("POST", "/tag/", skip=2)
    kill_in(local_hub, rule, releasable, "1.1.0", *test)
    assert "refs/tags/v3.0" not in local_hub.refs(LEROBOT)
    asked = len(local_hub.log)
    printed = published(local_hub, releasable, "1.1.0", *test)
    assert printed.count("1.1.0 is published already, at ") == 2
    assert [call.method for call in changes(local_hub, asked)] == ["POST"]
    refs = local_hub.refs(LEROBOT)
    assert refs["refs/tags/v3.0"] == refs["refs/tags/1.1.0"] == refs["refs/heads/main"]
    assert len(local_hub.history(LEROBOT)) == 3
    card = local_hub.content(REPO, "README.md").decode()
    assert f"[{LEROBOT}](https://huggingface.co/datasets/{LEROBOT})." in card

    foreign = publish(
        local_hub, releasable, "1.1.0", *train[1:], f"publish.export={GROUP}", repo=""
    )
    told = f"{GROUP} holds files that no release of this kind wrote, or changed since (README.md, "
    assert error_of(foreign).startswith(told)


@pytest.fixture(scope="module")
def exported(small_dataset: Run, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run that releases the LeRobot export of train, which is there; not to be changed."""
    folder = tmp_path_factory.mktemp("exports")
    export(small_dataset, folder, "lerobot", "train", image_size=8)
    options = small_dataset.options
    publish = PublishOptions(export=LEROBOT, version="1.0.0")
    asked = ExportOptions("lerobot", str(folder), ("train",), 8)
    return resolve(replace(options, stages=("publish",), publish=publish, export=asked))


def test_an_export_of_a_dataset_that_has_no_id_says_how_it_is_made(
    exported: Run, tmp_path: Path
) -> None:
    stage_export(exported, tmp_path, is_unseen=False)
    files = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")}
    card = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert {"meta/info.json", "data/chunk-000/file-000.parquet", "labyrinth.json"} < files
    front = yaml.safe_load(card.split("---\n")[1])
    assert "source_datasets" not in front
    assert front["configs"][0]["data_files"] == [{"split": "train", "path": "data/*/*.parquet"}]
    assert "labyrinth-datasets size=3x3" in card
    assert f'LeRobotDataset("{LEROBOT}")' in card


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"splits": ("tset",)}, "export.splits=[tset]: choose from [train, validation, test, "),
        ({"splits": ("test",)}, "test-v0 holds no complete export: stages=export makes it"),
        ({"image_size": 9}, "train-v0 is an export of another dataset, or with other options: sta"),
    ],
)
def test_an_export_that_is_not_there_as_it_is_asked_for_is_not_published(
    exported: Run, tmp_path: Path, asked: dict[str, Any], message: str
) -> None:
    options = exported.options
    run = replace(exported, options=replace(options, export=replace(options.export, **asked)))
    with pytest.raises((ConfigError, DatasetError)) as caught:
        stage_export(run, tmp_path, is_unseen=False)
    assert message in str(caught.value)
