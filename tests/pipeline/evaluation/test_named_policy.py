"""`stages=[evaluate] policy=...`: anybody's policy by its name, and what is told where it fails."""

from __future__ import annotations

import csv
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image
from support.commands import RUN, ended
from support.making import RunConfig, SplitsConfig, make, perform
from support.policies import RELEASED, lay_out_run
from support.publishing import REPO, environment, local_hub, published
from support.quick_python import python

from labyrinth_core import PolicyError, evaluate, open_policy
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import Description, Results
from labyrinth_core.learning import NetworkSpec, PolicySpec
from labyrinth_core.storage import File
from pipeline.config import ConfigError

__all__ = ["local_hub"]

MODULE = """
import numpy as np

def right(observations):
    return np.full(len(observations), 1)

def make(answer=1):
    return lambda observations: np.full(len(observations), answer)

class Remembering:
    def reset(self, count):
        self.count = count

    def act(self, observations):
        return np.full(self.count, 1)

instance = Remembering()

class Broken(Remembering):
    def act(self, observations):
        return self.deeper()

    def deeper(self):
        raise ArithmeticError("too deep")

def unmade():
    raise LookupError("no weights")

def seven(observations):
    return np.full(len(observations), 7)
"""


EVALUATION = replace(RunConfig().evaluation, splits=("test",))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working directory with modules of policies."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    for name in ("strange", "needy"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    (tmp_path / "strange.py").write_text(MODULE, encoding="utf-8")
    (tmp_path / "needy.py").write_text("import not_installed_anywhere", encoding="utf-8")
    return tmp_path


@pytest.fixture
def run_of(small_dataset, make_run, folder):
    """A function that returns the run in which a policy is evaluated on test."""

    def of(policy, data_dir=small_dataset.data_dir, observation="image", **options):
        return make_run(
            data_dir,
            stages=["evaluate"],
            policy=policy,
            run_dir=str(folder / "runs"),
            observation=observation,
            evaluation=replace(EVALUATION, **options),
        )

    return of


@pytest.mark.parametrize("name", ["right", "make", "Remembering", "instance"])
def test_a_policy_or_what_makes_one_is_found_in_the_working_directory(run_of, folder, name, capsys):
    run = run_of(f"strange:{name}")
    perform("evaluate", run)
    path = folder / "runs" / "3x3" / f"strange-{name}" / "results.json"
    assert str(path) in capsys.readouterr().out
    content = json.loads(path.read_text(encoding="utf-8"))
    expected = evaluate(lambda seen: [1] * len(seen), run.source, "3x3", splits=["test"])
    assert list(content["splits"]) == ["test"]
    assert content["splits"]["test"]["moves"] == [expected.splits["test"].episodes.moves.tolist()]
    unsaid = dict.fromkeys(("author", "url", "date", "budget"), "")
    assert content["method"] == unsaid | {"name": f"strange:{name}", "details": {}}


def test_a_receipt_is_written_only_if_it_is_asked_for(run_of, folder, capsys):
    perform("evaluate", run_of("strange:right", memorised=10))
    path = folder / "runs" / "3x3" / "strange-right" / "results.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["memorised"]["drawn"] == 10
    assert "Does the policy follow its own train? test, 10 controls" in capsys.readouterr().out
    assert Results.load(path).memorised.p == content["memorised"]["p"]
    perform("evaluate", run_of("strange:right"))
    assert Results.load(path).memorised is None
    perform("evaluate", run_of("strange:right", memorised=10, splits=("train", "validation")))
    assert Results.load(path).memorised.split == "validation"


@pytest.mark.slow
def test_the_folder_of_a_run_is_a_policy_whose_results_lie_beside_it(run_of, folder):
    made = Path(shutil.copytree(RELEASED, folder / "runs" / "3x3" / "planner"))
    before = {path.name: path.read_bytes() for path in made.iterdir()}
    perform("evaluate", run_of("runs/3x3/planner"))
    path = folder / "runs" / "3x3" / "planner-as-policy" / "results.json"
    assert Results.load(path).method.name == "planner as policy"
    assert {path.name: path.read_bytes() for path in made.iterdir()} == before


def test_a_downloaded_policy_is_evaluated_beside_the_runs_though_it_has_the_record_of_its_run(
    run_of, folder
):
    made = lay_out_run(
        folder / "download", PolicySpec(NetworkSpec("mlp", 3, 3, "navigation"), False)
    )
    files = [f"{File(path).sha256()}  {path.name}\n" for path in sorted(made.iterdir())]
    (made / "SHA256SUMS").write_text("".join(files), encoding="utf-8")
    perform("evaluate", run_of("download"))
    results = Results.load(folder / "runs" / "3x3" / "download" / "results.json")
    assert (results.method.name, results.run) == ("download", None)
    assert results.policy.files.keys() == {"config.json", "model.safetensors"}


