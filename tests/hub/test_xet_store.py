"""Reading LZ4 frames, and what hf-xet wrote to its store."""

from __future__ import annotations

import hashlib
import time
from pathlib import Path

import hf_xet
import numpy as np
import pyarrow
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hub.lz4 import Lz4Error, decompress
from hub.xet_store import XetStore, XetStoreError

texts = st.lists(st.sampled_from([b"labyrinth ", b"goal ", b"\0" * 300, bytes(range(256))]))


@given(st.one_of(st.binary(max_size=2000), texts.map(b"".join)))
def test_what_lz4_compressed_is_what_it_was(content: bytes) -> None:
    assert decompress(pyarrow.compress(content, codec="lz4", asbytes=True)) == content


@given(st.binary(max_size=40))
def test_what_is_no_lz4_frame_is_refused(content: bytes) -> None:
    with pytest.raises(Lz4Error, match="frame begins with"):
        decompress(b"PAR1" + content)


def test_every_content_sent_to_xet_is_found_and_read(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    words = [b"labyrinth ", b"wall ", b"goal "]
    contents = [
        b"x",
        rng.bytes(300_000) + b"abc" * 100_000,
        rng.standard_normal(100_000).astype(np.float32).tobytes() + b"z",
        b"".join(words[number] for number in rng.integers(0, 3, 50_000)),
        bytes(400_000),
    ]
    store = XetStore(tmp_path)
    assert store.size() == 0
    session = hf_xet.XetSession()
    expiry = int(time.time()) + 3600
    for content in contents:
        sha256 = hashlib.sha256(content).hexdigest()
        assert store.find(sha256) is None
        with session.new_upload_commit(
            endpoint=store.url, token="token", token_expiry_unix_secs=expiry
        ) as commit:
            upload = commit.start_upload_bytes(content, sha256=hf_xet.COMPUTE_SHA256)
        file = store.find(sha256)
        assert file is not None
        assert (file.xet_hash, file.size) == (upload.result().xet_info.hash, len(content))
        assert store.read(file) == content
    assert 0 < store.size() < sum(map(len, contents))
    for xorb in (tmp_path / "xet/xorbs/xorbs").iterdir():
        xorb.unlink()
    with pytest.raises(XetStoreError, match="is not in the store"):
        store.read(file)
