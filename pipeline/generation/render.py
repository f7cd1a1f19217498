"""The rows of each episode: a picture of every state, with what was done in it."""

from __future__ import annotations

from collections.abc import Iterator

from labyrinth_core.language import dump
from labyrinth_core.png import encode
from labyrinth_core.renderer import PICTURE_SIZE, Painter
from labyrinth_core.rollout import Episode
from pipeline.manifest import picture_digest
from pipeline.schema import NO_ACTION, Row


def render(split: str, number: int, episodes: list[Episode]) -> Iterator[list[Row]]:
    """Yield the rows of each episode of one labyrinth.

    Args:
        split: The split it is in.
        number: Its place in the split, from 0.
        episodes: At least one, all of the same labyrinth.
    """
    painter = Painter(episodes[0].labyrinth)
    info = dump(episodes[0].labyrinth)
    for place, episode in enumerate(episodes):
        actions = [*episode.actions.tolist(), NO_ACTION]
        rewards = [*episode.rewards.tolist(), 0.0]
        rows = []
        for step, state in enumerate(episode.states):
            strips = painter.strips(state)
            rows.append(
                Row(
                    obs=encode(strips, PICTURE_SIZE),
                    obs_path=picture_name(split, number, place, step),
                    actions=actions[step],
                    rewards=rewards[step],
                    episode_starts=step == 0,
                    info=info,
                    picture_digest=picture_digest(strips),
                )
            )
        yield rows


def picture_name(split: str, number: int, episode: int, step: int) -> str:
    """Return the name of a picture: its split, labyrinth, episode and step."""
    return f"{split}-{number:06d}-{episode:03d}-{step:04d}.png"
