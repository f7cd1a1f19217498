"""A method of the user, `method=custom`: that of docs/new-method.md, and others."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.making import Run, perform

from labyrinth_core import evaluate as evaluate_policy
from labyrinth_core import load_policy
from labyrinth_core.errors import DatasetError
from pipeline.config import ConfigError
from pipeline.training import train
from pipeline.training.identity import find

pytestmark = pytest.mark.slow

DOCUMENT = (Path(__file__).parents[3] / "docs" / "new-method.md").read_text(encoding="utf-8")
(EXAMPLE,) = re.findall(r"<!-- written to mine.py -->\n```python\n(.*?)```", DOCUMENT, re.DOTALL)

BEGIN = """
from dataclasses import dataclass
from labyrinth_core.learning import BaseSettings, Learner, setting
"""
IDLE = "    def epoch(self):\n        return {'loss': 0.5}\n"


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str, str], None]]:
    """A function that writes a module into the working directory, which is then imported anew."""
    monkeypatch.chdir(tmp_path)
    written, path = [], [*sys.path]

    def write(name: str, text: str) -> None:
        Path(f"{name}.py").write_text(text)
        written.append(name)

    yield write
    sys.path[:] = path
    for name in written:
        sys.modules.pop(name, None)


@pytest.fixture
def run_of(small_dataset: Run, make_run: Callable[..., Run]) -> Callable[..., Run]:
    def make(name: str, **options: Any) -> Run:
        usual: dict[str, Any] = {"stages": ["train", "evaluate"], "threads": 1}
        settings = {"name": name, "epochs": 2} | options.pop("settings", {})
        return make_run(small_dataset.data_dir, method=settings, **usual | options)

    return make


def trained(run: Run) -> dict[str, Any]:
    for stage in ("train", "evaluate"):
        perform(stage, run)
    record: dict[str, Any] = json.loads((run.training_folder / "run.json").read_bytes())
    return record


def test_the_example_is_trained_judged_and_loaded(
    module: Callable[[str, str], None], run_of: Callable[..., Run], small_dataset: Run
) -> None:
    assert len(EXAMPLE.splitlines()) <= 34
    module("mine", EXAMPLE)
    run = run_of("mine:Method", settings={"smoothing": 0.2})
    record = trained(run)
    assert run.training_folder == Path("runs/3x3/mine-cnn-seed0")
    assert record["run"]["settings"] == {
        "epochs": 2,
        "evaluate_every": 2,
        "batch_size": 64,
        "learning_rate": 0.0005,
        "smoothing": 0.2,
    }
    policy = load_policy(run.training_folder)
    again = evaluate_policy(policy, str(small_dataset.data_dir), "3x3", splits=["test"])
    kept = json.loads((run.training_folder / "results.json").read_bytes())["splits"]["test"]
    assert again.splits["test"].sr == kept["sr"]


def test_a_method_can_be_imported_beside_a_folder_called_pipeline(
    module: Callable[[str, str], None],
) -> None:
    module("mine", EXAMPLE)
    Path("pipeline").mkdir()
    Path("pipeline/__init__.py").write_text("ours = True")
    program = (
        "import mine, pipeline; assert pipeline.ours; print(mine.Method.__mro__[1].__module__)"
    )
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert run.stdout == "labyrinth_core.learning.learner\n"


def test_a_method_may_do_without_settings_and_have_a_network_of_its_own(
    module: Callable[[str, str], None], run_of: Callable[..., Run]
) -> None:
    module(
        "ours",
        f"{BEGIN}from torch import nn\n"
        "from labyrinth_core.learning.networks.network import as_input\n"
        "class Small(nn.Module):\n"
        "    def __init__(self):\n"
        "        super().__init__()\n"
        "        self.layer = nn.Linear(64 * 64 * 3, 4)\n"
        "    def forward(self, pictures):\n"
        "        return self.layer(as_input(pictures).flatten(1))\n"
        "class Linear(Learner):\n"
        "    own_network = True\n"
        "    @classmethod\n"
        "    def make(cls, spec, settings):\n"
        f"        return Small()\n{IDLE}",
    )
    run = run_of("ours:Linear")
    trained(run)
    assert run.training_folder.name == "Linear-seed0"


def test_a_run_of_other_code_is_not_taken_for_the_run(
    module: Callable[[str, str], None], run_of: Callable[..., Run]
) -> None:
    text = "from labyrinth_core.learning.methods import sqil\nclass Mine(sqil.Method):\n    pass\n"
    module("ours", text)
    settings = {"updates": 1}  # Those of the method that it inherits from.
    train.run(run_of("ours:Mine", settings=settings))
    module("ours", f"{text}# Changed.\n")
    with pytest.raises(
        DatasetError, match=r"with code=ours\.py \w{12}, not ours\.py \w{12}: choose"
    ):
        train.run(run_of("ours:Mine", settings=settings))
    train.run(run_of("ours:Mine", settings=settings, overwrite=True))


def test_a_network_that_has_changed_in_another_module_is_refused_in_one_line(
    module: Callable[[str, str], None], run_of: Callable[..., Run]
) -> None:
    module("shapes", "BIAS = True\n")
    module(
        "ours",
        f"{BEGIN}from torch import nn\n"
        "class Small(nn.Linear):\n"
        "    def forward(self, pictures):\n"
        "        return super().forward(pictures.flatten(1).float())\n"
        "class Own(Learner):\n"
        "    own_network = True\n"
        "    @classmethod\n"
        "    def make(cls, spec, settings):\n"
        "        from shapes import BIAS\n"
        f"        return Small(64 * 64 * 3, 4, BIAS)\n{IDLE}",
    )
    run = run_of("ours:Own")
    train.run(run)
    module("shapes", "BIAS = False\n")
    sys.modules.pop("shapes")
    with pytest.raises(DatasetError, match=r"safetensors is not a policy of this network: .*\Z"):
        perform("evaluate", run)


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("m:Missing", IDLE.replace("    ", "", 1), "there is no Missing, only ["),
        ("m:BaseSettings", "", "give a class that inherits from labyrinth_core.learning.Learner"),
        ("m:Idle", "class Idle(Learner):\n    pass\n", "and has a method epoch"),
        ("m:Idle", f"class Idle(Learner):\n{IDLE}Settings = 3\n", "has to be a dataclass"),
        (
            "m:Idle",
            f"class Idle(Learner):\n{IDLE}class Settings(BaseSettings):\n    epochs: int = 3\n",
            "its Settings class has to be a dataclass that inherits from BaseSettings",
        ),
        ("m:BC", f"class BC(Learner):\n{IDLE}", "BC is the name of another method; rename"),
        (
            "m:Idle",
            f"class Idle(Learner):\n{IDLE}@dataclass(frozen=True)\nclass Settings(BaseSettings):\n"
            "    epochs: int = 0\n",
            "method.epochs=0: give a whole number, 1 or more",
        ),
        ("nothing:Idle", "", "there is no module nothing, neither in /"),
    ],
)
def test_what_is_no_method_is_refused_in_one_line(
    module: Callable[[str, str], None], name: str, text: str, told: str
) -> None:
    module("m", BEGIN + text)
    with pytest.raises(ConfigError, match=re.escape(told)) as caught:
        find(name, {})
    assert "\n" not in str(caught.value)


def test_an_error_in_a_module_is_the_modules(module: Callable[[str, str], None]) -> None:
    module("m", "import nothing_of_this_name\n")
    with pytest.raises(ModuleNotFoundError, match="nothing_of_this_name"):
        find("m:Method", {})


def test_a_setting_keeps_its_limits_where_a_default_alone_changes(
    module: Callable[[str, str], None],
) -> None:
    module(
        "m",
        f"{BEGIN}@dataclass(frozen=True)\nclass Settings(BaseSettings):\n    batch_size: int = 8\n"
        "    share: float = setting(0.5, 'share of labels', at_most=1)\n"
        f"class Idle(Learner):\n{IDLE}",
    )
    _, settings = find("m:Idle", {"name": "m:Idle", "share": 1})
    assert (settings.batch_size, settings.epochs) == (8, 100)
    for values, told in (
        ({"batch_size": 1}, "batch_size=1: give a whole number, 2 or more"),
        ({"share": 2}, "share=2: give a number from 0 to 1"),
        ({"speed": 1}, r"speed is not an option: choose from \[method.epochs, .*share"),
    ):
        with pytest.raises(ConfigError, match=rf"^method\.{told}"):
            find("m:Idle", values)
