"""The world of labyrinths: structures, tasks, dynamics, solver, language, pictures, environment.

It needs numpy alone (and gymnasium in `env` and `vector_env`).
"""

__version__ = "0.1.0"
