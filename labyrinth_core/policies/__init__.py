"""Trained policies: opening a run, a released policy, a graph or a Python object by its name.

Their networks are in `labyrinth_core.learning`.
"""
