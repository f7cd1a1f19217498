"""Questions for vision and language models, as a config beside a dataset.

The stage `questions` writes it; `companion` tells card, release and validation of it.
"""