@pytest.mark.slow
def test_what_a_policy_fails_in_is_shown_beside_an_optimal_episode(run_of, folder, capsys):
    perform("evaluate", run_of("strange:right", gifs=3))
    results = folder / "runs" / "3x3" / "strange-right"
    content = json.loads((results / "results.json").read_text(encoding="utf-8"))["splits"]["test"]
    pictures = sorted((results / "attempts").glob("*.gif"))
    assert f"{results / 'attempts'} has 3 animated GIFs." in capsys.readouterr().out
    failed = [
        number
        for number, outcome in zip(content["labyrinth_ids"], content["outcomes"][0], strict=True)
        if outcome != "s"
    ]
    assert sorted(path.stem for path in pictures) == sorted(failed[:3])
    for path in pictures:
        with Image.open(path) as picture:
            assert picture.size == (620, 300)
            assert picture.n_frames > 2
        assert path.stat().st_size < 100_000


def test_the_policy_of_a_run_is_shown_its_vectors_without_being_asked(run_of, folder):
    spec = PolicySpec(NetworkSpec("mlp", 3, 3, "navigation"), average=False)
    lay_out_run(folder / "mlp", spec)
    run = run_of("./mlp", gifs=1)
    perform("evaluate", run)
    results = folder / "runs" / "3x3" / "mlp"
    assert Results.load(results / "results.json").observation == "vector"
    assert len([*(results / "attempts").glob("*.gif")]) == 1
    with pytest.raises(PolicyError, match="needs observation=vector, but is shown text"):
        perform("evaluate", run_of("./mlp", observation="text"))


def test_what_is_said_of_a_policy_is_kept_with_its_results(run_of, folder, capsys):
    about = {"name": "My method!", "author": "me", "url": "https://a.org/b", "budget": "nothing"}
    about["date"] = "2026-11-30"
    numbers = {"train_labyrinths": 100, "train_steps": 0}
    perform("evaluate", run_of("strange:right", observation="text", episodes=2, **about, **numbers))
    path = folder / "runs" / "3x3" / "My-method" / "results.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["method"] == about | {"details": {"labyrinths": 100, "steps": 0}}
    assert content["evaluated"]["observation"] == "text"
    assert content["evaluated"]["episodes"] == 2
    assert "My method!" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("policy", "kind", "message"),
    [
        ("strange:absent", ConfigError, r"policy=strange:absent: there is no absent, only \[np"),
        ("absent:make", ConfigError, "policy=absent:make: there is no module absent, neither in /"),
        ("needy:make", PolicyError, "raised ModuleNotFoundError: No module named 'not_installed"),
        ("strange:unmade", PolicyError, "raised LookupError: no weights"),
        ("strange:seven", PolicyError, "answered action 7: give 0 up, 1 right, 2 down or 3 left"),
        (".@1.0.0", ConfigError, r"policy=\.@1\.0\.0: \. is a folder, which has no revisions"),
        ("absent", DatasetError, "absent is neither a folder, a file, nor an id such as user/plan"),
        ("strange.py", DatasetError, r"strange\.py is .*: a policy in Python is module:name"),
    ],
)
def test_a_policy_that_is_not_to_be_had_is_told_in_one_line(run_of, folder, policy, kind, message):
    with pytest.raises(kind, match=message) as caught:
        perform("evaluate", run_of(policy))
    assert "\n" not in str(caught.value)
    assert not (folder / "runs").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"policy": "a:b c"},
            "policy=a:b c: give module:name, the folder of a run or of a",
        ),
        ({"policy": "ppo.zip"}, "policy=ppo.zip: give module:name, the folder of a run or of a p"),
        ({"policy": "a:b", "episodes": 0}, "evaluation.episodes=0: give a whole number"),
        ({"policy": "a:b", "image_size": 601}, "evaluation.image_size=601: give a whole number fr"),
        ({"policy": "a:b", "url": "a.org"}, "evaluation.url=a.org: give an address such as"),
        (
            {"policy": "a:b", "memorised": 10, "splits": ("s0", "train")},
            "evaluation.memorised=10: give test or validation in evaluation.splits",
        ),
        ({"policy": "a:b", "memorised": 9}, "evaluation.memorised=9: give a whole number from 10"),
        ({"policy": "", "episodes": 3}, "evaluation.episodes is for policy=...: a trained run is"),
        ({"policy": "", "observation": "text"}, "observation=text is only for policy=...: give im"),
    ],
)
def test_impossible_options_are_refused_in_one_line(run_of, options, message):
    with pytest.raises(ConfigError, match=rf"\A{message}"):
        run_of(**options)


def test_a_dataset_in_which_no_train_could_be_another_has_no_receipt(make_run, folder):
    data = folder / "apart"
    make(data, "4x4", labyrinths=5, splits=SplitsConfig(2), random_steps=1)
    asked = replace(EVALUATION, memorised=10)
    given = {"size": "4", "labyrinths": 5, "splits": SplitsConfig(2), "stages": ["evaluate"]}
    with pytest.raises(ConfigError, match=r"evaluation.memorised=10: splits.min_walls=2: [^\n]+$"):
        perform("evaluate", make_run(data, policy="strange:right", evaluation=asked, **given))


