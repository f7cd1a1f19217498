"""Trained policies: the form of their files, and loading them from a folder or the Hub.

Their networks are in `networks`, which needs PyTorch.
"""
