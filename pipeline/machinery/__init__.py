"""What several stages stand on: executor, artifacts, locked folders, console."""
