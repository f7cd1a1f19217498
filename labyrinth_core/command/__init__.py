"""The command `labyrinth`: sample, draw, solve, convert and play labyrinths in a terminal.

Nobody imports it; it reads and writes the formats of `language`.
"""
