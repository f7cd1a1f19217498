"""Grid labyrinths: their structure, tasks and dynamics; sampling and solving them."""
