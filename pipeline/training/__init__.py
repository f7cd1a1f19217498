"""The stage `train`: methods that learn from demonstrations, the training loop, records of runs.

An interrupted run goes on from its checkpoint, with the same weights in the end.
"""
