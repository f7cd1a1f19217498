"""Evaluate policies: labyrinths as arrays, episodes by look-up, scores, baselines, intervals.

`evaluate` plays a policy on a dataset's splits, and `Results` holds and checks the outcomes.
"""
