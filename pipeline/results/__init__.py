"""The stage `results`: evaluations of many runs as tables and a leaderboard.

Every figure follows from results files, which are checked against the dataset.
"""
