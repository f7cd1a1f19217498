"""Trained policies: their networks, and loading policies from a folder or the Hub."""
