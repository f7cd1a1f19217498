"""Evaluate policies: labyrinths as arrays, episodes by look-up, scores, baselines, intervals."""
