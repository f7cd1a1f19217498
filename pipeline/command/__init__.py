"""The command line: from what was typed to the jobs of stages, their run, and its end.

Hydra and OmegaConf are used here alone; stages are loaded by name.
"""

from pipeline.command.entry import main as main
