"""Imitation learning from demonstrations: methods, the training loop, records of runs."""
