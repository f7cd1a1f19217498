"""Imitation learning from demonstrations: networks, methods, training, evaluation."""

from importlib.util import find_spec

from pipeline.config.errors import ConfigError

_missing = [name for name in ("matplotlib", "safetensors", "torch") if find_spec(name) is None]
if _missing:
    install = "pip install 'labyrinth-datasets[train]'"
    raise ConfigError(f"training needs {', '.join(_missing)}: {install}")
