"""The way from a configuration to a published dataset, and back to (s, a, s')."""
