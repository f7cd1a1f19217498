r"""The six methods as implemented in the authors' public code.

    python run.py protocol=authors method=custom \
        method._target_=scripts.studies.methods.authors.bc.Method

The authors' code is the branch `early_stop` of NathanGavenski/IL-Datasets (March and April 2025).
The modules here reimplement its behaviour; docs/training.md lists the differences that could not be
avoided.
"""
