"""What the tests of the Hub on loopback share."""

from hub.fixture import local_hub

__all__ = ["local_hub"]
