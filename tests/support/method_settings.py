"""The settings of a method in tests."""

from __future__ import annotations

from typing import Any

from pipeline.training.methods.method import find


def settings_of(name: str, **values: Any) -> Any:
    """Return the settings of a method: those given, the others from conf/method/."""
    return find(name, values)[1]
