"""What several stages stand on: executor, locks, console, front matter, counts."""
