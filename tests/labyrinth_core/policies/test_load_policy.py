"""Policies from folders: what was written comes back, and nothing else is taken for a policy."""

from __future__ import annotations

import json
import os
import pickle
import re
import shutil
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from support.labyrinths_of_datasets import CONFIGS
from support.policies import RELEASED, RELEASED_SPEC, lay_out_released, lay_out_run, network_of

from labyrinth_core import (
    DatasetError,
    PolicyError,
    compare,
    evaluate,
    load_arrays,
    load_policy,
    render,
    sample_labyrinth,
    shortest_route,
)
from labyrinth_core.evaluation import check_policy
from labyrinth_core.learning import NetworkSpec, PolicySpec, TrainedPolicy
from labyrinth_core.learning.spec import MapperSpec, PlannerSpec
from labyrinth_core.policies import read_tensors
from labyrinth_core.storage import File
from labyrinth_core.world import Task

torch.set_num_threads(1)

SPECS = [
    PolicySpec(NetworkSpec("cnn", 3, 4, "key_and_door"), average=True),
    PolicySpec(NetworkSpec("resnet18", 3, 3, "icy_floor"), average=False),
    PolicySpec(NetworkSpec("mlp", 3, 4, "key_and_door"), average=False),
    PolicySpec(
        NetworkSpec("planner", 4, 3, "navigation"),
        average=False,
        own=PlannerSpec(False, False, False, channels=4, iterations=3, sharpness=1.5),
    ),
]
MAPPER = PolicySpec(NetworkSpec("mapper", 3, 3, "navigation"), False, MapperSpec(4, 2))


@pytest.fixture
def released(tmp_path: Path) -> Path:
    """The planner that was released, in a folder to be changed."""
    return lay_out_released(tmp_path / "planner")


def test_the_folder_of_a_run_is_a_policy(released: Path, tmp_path: Path) -> None:
    policy, same = load_policy(RELEASED), load_policy(released)
    assert policy.spec == RELEASED_SPEC
    ours, theirs = policy.network.state_dict(), same.network.state_dict()
    assert ours.keys() == theirs.keys()
    assert all(torch.equal(ours[name], theirs[name]) for name in ours)
    run = Path(shutil.copytree(RELEASED, tmp_path / "run"))
    record = (run / "run.json").read_text(encoding="utf-8")
    read = f"{run / 'run.json'} cannot be read: "
    again = "; stages=train overwrite=true makes it again"
    for old, new, reason in (
        ('"format": 2', '"format": 1', f"{read}it.format is 1, not 2{again}"),
        ('"settings"', '"others"', f"{read}it.run has no settings"),
        ('"run"', '"ran"', f"{read}it has no run"),
        ('"files"', '"file"', f"{read}it has no files"),
        ('"epochs": 30,\n "sel', '"epochs": 31,\n "sel', f"{read}it has 31 epochs, but 30 in"),
        ('{\n "format"', '{"format": 1, "format"', f"{read}'format' appears twice in one object"),
        ("{", "", read),
    ):
        assert old in record
        (run / "run.json").write_text(record.replace(old, new, 1), encoding="utf-8")
        check_refused(run, reason)
    (run / "run.json").write_text(record, encoding="utf-8")
    for name in ("config.json", "model.safetensors"):
        content = (run / name).read_bytes()
        (run / name).write_bytes(content + b" ")
        check_refused(run, f"{run / name} is damaged: its sha256 is not the one in run.json{again}")
        (run / name).unlink()
        check_refused(run, f"{run / name} does not exist: stages=train makes it")
        (run / name).write_bytes(content)
    load_policy(run)


def test_a_record_that_differs_from_the_list_of_hashes_is_damaged(tmp_path: Path) -> None:
    run = Path(shutil.copytree(RELEASED, tmp_path / "run"))
    record = run / "run.json"
    (run / "SHA256SUMS").write_text(f"{'0' * 64}  a.run.json\n{File(record).sha256()}  run.json\n")
    load_policy(run)
    text = record.read_text(encoding="utf-8")
    record.write_text(text.replace('"sharpness": 3.0', '"sharpness": 2.0'), encoding="utf-8")
    check_refused(run, f"{record} is damaged: its sha256 is not the one in SHA256SUMS")


