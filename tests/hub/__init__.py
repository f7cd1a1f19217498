"""A Hub on loopback: a real server for the real `huggingface_hub` and `datasets` clients.

Tests take the fixture `local_hub` of `hub.fixture`; people start `scripts/local_hub`.
"""
