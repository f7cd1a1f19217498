"""Grid labyrinths: their structure, tasks and dynamics; sampling and solving them.

It imports nothing of the project, and all other rooms build on it.
"""
