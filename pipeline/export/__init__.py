"""The stage `export`: a dataset written in the formats of other libraries.

Each format is a module with a function `write`, loaded by name.
"""
