"""Minari reads our export, and its recovered environment replays every episode."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
import pytest
from support.exporting import SIZE, episodes, export
from support.making import Run

from labyrinth_core.errors import DatasetError

CASES = [
    ("navigation", ("train", "random")),
    ("key_and_door", ("random", "s0_and_g")),
    ("partial_observability", ("test", "recoloured")),
]


@pytest.mark.slow
@pytest.mark.parametrize(("task", "splits"), CASES, ids=[task for task, _ in CASES])
def test_every_episode_replays_in_the_recovered_environment(
    build: Callable[..., Run], tmp_path, monkeypatch, task, splits
):
    import minari

    shifts = ("recoloured",) if "recoloured" in splits else ()
    run = build(tmp_path, size="3x4", task=task, labyrinths=3, shifts=shifts, random_steps=40)
    export(run, tmp_path / "exports", "minari", *splits)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "exports" / "minari"))
    for split in splits:
        dataset = minari.load_dataset(f"labyrinth/{run.dataset.name}/{split}-v0")
        environment = dataset.recover_environment()
        assert environment.observation_space == dataset.observation_space
        kept = dataset.storage.get_episode_metadata(dataset.episode_indices)
        triples = zip(dataset, kept, episodes(run, split), strict=True)
        for episode, facts, ours in triples:
            assert episode.observations.dtype == np.uint8
            assert np.array_equal(episode.observations, ours.observations)
            assert np.array_equal(episode.actions, ours.actions)
            assert np.array_equal(episode.rewards, ours.rewards)
            assert facts["options"]["labyrinth"] == ours.info
            assert (episode.terminations[-1], episode.truncations[-1]) in [(1, 0), (0, 1)]
            observation, _ = environment.reset(options=facts["options"])
            assert np.array_equal(observation, episode.observations[0])
            for step, action in enumerate(episode.actions):
                observation, reward, terminated, truncated, _ = environment.step(action)
                assert np.array_equal(observation, episode.observations[step + 1])
                assert np.float32(reward) == episode.rewards[step]
                assert (terminated, truncated) == (
                    episode.terminations[step],
                    episode.truncations[step],
                )


def test_what_minari_does_with_datasets_it_does_with_ours(
    small_dataset: Run, tmp_path, monkeypatch
):
    import minari

    folder = export(small_dataset, tmp_path, "minari", "train")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    assert list(minari.list_local_datasets()) == ["labyrinth/3x3/train-v0"]
    dataset = minari.load_dataset("labyrinth/3x3/train-v0")
    assert len(dataset) == 8
    assert "infos=dict" in repr(dataset[0])
    assert len(dataset.sample_episodes(3)) == 3
    upwards = dataset.filter_episodes(lambda episode: episode.actions[0] == 0)
    assert len(upwards) == sum(each.actions[0] == 0 for each in episodes(small_dataset, "train"))
    assert [len(part) for part in minari.split_dataset(dataset, [5, 3], seed=0)] == [5, 3]
    metadata = dataset.storage.metadata
    record = json.loads((folder / "train-v0" / "labyrinth.json").read_bytes())
    assert metadata["labyrinth"] == record
    assert record["image_size"] == SIZE
    assert metadata["author"] == {"The Labyrinth datasets developers"}
    assert metadata["licence"] == "mit"
    assert metadata["algorithm_name"] == "a shortest route"
    assert metadata["total_steps"] == record["rows"] - 8


@pytest.mark.slow
def test_episodes_that_a_user_adds_are_not_thrown_away(small_dataset: Run, tmp_path, monkeypatch):
    import minari
    from minari.data_collector import EpisodeBuffer

    folder = export(small_dataset, tmp_path, "minari", "test")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    dataset = minari.load_dataset("labyrinth/3x3/test-v0")
    ours, first = len(dataset), dataset[0]
    names = ("observations", "actions", "rewards", "terminations", "truncations", "infos")
    added = {name: getattr(first, name) for name in names}
    dataset.update_dataset_from_buffer([EpisodeBuffer(**added)])
    with pytest.raises(DatasetError, match=r"holds data/main_data\.hdf5.*damaged or changed since"):
        export(small_dataset, tmp_path, "minari", "test")
    assert len(minari.load_dataset("labyrinth/3x3/test-v0")) == ours + 1
    assert folder.is_dir()


@pytest.mark.slow
def test_the_command_line_of_minari_lists_and_shows_our_export(
    small_dataset: Run, tmp_path, monkeypatch, capsys
):
    from minari.cli import app

    export(small_dataset, tmp_path, "minari", "test")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    monkeypatch.setenv("COLUMNS", "200")
    for arguments in (["list", "local"], ["show", "labyrinth/3x3/test-v0"]):
        app(arguments, standalone_mode=False)
    listed, _, shown = capsys.readouterr().out.partition("Number of datasets: 1")
    for part in (listed, shown):
        assert "labyrinth/3x3/test-v0" in part
        assert "The Labyrinth datasets developers" in part
