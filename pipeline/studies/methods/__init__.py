"""Methods to compare with, reached by `method=`, each in a module of its own."""
