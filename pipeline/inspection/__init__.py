"""Analysis of a dataset: counts, leakage between its splits, and shift between them."""
