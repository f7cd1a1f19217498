"""A policy on the Hub: what is sent, what comes back, and what is refused."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hub.local_hub import LocalHub
from huggingface_hub import ModelCard
from support.making import Run, perform
from support.publishing import (
    REPO,
    changes,
    environment,
    error_of,
    held,
    publish,
    published,
    run_script,
)
from support.submitted import of_few

from labyrinth_core import evaluate, load_policy, memorised
from labyrinth_core.data import Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import Results
from pipeline.machinery import Sums
from pipeline.release.model import stage_policy
from pipeline.release.options import PublishOptions
from pipeline.training import train

pytestmark = pytest.mark.slow

MODEL = "user/planner-3x3"

FOUR_WAYS = """
import json, sys
import torch
from support.policies import Remembering
from labyrinth_core import evaluate, load_policy, open_policy
from labyrinth_core.evaluation import Description

torch.set_num_threads(1)
blocks, data_dir, model = json.loads(sys.argv[1]), *sys.argv[2:]
for block in blocks:
    exec(compile(block, "README.md", "exec"), names := {})
loaded = load_policy(model, revision="1.0.0")
asked = {
    "function": lambda observations: loaded(observations),
    "module": loaded.network,
    "steps": Remembering(loaded),
    "id": open_policy(model),
    "id and revision": open_policy(model + "@1.0.0"),
}
some = ["test", "s0_and_g"]
figures = {name: evaluate(each, data_dir, "3x3", splits=some) for name, each in asked.items()}
figures["card"] = names["results"]
print(json.dumps({
    "ways": {name: found.way for name, found in figures.items()},
    "splits": {
        name: {split: found.to_json(Description("x"))["splits"][split] for split in some}
        for name, found in figures.items()
    },
}))
"""
"""The same policy in four ways, by the card's own program, and by the name of the stage."""


def of_run(run: Run) -> tuple[str, ...]:
    """Return the options that name the policy of a run."""
    return ("size=3", "method=planner", f"run_dir={run.options.run_dir}")


def test_a_dataset_and_a_policy_are_released_by_one_command_and_the_policy_refers_to_it(
    local_hub: LocalHub, trained: Run, tmp_path: Path
) -> None:
    data_dir = Path(shutil.copytree(trained.source, tmp_path / "labyrinth"))
    options = (*of_run(trained), f"publish.model={MODEL}")
    printed = published(local_hub, data_dir, "1.0.0", *options, verify=True)
    assert f'load_policy("{MODEL}", revision="1.0.0")' in printed
    assert "5 files are those published, and the policy loads." in printed
    assert held(local_hub, "1.0.0", MODEL, "model").keys() == {
        *("README.md", "SHA256SUMS", "config.json", "model.safetensors", "run.json")
    }
    for repo, kind in ((REPO, "dataset"), (MODEL, "model")):
        refs = local_hub.refs(repo, kind)
        assert refs["refs/tags/1.0.0"] == refs["refs/heads/main"]
        assert len(local_hub.history(repo, kind=kind)) == 2

    def text(repo: str, path: str, kind: str) -> str:
        return local_hub.content(repo, path, "1.0.0", kind).decode()

    card = text(MODEL, "README.md", "model")
    evaluation = json.loads((trained.training_folder / "results.json").read_bytes())
    for split, scores in evaluation["splits"].items():
        cells = " | ".join(f"{scores[each]:.1%}" for each in ("spl", "sr_within_cells", "sr"))
        assert re.search(rf"\| `{split}` \|.*\| 6 \| {cells} \|", card)
    data = ModelCard(card).data
    assert (data.datasets, data.model_name, data.license) == ([REPO], "planner-3x3", "mit")
    assert f"`{evaluation['run']['fingerprint']}`" in card
    commit = local_hub.refs(REPO)["refs/tags/1.0.0"]
    told = [
        (r.dataset_type, r.dataset_config, r.dataset_split, r.dataset_revision, r.metric_name)
        for r in data.eval_results
    ]
    splits = evaluation["splits"]
    assert told == [(REPO, "3x3", s, commit, metric) for s in splits for metric in ("SPL", "SR")]
    figures = [round(s[metric], 8) for s in splits.values() for metric in ("spl", "sr")]
    assert [r.metric_value for r in data.eval_results] == figures

    blocks = re.findall(r"```python\n(.*?)```", card, re.DOTALL)
    tests = str(Path(__file__).parents[2])
    path = os.pathsep.join([environment(local_hub)["PYTHONPATH"], tests])
    arguments = (json.dumps(blocks), data_dir, MODEL)
    done = run_script(local_hub, FOUR_WAYS, *arguments, PYTHONPATH=path)
    results = json.loads(done.stdout.splitlines()[-1])
    assert len(blocks) == 1
    assert results["ways"].pop("steps") == "steps"
    assert set(results["ways"].values()) == {"look-ups"}
    steps = results["splits"].pop("steps")
    first, *others = results["splits"].values()
    assert others == [first] * 4
    for split in ("test", "s0_and_g"):
        scores = evaluation["splits"][split]
        for name in ("sr", "aer", "aer_std", "path_efficiency", "sr_interval"):
            assert first[split][name] == steps[split][name] == scores[name]
        assert first[split]["moves"] == steps[split]["moves"] == [scores["moves"][0]]

    asked = len(local_hub.log)
    printed = published(local_hub, data_dir, "1.0.0", *options)
    assert printed.count("1.0.0 is published already, at ") == 2
    assert changes(local_hub, asked) == []