@pytest.mark.slow
@pytest.mark.parametrize("spec", SPECS, ids=lambda spec: spec.network.encoder)
def test_a_policy_comes_back_as_it_was_written(spec: PolicySpec, tmp_path: Path) -> None:
    network = written(spec, tmp_path)
    loaded = load_policy(tmp_path)
    assert loaded.spec == spec
    rng = np.random.default_rng(0)
    seen: Any = rng.integers(256, size=(2, 64, 64, 3)).astype(np.uint8)
    if spec.observation == "vector":
        seen = rng.integers(2, size=(2, 5 + 5 * 7)).astype(np.int32)
    with torch.no_grad():
        scores = network.eval()(torch.tensor(seen)).numpy()
    assert np.array_equal(loaded(seen), scores)
    actions, state = loaded.predict(seen, state=None, episode_start=None, deterministic=True)
    assert (actions.tolist(), state) == (scores.argmax(axis=1).tolist(), None)
    assert loaded.predict(seen[1])[0] == actions[1]
    assert not loaded.network.training


def written(spec: PolicySpec, folder: Path) -> torch.nn.Module:
    """Write a policy with random weights into a folder; return its network."""
    network = network_of(spec)
    save_file(network.state_dict(), folder / PolicySpec.WEIGHTS)
    (folder / PolicySpec.FILE).write_text(json.dumps(spec.to_json()), encoding="utf-8")
    return network


def test_the_description_of_a_policy_is_always_the_same() -> None:
    shape = {"height": 5, "width": 5, "task": "navigation"}
    priors = dict.fromkeys(("path_prior", "grid_prior", "colour_prior"), True)
    sizes = {"channels": 32, "iterations": 20, "sharpness": 3.0}
    head = {"kind": "labyrinth-policy", "format": 1, "observation": "image", "image_size": 64}
    released = {
        **head,
        "network": {"encoder": "planner", **shape},
        "average": True,
        "planner": {**priors, **sizes},
    }
    assert json.dumps(RELEASED_SPEC.to_json()) == json.dumps(released)
    plain = {**head, "network": {"encoder": "cnn", **shape}, "average": False}
    spec = PolicySpec.from_json(plain)
    assert spec == PolicySpec(NetworkSpec("cnn", 5, 5, "navigation"), average=False)
    assert json.dumps(spec.to_json()) == json.dumps(plain)


@pytest.mark.slow
def test_a_mapper_comes_back_as_it_was_written_and_is_evaluated(
    tmp_path: Path, small_dataset: Any
) -> None:
    network: Any = written(MAPPER, tmp_path)
    torch.nn.init.normal_(network.effects)
    save_file(network.state_dict(), tmp_path / PolicySpec.WEIGHTS)
    loaded = load_policy(tmp_path)
    assert loaded.spec == MAPPER
    own = TrainedPolicy.of(MAPPER, network.state_dict())
    results = [
        evaluate(each, small_dataset.data_dir, "3x3", splits=["test"]) for each in (loaded, own)
    ]
    assert (results[0].way, results[0].image_size) == ("steps", 600)
    first, second = (each.splits["test"].episodes for each in results)
    assert np.array_equal(first.outcomes, second.outcomes)
    assert np.array_equal(first.moves, second.moves)


@pytest.mark.parametrize("config", ["3x3", "3x4"])
def test_a_loaded_policy_is_told_the_size_of_the_labyrinths(
    config: str, tmp_path: Path, datasets: Path, small_dataset: Any
) -> None:
    source = small_dataset.data_dir if config == "3x3" else datasets
    mapper = replace(MAPPER, network=replace(MAPPER.network, height=5, width=5))
    loaded = load_policy(lay_out_run(tmp_path / "mapper", mapper))
    with pytest.MonkeyPatch.context() as patch:
        sizes: list[tuple[int, int]] = []
        act = type(loaded).act
        patch.setattr(type(loaded), "act", lambda *a: sizes.append(a[0].size) or act(*a))
        results = evaluate(loaded, source, config, splits=["test"])
    assert results.image_size == 600
    assert set(sizes) == {tuple(map(int, config.split("x")))}
    assert loaded.size == (5, 5)


