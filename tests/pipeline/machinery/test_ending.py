"""What is taken for a want of memory."""

from __future__ import annotations

import pyarrow
import pytest

from pipeline.machinery.ending import lacks_memory


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        pyarrow.ArrowMemoryError("malloc of size 9 failed"),
        ImportError("x.so: failed to map segment"),
        OSError("ZSTD: Allocation error"),
    ],
    ids=["Python", "Arrow", "library", "compressor"],
)
def test_a_want_of_memory_is_known_by_the_error_or_by_its_cause(error: Exception) -> None:
    caused = ValueError("it cannot be read")
    assert not lacks_memory(caused)
    caused.__cause__ = error
    assert lacks_memory(error)
    assert lacks_memory(caused)