def test_a_version_of_a_policy_is_published_once(local_hub: LocalHub, trained: Run) -> None:
    local_hub.create_repo(REPO)
    manifest = (Path(trained.source) / "3x3" / "manifest.json").read_bytes()
    local_hub.commit(REPO, "3x3/manifest.json", manifest)  # Of the dataset, all that is read.
    local_hub.create_repo(MODEL, kind="model")
    local_hub.commit(MODEL, "config.json", b"{}", kind="model")
    local_hub.tag(MODEL, "1.0.0", kind="model")
    options = (*of_run(trained), f"publish.model={MODEL}", f"dataset={REPO}")
    error = error_of(publish(local_hub, trained.local_dir, "1.0.0", *options, repo=""))
    assert error.startswith(f"the tag 1.0.0 of {MODEL} is at ")
    assert "with other data (" in error
    assert error.endswith("choose another publish.version")
    assert changes(local_hub) == []


COMMIT = "0" * 40


@pytest.fixture
def staged(tmp_path: Path) -> Path:
    """An empty folder for the files of a repository."""
    folder = tmp_path / "staged"
    folder.mkdir()
    return folder


@pytest.fixture
def manifest(trained: Run) -> Manifest:
    """The manifest of the dataset that the policy was trained on."""
    return Manifest.read(trained.local_dir / "3x3")


def of_hub(run: Run, **options: Any) -> Run:
    publishing = PublishOptions(model=MODEL, version="1.0.0")
    return replace(run, options=replace(run.options, dataset=REPO, publish=publishing, **options))


@pytest.fixture
def copied(trained: Run, tmp_path: Path) -> Run:
    """The run that publishes the policy, in a folder of its own."""
    return of_hub(trained, run_dir=shutil.copytree(trained.options.run_dir, tmp_path / "runs"))


def change(file: Path, *place: str, value: Any = None) -> None:
    """Change a value in a file of JSON, or remove it."""
    content = inner = json.loads(file.read_bytes())
    *way, last = place
    for key in way:
        inner = inner[key]
    inner[last] = value
    if value is None:
        del inner[last]
    file.write_text(json.dumps(content), encoding="utf-8")


def refused(run: Run, manifest: Manifest, staged: Path) -> str:
    """Return why the policy of a run is not published."""
    with pytest.raises(DatasetError) as caught:
        stage_policy(run, staged, COMMIT, manifest)
    return str(caught.value)


def test_a_policy_of_another_dataset_than_the_one_on_the_hub_is_not_published(
    trained: Run, manifest: Manifest, staged: Path
) -> None:
    first, *others = manifest.shards
    other = replace(manifest, shards=[replace(first, fingerprint="0" * 64), *others])
    told = f"{trained.training_folder} was trained on another dataset than {REPO}: their finger"
    assert refused(of_hub(trained), other, staged).startswith(told)


def test_a_card_says_whether_the_policy_follows_its_own_train(
    trained: Run, copied: Run, manifest: Manifest, staged: Path
) -> None:
    path = copied.training_folder / "results.json"
    receipt = memorised(load_policy(copied.training_folder), trained.source, "3x3", controls=10)
    results = replace(Results.load(path), memorised=receipt)
    results.save(path, name=copied.run_name.name)
    stage_policy(copied, staged, COMMIT, manifest)
    card = " ".join((staged / "README.md").read_text(encoding="utf-8").split())
    assert f"{receipt.excess:+.2f} points more than the consensus of other training sets" in card
    assert f"p = {receipt.p:.3f} among 10 of them" in card


def test_a_split_that_was_evaluated_in_part_is_in_the_table_of_the_card_alone(
    copied: Run, manifest: Manifest, staged: Path
) -> None:
    few = of_few(Results.load(copied.training_folder / "results.json"), 5)
    part = replace(copied, options=replace(copied.options, train_labyrinths=5))
    shutil.copytree(copied.training_folder, part.training_folder)
    few.save(part.training_folder / "results.json", name=part.run_name.name)
    stage_policy(part, staged, COMMIT, manifest)
    card = (staged / "README.md").read_text(encoding="utf-8")
    assert "| learnt from | 5 labyrinths of `train`, the first of 6 |" in card
    assert re.search(r"\| `s0` \|.*\| 5 \|", card)
    named = [each.dataset_split for each in ModelCard(card).data.eval_results]
    assert named == ["validation", "validation", "test", "test"]