def test_a_planner_is_shown_cells_of_as_many_pixels_as_it_was_trained_on(
    datasets: Path, small_dataset: Any
) -> None:
    policy = load_policy(RELEASED)
    assert [policy.image_size(*each) for each in ((5, 5), (10, 10), (3, 3))] == [64, 128, 38]
    assert evaluate(policy, small_dataset.data_dir, "3x3", splits=["test"]).image_size == 38
    check_not_shown(policy, datasets, "3x4", "the policy is a planner with grid_prior=true, which")
    told = "needs image_size=38 at 3x3, but is shown image_size=64"
    check_not_shown(policy, small_dataset.data_dir, "3x3", told, image_size=64)
    told = r"the policy asks for image_size=1280 at 100x100: a whole number of pixels from 1 to 600"
    with pytest.raises(AssertionError, match=told):
        check_policy(policy, height=100, width=100)


def check_not_shown(policy: Any, source: Path, config: str, message: str, **options: Any) -> None:
    with pytest.raises(PolicyError, match=message) as caught:
        evaluate(policy, source, config, splits=["test"], **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("task", list(Task))
@pytest.mark.parametrize("trained_on", [(3, 4), (4, 3), (3, 3)])
def test_a_policy_of_vectors_is_shown_those_that_it_was_trained_on_or_none(
    trained_on: tuple[int, int], task: Task, tmp_path: Path, datasets: Path
) -> None:
    spec = PolicySpec(NetworkSpec("mlp", *trained_on, "icy_floor"), average=False)
    policy = load_policy(lay_out_run(tmp_path / "run", spec))
    config = CONFIGS[task]
    if trained_on == (3, 4) and task is not Task.KEY_AND_DOOR:
        assert evaluate(policy, datasets, config, splits=["test"]).observation == "vector"
        assert compare(policy, policy, datasets, config, most=1).labyrinths == 1
        return
    told = f"the policy needs vectors of .*, icy_floor: those of 3x4, {task}, have another layout"
    check_not_shown(policy, datasets, config, told)
    with pytest.raises(PolicyError, match=told):
        compare(policy, policy, datasets, config)


@pytest.mark.parametrize(
    ("protocol", "resize"), [("default", "area"), ("paper", "original"), ("authors", "original")]
)
def test_the_policy_of_a_run_is_shown_the_pictures_of_its_protocol(
    protocol: str, resize: str, tmp_path: Path, small_dataset: Any
) -> None:
    spec = PolicySpec(NetworkSpec("cnn", 3, 3, "navigation"), average=False)
    run = load_policy(lay_out_run(tmp_path / "run", spec, protocol=protocol))
    assert run.spec == replace(spec, resize=resize)
    written(run.spec, tmp_path)
    for policy in (run, load_policy(tmp_path)):
        shown: set[bytes] = set()
        policy.network.register_forward_pre_hook(
            lambda _, given, shown=shown: shown.update(each.numpy().tobytes() for each in given[0])
        )
        evaluate(policy, small_dataset.data_dir, "3x3", splits=["test"])
        arrays = load_arrays(small_dataset.data_dir, "3x3", "test", resize=resize)
        assert shown == {each.tobytes() for each in arrays.observations[~arrays.terminal]}


def test_a_mapper_predicts_in_episodes_that_begin_at_different_steps_as_it_acts_in_each(
    tmp_path: Path,
) -> None:
    network, seeded = written(MAPPER, tmp_path), torch.Generator().manual_seed(0)
    for weights in network.parameters():
        torch.nn.init.normal_(weights, generator=seeded)
    save_file(network.state_dict(), tmp_path / PolicySpec.WEIGHTS)
    policy, rng = load_policy(tmp_path), np.random.default_rng(0)
    episodes = []  # Of each the first flag, the picture and the action in each state.
    for _ in range(3):
        labyrinth = sample_labyrinth(3, 3, Task.NAVIGATION, rng)
        states = labyrinth.replay(shortest_route(labyrinth, rng)).states
        pictures = [render(labyrinth, each) for each in states]
        policy.reset(1)
        actions = [policy.act(each[None])[0] for each in pictures]
        episodes.append(list(zip([True] + [False] * len(states), pictures, actions, strict=False)))
    first, second, third = episodes
    state = stale = None
    differ = 0
    for both in zip(first + second, second + third, strict=False):
        starts, seen, expected = map(np.array, zip(*both, strict=True))
        actions, state = policy.predict(seen, state=state, episode_start=starts, deterministic=True)
        assert actions.tolist() == expected.tolist()
        actions, stale = policy.predict(seen, stale)
        differ += (actions != expected).sum()
    assert differ, "the plan of one labyrinth must not do for the next"


def test_a_policy_that_is_shown_something_else_says_what_it_looks_at(
    released: Path, small_dataset: Any
) -> None:
    policy = load_policy(released)
    for shown in ("vector", "text"):
        with pytest.raises(PolicyError) as caught:
            evaluate(policy, small_dataset.data_dir, "3x3", observation=shown, splits=["test"])
        told = f"the policy needs observation=image, but is shown {shown}"
        assert str(caught.value) == told
    pictures = np.zeros((1, 64, 64, 3), np.float32)
    for shown, said in ((pictures, "an array of float32, not uint8"), (torch.ones(1), "Tensor")):
        with pytest.raises(PolicyError, match=f"needs observation=image, but is shown {said}$"):
            policy(shown)


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        ("kind", "pickle", "kind is 'pickle', not 'labyrinth-policy'"),
        ("format", 2, "format is 2, not 1"),
        ("observation", "vector", "observation is 'vector', not 'image'"),
        ("network.encoder", "transformer", "network.encoder is 'transformer', not one of cnn"),
        ("network.encoder", "cnn", "it has planner, which is unknown"),
        ("network.height", 10**9, "network.height is 1000000000, not a number from 2 to"),
        ("network.task", "__import__('os')", "network.task is \"__import__('os')\", not one"),
        ("network.code", "x", "network has code, which is unknown"),
        ("average", 1, "it.average is 1, not true or false"),
        ("resize", "nearest", "resize is 'nearest', not one of area, original"),
        ("resize", [], "resize is [], not one of area, original"),
        ("planner", None, "planner is None, not an object with path_prior, "),
        ("planner.channels", 10**6, "planner.channels is 1000000, not a number from 1 to"),
        ("planner.iterations", 1.5, "planner.iterations is 1.5, not a whole number"),
        ("planner.sharpness", float("nan"), "NaN is not a JSON number"),
        ("planner.grid_prior", "yes", "planner.grid_prior is 'yes', not true or false"),
        ("auto_map", {"AutoModel": "evil.py"}, "it has auto_map, which is unknown"),
    ],
)
def test_a_description_with_a_wrong_value_is_refused_in_one_line(
    released: Path, place: str, value: Any, message: str
) -> None:
    content = RELEASED_SPEC.to_json()
    *way, last = place.split(".")
    reduce(dict.__getitem__, way, content)[last] = value
    (released / PolicySpec.FILE).write_text(json.dumps(content), encoding="utf-8")
    check_refused(released, f"{released / PolicySpec.FILE} describes no policy: {message}")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"mapper": {"channels": 4, "looks": 65}}, "mapper.looks is 65, not a number from 1 to"),
        ({"mapper": None}, "mapper is None, not an object with channels, looks"),
        ({"image_size": 64}, "image_size is 64, not 600"),
        ({"average": True}, "average is True, but a mapper does not average over symmetries"),
    ],
)
def test_a_mapper_with_a_wrong_value_is_refused_in_one_line(
    tmp_path: Path, changed: dict[str, Any], message: str
) -> None:
    (tmp_path / PolicySpec.FILE).write_text(
        json.dumps(MAPPER.to_json() | changed), encoding="utf-8"
    )
    check_refused(tmp_path, f"{tmp_path / PolicySpec.FILE} describes no policy: {message}")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"[]", "describes no policy: it is [], not an object with network, "),
        (b"\xff", "describes no policy: "),
        (b"[" * 60_000, "describes no policy: "),
        (b" " * 70_000, "has 70,000 bytes, more than 65,536"),
    ],
)
def test_a_description_that_is_none_is_refused_in_one_line(
    released: Path, content: bytes, message: str
) -> None:
    (released / PolicySpec.FILE).write_bytes(content)
    check_refused(released, f"{released / PolicySpec.FILE} {message}")


