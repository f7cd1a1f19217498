"""Datasets on disk or on the Hub: their format, and reading them as arrays, episodes and streams.

`Dataset` finds a dataset, checks each file before it is used, and gives rows by its selections.
"""
