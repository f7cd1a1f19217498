"""A set of 63-bit keys in little memory: there may be many millions of them."""

from __future__ import annotations

from array import array

_EMPTY = -1


class KeySet:
    """Whole numbers from 0 to 2**63 - 1 that are spread like hashes; 16 to 32 bytes for each.

    A Python set takes about a hundred. Slots are probed one after the other from where the low
    bits of the key point, and doubled when half of them are taken.
    """

    def __init__(self) -> None:
        self._slots = array("q", [_EMPTY]) * 1024
        self._count = 0

    def add(self, key: int) -> bool:
        """Add a key; return whether it is new."""
        slot = self._slot(key)
        if self._slots[slot] == key:
            return False
        self._slots[slot] = key
        self._count += 1
        if 2 * self._count > len(self._slots):
            self._grow()
        return True

    def _slot(self, key: int) -> int:
        """Return where a key is, or would be."""
        slots = self._slots
        last = len(slots) - 1
        slot = key & last
        while slots[slot] != _EMPTY and slots[slot] != key:
            slot = (slot + 1) & last
        return slot

    def _grow(self) -> None:
        keys = self._slots
        self._slots = array("q", [_EMPTY]) * (2 * len(keys))
        for key in keys:
            if key != _EMPTY:
                self._slots[self._slot(key)] = key