@pytest.mark.parametrize("theirs", ["my policy", None])
def test_results_of_another_policy_are_not_written_over(run_of, folder, theirs):
    path = folder / "runs" / "3x3" / "my-policy" / "results.json"
    if theirs is None:
        path.parent.mkdir(parents=True)
        path.write_text('{"mine": 1}')
    else:
        perform("evaluate", run_of("strange:right", name=theirs))
    (path.parent / "run.json").write_text("{}")
    with pytest.raises(DatasetError, match="my-policy holds a trained run: choose another"):
        perform("evaluate", run_of("strange:right", name="my-policy"))
    (path.parent / "run.json").unlink()
    before = path.read_bytes()
    reasons = {
        "my policy": "my-policy is made with name=my policy, not my-policy: choose another eval",
        None: r"results\.json: made or changed by someone else, so .*: move it away, or give over",
    }
    with pytest.raises(DatasetError, match=reasons[theirs]):
        perform("evaluate", run_of("strange:right", name="my-policy"))
    assert path.read_bytes() == before
    if theirs is not None:
        perform("evaluate", run_of("strange:right", name=theirs))


def test_results_are_those_of_one_policy_on_one_dataset(run_of, build, tmp_path):
    perform("evaluate", run_of("strange:right", name="mine"))
    other = build(tmp_path / "other", labyrinths=8, seed=1)
    for run, differing in (
        (run_of("strange:make", name="mine"), "policy=strange:right, not strange:make"),
        (run_of("strange:right", name="mine", data_dir=str(other.data_dir)), "fingerprint="),
    ):
        with pytest.raises(DatasetError, match=f"mine is made with {differing}.*choose another"):
            perform("evaluate", run)


def test_a_policy_that_is_named_is_not_trained(make_run, tmp_path):
    with pytest.raises(ConfigError, match=r"policy=a:b: give stages=evaluate, not train"):
        make_run(tmp_path, stages=["train", "evaluate"], policy="a:b")


def test_without_a_dataset_it_is_said_how_one_is_made(run_of, tmp_path):
    with pytest.raises(DatasetError, match=r"holds no dataset: labyrinth-datasets size=3x3"):
        perform("evaluate", run_of("strange:right", tmp_path / "nothing"))


def command(small_dataset, policy):
    return ["size=3", f"data_dir={small_dataset.data_dir}", "stages=evaluate", f"policy={policy}"]


@pytest.mark.slow
def test_by_command_the_error_of_a_policy_is_one_line_and_its_own_traceback(folder, small_dataset):
    done = ended([python(), str(RUN), *command(small_dataset, "strange:Broken")])
    assert done.returncode == 1
    first, second, *others = done.stderr.splitlines()
    assert first.startswith("error: the policy raised ArithmeticError: too deep when given uint8")
    assert second == "Traceback (most recent call last):"
    files = [line.split('"')[1] for line in others if line.startswith("  File ")]
    assert files == [str(folder / "strange.py")] * 2
    assert others[-1] == "ArithmeticError: too deep"
    assert not (folder / "runs").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_no_torch_is_needed_to_judge_a_policy_that_needs_none(small_dataset):
    program = (
        "import sys; sys.modules['torch'] = None; from pipeline.__main__ import main; "
        f"sys.argv[1:] = {command(small_dataset, 'strange:right')!r}; main()"
    )
    done = ended([python(), "-c", program], env={"PYTHONPATH": str(RUN.parent)})
    assert done.returncode == 0, done.stderr
    assert "s0_and_g" in done.stdout


@pytest.mark.slow
def test_a_dataset_on_the_hub_is_as_good_as_a_folder(local_hub, folder, tmp_path):
    data_dir = tmp_path / "labyrinth"
    make(data_dir, "2x3", labyrinths=3, random_steps=5)
    published(local_hub, data_dir)
    by_id = ["size=2x3", "stages=[evaluate,results]", "policy=strange:right", f"dataset={REPO}"]
    done = ended([python(), str(RUN), *by_id, "revision=1.0.0"], env=environment(local_hub))
    assert done.returncode == 0, done.stderr
    there = json.loads((folder / "runs/2x3/strange-right/results.json").read_text("utf-8"))
    policy = open_policy("strange:right")
    here = evaluate(policy, data_dir, "2x3").to_json(Description("strange:right"))
    assert there["dataset"] == here["dataset"] | {"source": REPO, "revision": "1.0.0"}
    assert there["splits"] == here["splits"]
    with (folder / "results" / "leaderboard.csv").open(encoding="utf-8", newline="") as file:
        assert {row["compared"] for row in csv.DictReader(file)} == {"True"}
