"""What a dataset's splits share, how they differ, and what that is worth."""
