"""Networks, and what is particular to their inputs."""
