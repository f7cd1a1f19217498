"""The comparison of `scripts/corpus.py`: a byte that was changed in any part is found and named."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save

from scripts import corpus, corpus_part

WEIGHTS = {"layer.weight": np.arange(6, dtype=np.float32).reshape(2, 3)}
FILES = {
    "data/plain/3x3/train-00000-of-00001.parquet": b"PAR1 rows PAR1",
    "data/plain/3x3/manifest.json": b'{"format": 3}',
    "data/plain/SHA256SUMS": b"aa  README.md\nbb  croissant.json\n",
    "data/plain/README.md": b"a card",
    "data/grown/5x5/labyrinths.parquet": b"PAR1 table PAR1",
    "loads.json": json.dumps({"plain train vector": "aa", "plain test vector": "bb"}).encode(),
    "evaluations/chance.json": b'{"splits": {"test": {"sr": [0.5, 1.0]}}}',
    "board/results.csv": b"method,sr\nbc,0.5\nplanner,1.0\n",
    "weights/bc-seed0.safetensors": save(WEIGHTS),
}
CHANGES = {
    "data/plain/3x3/train-00000-of-00001.parquet": (b"rows", b"rowt", "other bytes"),
    "data/plain/3x3/manifest.json": (b"3", b"4", "format: 4, was 3"),
    "data/plain/SHA256SUMS": (b"bb", b"bc", "other bytes"),
    "data/grown/5x5/labyrinths.parquet": (b"table", b"tablf", "other bytes"),
    "loads.json": (b"bb", b"bc", "plain test vector: bc, was bb"),
    "evaluations/chance.json": (b"0.5", b"0.6", "splits.test.sr.0: 0.6, was 0.5"),
    "board/results.csv": (b"1.0", b"1.1", "row 3 sr: 1.1, was 1.0"),
    "weights/bc-seed0.safetensors": (b"\x80\x3f", b"\x80\x3e", "layer.weight: float32(2, 3) "),
}
"""File -> bytes in it, what takes their place in the current tree, and what is said of it."""


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """A kept corpus that is the same in both trees."""
    for tree in corpus.TREES:
        for name, content in FILES.items():
            path = tmp_path / tree / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    return tmp_path


def change(kept: Path, name: str, old: bytes, new: bytes) -> None:
    path = kept / "current" / name
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new, 1))


def compared(kept: Path) -> dict[str, list[str]]:
    return {name: differ() for name, differ in corpus.parts(kept).items()}


def test_what_is_the_same_is_called_the_same(kept: Path, capsys: pytest.CaptureFixture[str]):
    assert corpus.compare(kept) == 0
    lines = capsys.readouterr().out.splitlines()
    parts = ["data/grown", "data/plain", "loads.json", "evaluations", "board", "weights"]
    assert [line.split() for line in lines] == [[part, "same"] for part in parts]


@pytest.mark.parametrize("name", CHANGES)
def test_a_byte_that_is_changed_in_a_part_is_found_and_named(kept: Path, name: str) -> None:
    old, new, said = CHANGES[name]
    change(kept, name, old, new)
    ((part, found),) = [(part, found) for part, found in compared(kept).items() if found]
    assert name.startswith(part)
    assert found[0].startswith(f"{name.removeprefix(f'{part}/')}: {said}")
    assert len(found) == 1


def test_the_text_of_the_card_and_its_sum_are_not_compared(kept: Path) -> None:
    change(kept, "data/plain/README.md", b"a card", b"another")
    change(kept, "data/plain/SHA256SUMS", b"aa", b"ab")
    assert not any(compared(kept).values())


def test_a_file_that_is_written_otherwise_differs_in_a_dataset_alone(kept: Path) -> None:
    change(kept, "data/plain/3x3/manifest.json", b": 3", b":3")
    change(kept, "evaluations/chance.json", b": {", b":{")
    found = compared(kept)
    assert found["data/plain"] == ["3x3/manifest.json: other bytes"]
    assert not found["evaluations"]


def test_what_one_tree_lacks_and_what_both_lack_differs(kept: Path) -> None:
    (kept / "current/data/plain/3x3/manifest.json").unlink()
    shutil.rmtree(kept / "base/data/grown")
    for tree in corpus.TREES:
        shutil.rmtree(kept / tree / "board")
    found = compared(kept)
    assert found["data/plain"] == ["3x3/manifest.json: only in base"]
    assert found["data/grown"] == ["5x5/labyrinths.parquet: only in current"]
    assert found["board"] == ["neither tree has made it"]


def test_the_hash_of_a_load_follows_from_values_types_and_shapes() -> None:
    value = np.arange(4)
    others = [value + 1, value.astype(np.int32), value.reshape(2, 2), np.array(list("0123"))]
    hashes = {corpus_part.digest(each) for each in [value, *others, [value, value]]}
    assert len(hashes) == 6
    texts = [np.array([f"{prefix}a"], dtype=object) for prefix in ("x", "x", "y")]
    first, second, third = map(corpus_part.digest, texts)
    assert first == second != third
    with pytest.raises(TypeError, match="has nothing that is compared"):
        corpus_part.digest(object())


PROGRAM = """
import sys
from pathlib import Path

if sys.argv[1] == "--help":
    print("  size    rows and columns{more}")
elif "size=0" in sys.argv:
    sys.exit("error: size=0")
else:
    Path("given").write_text(" ".join(sys.argv[1:]))
"""


@pytest.mark.parametrize("known", [True, False])
def test_an_option_in_brackets_is_for_trees_that_know_it(tmp_path: Path, known: bool) -> None:
    more = r"\n  grow    let it grow" if known else ""
    (tmp_path / "run.py").write_text(PROGRAM.replace("{more}", more))
    tree = corpus.Tree(tmp_path, tmp_path / "made")
    tree.run("size=5 [grow=true]")
    given = (tree.folder / "given").read_text()
    assert given == ("size=5 grow=true workers=1" if known else "size=5 workers=1")
    with pytest.raises(RuntimeError, match=r"(?s)made: .*size=0.*error: size=0"):
        tree.run("size=0")
