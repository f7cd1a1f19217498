"""Analysis of a dataset: counts, leakage between its splits, and shift between them.

Card, report and validation read its statistics, and the companions and front matter of datasets.
"""
