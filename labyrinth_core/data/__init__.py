"""Datasets: what one is on disk, and the way back into episodes and transitions."""
