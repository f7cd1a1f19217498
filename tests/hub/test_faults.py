"""What goes wrong on demand, and what the real clients make of it."""

from __future__ import annotations

import sys
import time
from urllib.error import HTTPError

import pytest

from hub.client import CARD, PRELUDE, RELEASE, REPO, control, killing, release, run
from hub.faults import Rule
from hub.local_hub import LocalHub

pytestmark = pytest.mark.slow


def test_a_commit_on_a_head_that_moved_is_refused(local_hub: LocalHub) -> None:
    local_hub.create_repo(REPO)
    base = local_hub.refs(REPO)["refs/heads/main"]
    local_hub.faults.move_head()
    script = 'attempt("commit", commit, add("a.txt", b"a"), parent_commit=sys.argv[1])'
    assert run(local_hub, script, base)["commit"] == ["HfHubHTTPError", 412]
    assert set(local_hub.tree(REPO)) == {".gitattributes", "NEWS.md"}
    moved = local_hub.commit(REPO, "NEWS.md", b"more")
    assert run(local_hub, script, moved.oid)["commit"] == local_hub.refs(REPO)["refs/heads/main"]


def test_calls_that_the_client_repeats_succeed_and_others_fail(local_hub: LocalHub) -> None:
    local_hub.create_repo(REPO)
    control(local_hub, fail={"method": "POST", "path": "/preupload/", "status": 503})
    control(local_hub, fail={"method": "POST", "path": "/tag/", "status": 429, "retry_after": 0})
    local_hub.faults.fail("GET", "/xet-write-token/", times=2)
    local_hub.faults.fail("POST", "/commit/")
    local_hub.faults.lose_response("POST", "/commit/", skip=1)
    local_hub.faults.lose_response("POST", "/commit/", skip=2, status=504)
    local_hub.faults.occupy_tag()
    script = """
api.preupload_lfs_files(R, [add("a.parquet", b"content")], **D)
for name in ("fails", "lost", "timed out"):
    attempt(name, commit, add(f"{name}.txt", b"a"))
attempt("busy", api.create_tag, R, tag="1.0.0", **D)
attempt("tag", api.create_tag, R, tag="1.0.0", exist_ok=True, **D)
attempt("twice", api.create_tag, R, tag="1.0.0", **D)
"""
    assert run(local_hub, script) == {
        "fails": ["HfHubHTTPError", 503],
        "lost": ["RemoteProtocolError", None],
        "timed out": ["HfHubHTTPError", 504],
        "busy": ["HfHubHTTPError", 429],
        "tag": "done",
        "twice": ["HfHubHTTPError", 409],
    }
    assert set(local_hub.tree(REPO)) == {".gitattributes", "lost.txt", "timed out.txt"}
    assert set(local_hub.tree(REPO, "1.0.0")) == {".gitattributes"}
    statuses = [exchange.status for exchange in local_hub.log.find("POST", "/preupload/")]
    assert statuses == [503, 200, 200, 200, 200]
    assert [exchange.status for exchange in local_hub.log.find("POST", "/commit/")] == [503, 0, 504]


def test_a_hub_that_breaks_after_a_call_leaves_the_client_its_cache(local_hub: LocalHub) -> None:
    local_hub.create_repo(REPO)
    local_hub.faults.break_after("GET", "/resolve-cache/")
    home = local_hub.folder / "kept"
    script = """
attempt("first", hf_hub_download, R, ".gitattributes", **D)
attempt("stale", hf_hub_download, R, ".gitattributes", **D)
attempt("info", api.repo_info, R, **D)
"""
    results = run(local_hub, script, home=home)
    assert results["stale"] == results["first"]
    assert results["info"] == ["HfHubHTTPError", 500]
    control(local_hub, set_broken={"broken": False})
    assert run(local_hub, script)["info"] == "done"


def kill_release(hub: LocalHub, rule: Rule, seconds: float = 0.0) -> None:
    """Release in a process that is killed some time after a fault has struck."""
    script = f"{PRELUDE}{RELEASE}\nrelease((1, 2, 3), {CARD!r})"
    with killing([sys.executable, "-c", script], env=hub.env()):
        assert rule.reached.wait(60)
        time.sleep(seconds)
    hub.faults.release()
    hub.wait_until_quiet()


@pytest.mark.parametrize(
    ("local_hub", "path", "after"),
    [
        ("xet", "/xet-write-token/", False),
        ("lfs-basic", "/verify", False),
        ("lfs-multipart", "/complete-multipart/", False),
        ("xet", "/commit/", False),
        ("xet", "/commit/", True),
    ],
    indirect=["local_hub"],
)
def test_a_release_that_is_killed_is_all_there_or_not_at_all(
    local_hub: LocalHub, path: str, after: bool
) -> None:
    local_hub.create_repo(REPO)
    held = local_hub.faults.hold("GET|POST", path, after=after)
    kill_release(local_hub, held)
    assert len(local_hub.tree(REPO)) == (5 if after else 1)
    assert local_hub.log.find(path=path)[0].status == 0
    released = release(local_hub)
    assert len(local_hub.tree(REPO, released["oid"])) == 5
    assert len(local_hub.history(REPO)) == 2


def test_an_upload_that_is_killed_half_way_is_not_stored(local_hub: LocalHub) -> None:
    local_hub.restart("lfs-basic")
    local_hub.create_repo(REPO)
    local_hub.faults.slow_put(seconds=0.02, chunk=256)
    kill_release(local_hub, local_hub.faults.delay("PUT", "^/lfs/", seconds=0.0), seconds=0.1)
    (put,) = local_hub.log.find("PUT")
    assert put.status == 0
    assert put.received < 60_000
    local_hub.faults.clear()
    sent = len(local_hub.log)
    release(local_hub)
    assert len(local_hub.log.uploaded(since=sent)) == 3


def test_an_unknown_fault_or_token_is_told_from_those_that_are_known(local_hub: LocalHub) -> None:
    with pytest.raises(HTTPError, match="400"):
        control(local_hub, explode={})
    with pytest.raises(HTTPError, match="400"):
        control(local_hub, fail={"wrong": 1})
    with pytest.raises(ValueError, match="allowed are write, read, stranger, rejected and None"):
        local_hub.env(token="admin")
    with pytest.raises(ValueError, match="allowed are xet, lfs-basic, lfs-multipart"):
        local_hub.restart("ftp")
