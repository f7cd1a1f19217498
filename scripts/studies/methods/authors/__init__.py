"""The six methods as the authors' public code has them.

    python run.py method=scripts.studies.methods.authors.bc:Method protocol=authors

Their code is the branch `early_stop` of NathanGavenski/IL-Datasets (March and April 2025). What is
here does what that code does, in a program of our own; docs/training.md lists what could not be
followed.
"""
