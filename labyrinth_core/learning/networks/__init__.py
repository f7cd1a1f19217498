"""The networks, and the symmetries of their inputs."""