class Evil:
    """What a pickle of it would do, if it were loaded."""

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path("evil").touch, ())


def test_weights_that_are_none_or_of_another_network_are_refused_in_one_line(
    released: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(released)
    path = released / PolicySpec.WEIGHTS
    right = load_file(path)
    name = sorted(right)[0]

    path.write_bytes(pickle.dumps(Evil()))
    check_refused(released, f"{path} holds no weights: ")
    torch.save({name: Evil()}, path)
    check_refused(released, f"{path} holds no weights: ")
    assert not (released / "evil").exists()
    path.write_bytes((2**63).to_bytes(8, "little") + b"{}")
    check_refused(released, f"{path} holds no weights: ")
    with path.open("wb") as file:
        file.truncate(268_435_457)
    check_refused(released, f"{path} has 268,435,457 bytes, more than 268,435,456")
    path.unlink()
    check_refused(released, f"{path} does not exist: the folder holds no policy")

    of_another = f"{path} is of another network: "
    save_file({each: right[each] for each in right if each != name}, path)
    check_refused(released, f"{of_another}{name} is absent, not float32 of shape ")
    save_file({**right, "zzz": torch.zeros(1)}, path)
    check_refused(released, f"{of_another}zzz is float32 of shape (1,), not absent")
    save_file({**right, name: right[name].double()}, path)
    check_refused(released, f"{of_another}{name} is float64 of shape ")


def test_no_memory_is_taken_for_weights_that_a_description_only_claims(released: Path) -> None:
    most = NetworkSpec("mlp", 1000, 1000, "key_and_door")  # 41 gigabytes.
    huge = replace(RELEASED_SPEC, network=most, average=False, own=None)
    (released / PolicySpec.FILE).write_text(json.dumps(huge.to_json()), encoding="utf-8")
    check_refused(
        released, f"{released / PolicySpec.WEIGHTS} is of another network: classifier.0.bias is "
    )


@pytest.fixture
def other_defaults() -> Iterator[None]:
    """PyTorch as another library leaves it that changes what new tensors are."""
    torch.set_default_dtype(torch.float64)
    torch.set_default_device("meta")  # Any number on it that is needed raises an error.
    yield
    torch.set_default_device(None)
    torch.set_default_dtype(torch.float32)


AT_3X3 = [
    PolicySpec(replace(spec.network, height=3, width=3, task="navigation"), spec.average, spec.own)
    for spec in [*SPECS, RELEASED_SPEC, MAPPER]
    if spec.network.encoder != "resnet18"  # As the CNN, but slow.
]


@pytest.mark.parametrize("spec", AT_3X3, ids=lambda spec: spec.network.encoder)
def test_a_policy_does_not_depend_on_what_another_library_sets_in_torch(
    spec: PolicySpec, tmp_path: Path, small_dataset: Any, request: pytest.FixtureRequest
) -> None:
    written(spec, tmp_path)

    def judged() -> list[str]:
        results = evaluate(load_policy(tmp_path), small_dataset.data_dir, "3x3", splits=["test"])
        return results.splits["test"].episodes.letters

    before = judged()
    request.getfixturevalue("other_defaults")
    assert judged() == before
    assert torch.get_default_dtype() == torch.float64
    assert torch.get_default_device().type == "meta"


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
@pytest.mark.parametrize("spec", AT_3X3, ids=lambda spec: spec.network.encoder)
def test_weights_that_are_no_numbers_end_in_one_line(
    spec: PolicySpec, value: float, tmp_path: Path, small_dataset: Any
) -> None:
    network = written(spec, tmp_path)
    filled = {
        name: torch.full_like(each, value) if each.is_floating_point() else each
        for name, each in network.state_dict().items()
    }
    save_file(filled, tmp_path / PolicySpec.WEIGHTS)
    with pytest.raises(PolicyError, match=r"\A[^\n]* nan\b[^\n]*\Z"):
        evaluate(load_policy(tmp_path), small_dataset.data_dir, "3x3", splits=["test"])


@pytest.mark.parametrize(
    ("own", "average", "most"),
    [
        (PlannerSpec(False, False, True, 64, 1000, 1.0), False, 50),
        (PlannerSpec(False, False, True, 32, 1000, 1.0), True, 25),
        (PlannerSpec(False, True, True, 4, 1000, 1.0), True, 250),
        (PlannerSpec(False, False, True, 1024, 1, 1.0), True, 0),
    ],
)
def test_a_planner_that_would_compute_for_hours_is_refused(
    released: Path, own: PlannerSpec, average: bool, most: int
) -> None:
    content = replace(RELEASED_SPEC, own=own, average=average).to_json()
    (released / PolicySpec.FILE).write_text(json.dumps(content), encoding="utf-8")
    told = f"iterations is {own.iterations}: without path_prior"
    check_refused(released, f"{released / PolicySpec.FILE} describes no policy: {told}")
    with pytest.raises(ValueError, match=f"allow at most {most}, as each takes time in every pict"):
        own.require_bounded(average)
    replace(own, iterations=most).require_bounded(average)
    replace(own, path_prior=True).require_bounded(average)


def test_a_file_of_weights_is_read_where_files_cannot_be_mapped(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")  # Mapping it fails with "No such device".
    content = (RELEASED / "model.safetensors").read_bytes()
    writer = threading.Thread(target=(tmp_path / "pipe").write_bytes, args=(content,))
    writer.start()
    tensors, texts = read_tensors(tmp_path / "pipe")
    writer.join()
    assert set(texts) == {"network"}
    right = load_file(RELEASED / "model.safetensors")
    assert all(torch.equal(tensors.pop(name), each) for name, each in right.items())
    assert not tensors


def test_the_name_of_a_tensor_stays_on_one_line(released: Path) -> None:
    right = load_file(released / PolicySpec.WEIGHTS)
    save_file({**right, "a\nb" + 999 * "c": torch.zeros(1)}, released / PolicySpec.WEIGHTS)
    check_refused(released, f"{released / PolicySpec.WEIGHTS} is of another network: a\\nbccc")


def check_refused(folder: Path | str, message: str) -> None:
    with pytest.raises(DatasetError) as caught:
        load_policy(folder)
    told = str(caught.value)
    assert told.startswith(message)
    assert "\n" not in told
    assert len(told) < 500


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("no/folder/at/all", "no/folder/at/all is neither a folder nor an id such as user/pla"),
        ("user/absent", "user/absent is not a folder, and cannot be loaded from the Hub: "),
        (".", "config.json does not exist: the folder holds neither a published policy nor a run"),
    ],
)
def test_what_is_not_there_is_refused_in_one_line(
    source: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    check_refused(source, message)


def test_a_folder_has_no_revisions(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"revision=1.0.0: .* is a folder, which has no revisions"):
        load_policy(tmp_path, revision="1.0.0")


def test_without_pytorch_it_is_said_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "safetensors.torch", None)  # It imports torch.
    install = "a policy needs torch: pip install 'labyrinth-datasets[train]'"
    with pytest.raises(DatasetError, match=rf"\A{re.escape(f'{tmp_path}: {install}')}\Z"):
        load_policy(tmp_path)
