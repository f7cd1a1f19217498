"""Reading from a Hub that accepts calls and never answers: each ends, and says so."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator

import pytest
from hub.faults import UNLIMITED
from hub.local_hub import LocalHub
from making import make
from publishing import REPO, environment

from pipeline.release.card import write_card

pytestmark = pytest.mark.slow

LOAD = "lib.load_transitions('user/labyrinth', config='2x3', split='train')"
STREAM = "next(iter(lib.stream_transitions('user/labyrinth', config='2x3', split='train')))"
POLICY = "lib.load_policy('user/labyrinth')"
RESOLVE, SHARD = "/resolve/", "/resolve/.*parquet"
READ = """
import labyrinth_core as lib
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
    write_card(data)
    with LocalHub(folder / "hub") as hub:
        hub.create_repo(REPO)
        for path in (data / "README.md", *data.glob("2x3/*")):
            hub.commit(REPO, path.relative_to(data).as_posix(), path.read_bytes())
        yield hub


def run(hub: LocalHub, script: str, **more: str) -> tuple[str, str]:
    """Return what a script writes to standard output and to standard error."""
    variables = environment(hub, **{"LABYRINTH_HUB_SECONDS": "1", **more})
    done = subprocess.run(
        [sys.executable, "-c", script], env=variables, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


@pytest.mark.parametrize(
    ("code", "effect", "path"),
    [
        (LOAD, "hold", "/api/datasets/"),
        (LOAD, "hold", RESOLVE),
        (LOAD, "hold", SHARD),
        (LOAD, "stall", SHARD),
        (STREAM, "hold", "/api/datasets/"),
        (STREAM, "hold", SHARD),
        (STREAM, "stall", SHARD),
        (POLICY, "hold", RESOLVE),
    ],
)
def test_reading_from_a_silent_hub_ends_with_one_line(
    hub: LocalHub, code: str, effect: str, path: str
) -> None:
    getattr(hub.faults, effect)("GET|HEAD", path, times=UNLIMITED)
    printed, notices = run(hub, READ.format(code))
    hub.faults.clear()
    assert re.search(r": the Hub sent nothing for 1 seconds, twice: \w+ http\S+\n$", printed)
    assert printed.count("\n") == 1
    assert "waiting for the Hub: " in notices


def test_a_reader_that_takes_its_time_is_not_told_that_the_hub_is_silent(hub: LocalHub) -> None:
    script = """
import time, labyrinth_core.data.hub as ours
from huggingface_hub import HfApi
from huggingface_hub.utils import get_session
ours.limit_silence()
with get_session().stream("GET", HfApi().endpoint + "/api/whoami-v2") as response:
    time.sleep(1.5)
    print(len(response.read()) > 0)
"""
    assert run(hub, script) == ("True\n", "")


def test_a_session_that_a_user_made_stays(hub: LocalHub) -> None:
    script = """
import labyrinth_core as lib
from huggingface_hub import get_session, set_client_factory
from huggingface_hub.utils import httpx
set_client_factory(lambda: httpx.Client(headers={"mine": "yes"}))
lib.load_transitions("user/labyrinth", config="2x3", split="train")
print(get_session().headers["mine"])
"""
    assert run(hub, script)[0] == "yes\n"


def test_another_limit_than_seconds_is_refused(hub: LocalHub) -> None:
    printed, _ = run(hub, READ.format(LOAD), LABYRINTH_HUB_SECONDS="soon")
    assert printed == "LABYRINTH_HUB_SECONDS=soon: give a number of seconds, such as 60\n"