@pytest.mark.parametrize(
    ("place", "value", "why"),
    [
        (
            ("splits", "test", "known_route"),
            "010101",
            "is refused: test: known_route[2] is 0, ",
        ),
        (("baselines", "random", "test", "sr"), 0.5, "is refused: test: sr of random is 0.5, but "),
        (("baselines", "oracle"), None, "is refused: train: the figures of the baseline oracle "),
        (("run", "training", "epochs"), 99, "describes another training than run.json"),
        (("run", "settings", "epochs"), 99, "describes another training than run.json"),
    ],
)
def test_results_that_cannot_be_or_are_not_of_the_record_are_not_published(
    copied: Run, manifest: Manifest, staged: Path, place: tuple[str, ...], value: Any, why: str
) -> None:
    results = copied.training_folder / "results.json"
    change(results, *place, value=value)
    assert refused(copied, manifest, staged).startswith(f"{results} {why}")


def test_no_setting_is_markup_on_the_card_and_why_spl_leads_stands_beside_its_table(
    copied: Run, manifest: Manifest, staged: Path
) -> None:
    for name in ("results.json", "run.json"):
        for setting, text in (("a", "<b>|"), ("b", "`<img src=x>\n## Mine`")):
            change(copied.training_folder / name, "run", "settings", setting, value=text)
    (copied.training_folder / Sums.FILE).unlink()  # It has the hash of the unchanged record.
    stage_policy(copied, staged, COMMIT, manifest)
    card = (staged / "README.md").read_text(encoding="utf-8")
    [settings] = re.findall(r"^\| settings \| (.*) \|$", card, re.MULTILINE)
    assert settings.endswith(r"`a=<b>\|`, b=\`\<img src=x\> \#\# Mine\`")
    assert Results.WHY_SPL in card
    assert "| split | holds | labyrinths | SPL | SR in n x n | SR | 95% |" in card


def test_a_mapper_is_published_and_loaded_as_it_was_trained(
    trained: Run, manifest: Manifest, staged: Path, tmp_path: Path
) -> None:
    method = {"name": "mapper", "epochs": 2, "batch_size": 3, "channels": 8}
    run = replace(trained, options=replace(trained.options, method=method, run_dir=str(tmp_path)))
    train.run(run)
    perform("evaluate", run)
    content = json.loads((run.options.run_folder(run.dataset) / "results.json").read_bytes())
    stage_policy(of_hub(run), staged, COMMIT, manifest)
    card = (staged / "README.md").read_text(encoding="utf-8")
    results = evaluate(load_policy(staged), run.source, "3x3")
    for split, scores in content["splits"].items():
        assert results.splits[split].episodes.moves.tolist() == scores["moves"]
        assert results.splits[split].episodes.solved.mean() == scores["sr"]
    assert f'evaluate(policy, "{REPO}", "3x3", revision="{COMMIT}")' in card
    assert "`policy` is an object with `reset(count)` and `act(observations)`" in card
    assert "The policy plans once, in the first picture of an episode" in card


def test_a_policy_of_another_protocol_is_published_with_what_it_has_to_be_shown(
    trained: Run, manifest: Manifest, staged: Path, tmp_path: Path
) -> None:
    method = {"name": "bc", "epochs": 1}
    changed = replace(trained.options, protocol="paper", method=method, run_dir=str(tmp_path))
    run = replace(trained, options=changed)
    train.run(run)
    perform("evaluate", run)
    content = json.loads((run.options.run_folder(run.dataset) / "results.json").read_bytes())
    stage_policy(of_hub(run), staged, COMMIT, manifest)
    assert json.loads((staged / "config.json").read_bytes())["resize"] == "original"
    for source in (staged, run.options.run_folder(run.dataset)):
        results = evaluate(load_policy(source), run.source, "3x3")
        for split, scores in content["splits"].items():
            figures = results.splits[split].figures()
            assert figures == {name: scores[name] for name in figures}
    assert "antialiasing: most walls vanish)" in (staged / "README.md").read_text(encoding="utf-8")


def test_a_policy_that_is_not_there_or_of_other_weights_is_not_published(
    copied: Run, manifest: Manifest, staged: Path
) -> None:
    folder = copied.training_folder
    results, weights = folder / "results.json", folder / "model.safetensors"
    right = weights.read_bytes()
    weights.write_bytes(b"others")
    assert refused(copied, manifest, staged).startswith(f"{weights} is damaged: ")
    weights.write_bytes(right)
    change(results, "run", "evaluated", "weights", value=hashlib.sha256(b"others").hexdigest())
    told = f"{results} is for other weights than model.safetensors: stages=evaluate"
    assert refused(copied, manifest, staged).startswith(told)
    change(results, "run")
    told = f"{results} belongs to another run: stages=evaluate makes it again"
    assert refused(copied, manifest, staged) == told
    other = replace(copied, dataset=replace(copied.dataset, seed=1))
    told = "planner-seed1 holds no evaluated policy: 'stages=[train,evaluate]' makes one"
    assert refused(other, manifest, staged).endswith(told)
