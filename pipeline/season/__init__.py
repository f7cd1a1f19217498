"""Seasons: secret tests. A season is committed to, judged, revealed, and verifiable by anyone.

Its dataset follows from a secret, and is built anew whenever it is needed.
"""
