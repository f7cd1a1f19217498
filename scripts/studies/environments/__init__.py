"""What `compare_environments.py` measures: environments, their experts and episodes."""
