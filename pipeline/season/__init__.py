"""Seasons: secret tests. A season is committed to, judged, revealed, and verifiable by anyone."""
