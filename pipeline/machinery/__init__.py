"""Infrastructure shared by the stages: executor, artifacts, locked folders, console."""
