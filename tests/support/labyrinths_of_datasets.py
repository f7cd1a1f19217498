"""The datasets of the fixture `datasets`, and their labyrinths."""

from __future__ import annotations

from pathlib import Path

from labyrinth_core import load_episodes
from labyrinth_core.language import labyrinth_id, parse
from labyrinth_core.world import Task

CONFIGS = {task: "3x4" if task is Task.NAVIGATION else f"3x4-{task}" for task in Task}


def labyrinths_of(source: Path, config: str, split: str):
    """Return the labyrinths of a split by id, in order."""
    infos = dict.fromkeys(
        episode.info for episode in load_episodes(source, config, split=split, draw=True)
    )
    return {int(labyrinth_id(info), 16): parse(info) for info in infos}
