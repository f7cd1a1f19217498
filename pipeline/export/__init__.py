"""A dataset written in the formats of other libraries, for their own loaders to read."""
