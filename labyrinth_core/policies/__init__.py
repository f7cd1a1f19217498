"""Trained policies: their networks, and loading one from a folder or from the Hub."""
