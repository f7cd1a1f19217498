"""The format of datasets on disk, and how to load them as episodes and transitions."""
