"""Decompression of LZ4 frames, which hf-xet uses for the chunks it stores.

Sources: https://github.com/lz4/lz4/blob/dev/doc/lz4_Frame_format.md and lz4_Block_format.md.
"""

from __future__ import annotations

MAGIC = b"\x04\x22\x4d\x18"
BLOCK_CHECKSUMS, CONTENT_SIZE, DICTIONARY = 0x10, 0x08, 0x01
UNCOMPRESSED = 1 << 31
MINIMUM_MATCH = 4


class Lz4Error(ValueError):
    """The bytes are not an LZ4 frame."""


def decompress(frame: bytes) -> bytes:
    """Return the content of an LZ4 frame.

    Raises:
        Lz4Error: if the frame is cut short or does not begin as one.
    """
    if frame[:4] != MAGIC:
        raise Lz4Error(f"frame begins with {frame[:4].hex()}, not {MAGIC.hex()}")
    flags = frame[4]
    position = 7 + 8 * bool(flags & CONTENT_SIZE) + 4 * bool(flags & DICTIONARY)
    content = bytearray()
    try:
        while size := int.from_bytes(frame[position : position + 4], "little"):
            position += 4
            length = size & ~UNCOMPRESSED
            block = frame[position : position + length]
            position += length + 4 * bool(flags & BLOCK_CHECKSUMS)
            if size & UNCOMPRESSED:
                content += block
            else:
                _decompress_block(block, content)
    except IndexError as error:
        raise Lz4Error(f"frame of {len(frame)} bytes is cut short") from error
    return bytes(content)


def _decompress_block(block: bytes, content: bytearray) -> None:
    """Append the content of a block to that of the blocks before it."""
    position = 0
    while position < len(block):
        token = block[position]
        literals, position = _length(block, position + 1, token >> 4)
        content += block[position : position + literals]
        position += literals
        if position >= len(block):
            return
        offset = int.from_bytes(block[position : position + 2], "little")
        match, position = _length(block, position + 2, token & 15)
        _repeat(content, offset, match + MINIMUM_MATCH)


def _length(block: bytes, position: int, nibble: int) -> tuple[int, int]:
    """Return a length that begins with four bits of a token, and where it ends."""
    length = nibble
    if nibble == 15:
        while True:
            byte = block[position]
            position += 1
            length += byte
            if byte != 255:
                break
    return length, position


def _repeat(content: bytearray, offset: int, length: int) -> None:
    """Append `length` bytes which begin `offset` before the end, and may reach into themselves."""
    start = len(content) - offset
    if offset == 0 or start < 0:
        raise Lz4Error(f"match at offset {offset}, after {len(content)} bytes")
    source = bytes(content[start : start + length])
    copies, rest = divmod(length, len(source))
    content += source * copies + source[:rest]
