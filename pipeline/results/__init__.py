"""Evaluations of many runs as tables."""
