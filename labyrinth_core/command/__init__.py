"""The command `labyrinth`."""
