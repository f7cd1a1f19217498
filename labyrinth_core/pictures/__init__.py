"""Draw states as images, and encode them as vectors; both are exact to the last bit."""
