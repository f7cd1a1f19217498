"""The parts of `compare_environments.py`: environments, experts, summaries of episodes, report."""
