"""States as pictures and as vectors, exact to the last bit."""
