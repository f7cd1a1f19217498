"""What several stages stand on: executor, locks, folders, files of their own, console."""
