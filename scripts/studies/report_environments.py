"""Tables for environments.md, from files that `compare_environments.py` wrote."""

from __future__ import annotations

from environments.variation_report import LIKE_THEIRS, columns_of
from kept_results import RESULTS

from labyrinth_core.storage import File

MORE = {
    "environment": "{name}",
    "steps": "{steps:,}",
    "reward, sd": "{reward_deviation:,.3f}",
    "two episodes: actions": "{actions[two_episodes]:.4f}",
    "trajectories": "{states[two_episodes]:.4f}",
    "first states: Manhattan": "{first_states:.4f}",
    "share of the range": "{first_states_scaled:.4f}",
}
MANY = {"environment": "{name}", "episodes": "{seeds:,}"} | {
    heading: cell for heading, cell in LIKE_THEIRS.items() if heading != "Holm"
}


def like_theirs() -> str:
    """Return the table of differences, with the original's figures in parentheses."""
    return columns_of(_kept("thousand"), LIKE_THEIRS)


def two_episodes() -> str:
    """Return the table of how much two episodes differ."""
    return columns_of(_kept("thousand"), MORE)


def many() -> str:
    """Return the table of differences over many episodes."""
    return columns_of(_kept("many"), MANY)


def _kept(name: str) -> list[dict[str, object]]:
    """Return the values of all environments in the files of a folder."""
    files = sorted((RESULTS / "environments" / name).glob("*.json"))
    return [each for path in files for each in File(path).read_json()]
