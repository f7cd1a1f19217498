"""What all stages work with: executor, locks, console, front matter."""
