"""Reading from a Hub that accepts calls and never answers ends with one line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from hub.faults import UNLIMITED
from hub.local_hub import LocalHub
from support.making import make
from support.publishing import REPO, run_script

pytestmark = pytest.mark.slow

LOAD = "lib.load_transitions('user/labyrinth', config='2x3', split='train')"
STREAM = "next(iter(lib.stream_transitions('user/labyrinth', config='2x3', split='train')))"
SHARD = "/resolve/.*parquet"
READ = """
import time
import labyrinth_core as lib

time.sleep = lambda seconds: None  # Before a call is repeated.
try:
    {}
except lib.DatasetError as error:
    print(error)
"""


@pytest.fixture(scope="module")
def hub(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalHub]:
    """Yield a Hub with a tiny dataset."""
    folder = tmp_path_factory.mktemp("hub")
    data = folder / "labyrinth"
    make(data, "2x3", labyrinths=3)
    with LocalHub(folder / "hub") as hub:
        hub.create_repo(REPO)
        for path in data.glob("2x3/*"):
            hub.commit(REPO, path.relative_to(data).as_posix(), path.read_bytes())
        yield hub


LIMITS = ("LABYRINTH_HUB_SECONDS", "HF_HUB_DOWNLOAD_TIMEOUT", "HF_HUB_ETAG_TIMEOUT")


def run(hub: LocalHub, script: str, **more: str) -> tuple[str, str]:
    """Return what a script writes to standard output and to standard error."""
    limit = dict.fromkeys(LIMITS, "1")
    done = run_script(hub, script, token="write", **limit | more)
    return done.stdout, done.stderr


@pytest.mark.parametrize(
    ("code", "effect", "path"),
    [(LOAD, "hold", "/api/datasets/"), (STREAM, "stall", SHARD)],
)
def test_reading_from_a_silent_hub_ends_with_one_line(
    hub: LocalHub, code: str, effect: str, path: str
) -> None:
    getattr(hub.faults, effect)("GET|HEAD", path, times=UNLIMITED)
    printed, _ = run(hub, READ.format(code))
    hub.faults.clear()
    assert "timed out" in printed
    assert printed.count("\n") == 1


def test_each_worker_downloads_its_row_groups_and_the_footer_alone(
    hub: LocalHub, tmp_path: Path
) -> None:
    make(tmp_path, "5x5", labyrinths=400)
    hub.create_repo("user/large")
    files = list(tmp_path.glob("5x5/*"))
    for path in files:
        hub.commit("user/large", f"5x5/{path.name}", path.read_bytes())
    count = """
from types import SimpleNamespace
import labyrinth_core as lib, sys
for number in range(4):
    worker = SimpleNamespace(id=number % 2, num_workers=2)
    sys.modules["torch.utils.data"] = SimpleNamespace(get_worker_info=lambda: worker)
    stream = lib.stream_transitions(
        "user/large", "5x5", rank=number // 2, world_size=2, shuffle={}, draw={}
    )
    print(sum(1 for _ in stream))
"""
    size = next(path.stat().st_size for path in files if path.name.startswith("train"))
    footers = 4 * (2**16 + 8)  # What Arrow reads at the end of a file.
    for shuffle in (False, 500):
        sent, counts = [], []
        for draw in (False, True):
            since = len(hub.log)
            printed, _ = run(hub, count.format(shuffle, draw))
            counts.append([int(line) for line in printed.split()])
            sent.append(sum(each.sent for each in hub.log.find("GET", SHARD, since=since)))
        assert counts[0] == counts[1]
        assert 0 not in counts[0]
        assert size < sent[0] < size + footers
        assert sent[1] < size / 5 + footers


def test_a_session_that_a_user_made_stays(hub: LocalHub) -> None:
    script = """
import labyrinth_core as lib
from huggingface_hub import get_session, set_client_factory
from huggingface_hub.utils import httpx
set_client_factory(lambda: httpx.Client(headers={"mine": "yes"}, timeout=9))
lib.load_transitions("user/labyrinth", config="2x3", split="train")
print(get_session().headers["mine"], get_session().timeout.read)
"""
    assert run(hub, script)[0] == "yes 9\n"


def test_another_limit_than_seconds_is_refused(hub: LocalHub) -> None:
    printed, _ = run(hub, READ.format(LOAD), LABYRINTH_HUB_SECONDS="soon")
    assert printed == "LABYRINTH_HUB_SECONDS=soon: give a number of seconds, such as 60\n"


@pytest.mark.parametrize("revision", ["1.0.3", "0" * 40, "refs/pr/7"])
def test_a_wrong_revision_is_told_with_those_that_there_are(hub: LocalHub, revision: str) -> None:
    hub.tag(REPO, "1.0.2")
    for code in (LOAD, STREAM):
        script = READ.format(code.replace("split=", f"revision={revision!r}, split="))
        printed, _ = run(hub, script)
        assert printed == f"user/labyrinth has no revision {revision}, it has 1.0.2, main\n"


def test_a_dataset_is_downloaded_and_evaluated_as_an_object(hub: LocalHub) -> None:
    script = """
import labyrinth_core as lib
data = lib.Dataset("user/labyrinth", "2x3")
train, first = data["train"], data["train"].filter(labyrinths=1)
print(len(train.transitions()) == train.total_steps == sum(1 for _ in train.stream()))
print(len(first.transitions()) == first.total_steps == sum(1 for _ in first.stream()))
results = lib.evaluate(lambda seen: [1] * len(seen), data, image_size=8)
print(results.fingerprint == data.fingerprint)
"""
    printed, told = run(hub, script)
    assert printed == "True\nTrue\nTrue\n", told
