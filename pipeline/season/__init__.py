"""Seasons: a test that is committed to, judged on, revealed, and verified by anyone."""
