"""What goes wrong while publishing: it is done again, or told in one line, and nothing is lost."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from hub.faults import UNLIMITED
from hub.local_hub import LocalHub
from hub.state import ID_TOKEN
from support.publishing import (
    REPO,
    built,
    changes,
    environment,
    error_of,
    held,
    last_line,
    publish,
    published,
    publishing,
    run_python,
    run_script,
)
from support.quick_python import python

from pipeline.release.faults import PublishError
from pipeline.release.verify import loaded

pytestmark = pytest.mark.slow

R = "/api/datasets/user/labyrinth"
WRITING = [
    ("GET", f"{R}$"),
    ("POST", "/repos/create"),
    ("GET", f"{R}/revision/main"),
    ("GET", f"{R}/tree/"),
    ("POST", "/preupload/"),
    ("POST", "/objects/batch"),
    ("PUT", "^/lfs/"),
    ("POST", "/lfs/verify"),
    ("POST", "/validate-yaml"),
    ("POST", "/commit/"),
    ("GET", f"{R}/refs"),
    ("POST", "/tag/"),
]
READING = [
    ("HEAD", "/resolve/.*README.md"),
    ("GET", "/resolve/.*README.md"),
    ("GET", f"{R}/revision/"),
    ("GET", f"{R}/tree/.*/2x3"),
    ("HEAD", "/resolve/.*parquet"),
    ("GET", "/resolve/.*parquet"),
]
"""The calls of the verification."""


def test_a_fault_of_each_call_that_writes_is_got_over_in_a_private_release(
    local_hub: LocalHub, releasable: Path
) -> None:
    rules = [local_hub.faults.fail(*call) for call in WRITING]
    published(local_hub, releasable, "1.0.0", "publish.private=true", verify=True)
    assert local_hub.is_private(REPO)
    assert [rule for rule in rules if not rule.reached.is_set()] == []
    assert held(local_hub, "1.0.0") == held(local_hub) == built(releasable)
    assert len(local_hub.history(REPO)) == 2


def test_a_fault_of_each_call_that_reads_is_got_over(
    released_hub: LocalHub, released: Path
) -> None:
    commit = released_hub.refs(REPO)["refs/tags/1.0.0"]
    rules = [released_hub.faults.drop(*call) for call in READING[1::2]]
    rules += [released_hub.faults.fail(*call) for call in READING[::2]]
    arguments = (REPO, commit, released)
    done = run_python(released_hub, "-m", "pipeline.release.verify", *arguments, USE_TORCH="0")
    assert done.returncode == 0, done.stderr
    *progress, verdict = done.stdout.splitlines()
    assert verdict == "every config loads"
    assert progress[-1] == "2x3-labyrinths, streaming labyrinths"
    assert [rule for rule in rules if not rule.reached.is_set()] == []


def test_a_fault_that_stays_is_told_in_one_line_and_the_rerun_completes(
    local_hub: LocalHub, releasable: Path
) -> None:
    local_hub.create_repo(REPO)
    for method, path, status, landed, message in (
        ("POST", "/commit/", 400, False, "the Hub answers 400: "),
        ("GET", f"{R}/revision/[0-9a-f]{{40}}", 503, True, "not tagged: the Hub answers 503: "),
    ):
        local_hub.faults.fail(method, path, status=status, times=UNLIMITED)
        assert message in error_of(publish(local_hub, releasable, verify=landed))
        assert held(local_hub) == (built(releasable) if landed else {})
        assert local_hub.refs(REPO).keys() == {"refs/heads/main"}
        local_hub.faults.clear()
    assert "tagged 1.0.0" in published(local_hub, releasable, verify=True)
    assert held(local_hub) == built(releasable)
    assert len(local_hub.history(REPO)) == 2


def test_a_hub_that_falls_silent_in_the_verification_is_given_up(
    released_hub: LocalHub, released: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    commit = released_hub.refs(REPO)["refs/tags/1.0.0"]
    rule = released_hub.faults.hold("GET|HEAD", "/resolve/.*parquet", times=UNLIMITED)
    for name, value in environment(released_hub).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "executable", python())  # The patience begins when it starts.
    with pytest.raises(PublishError) as caught:
        loaded(REPO, "dataset", released, commit, patience=3)
    assert rule.reached.is_set()
    assert str(caught.value) == (
        f"the verification of {commit[:12]} failed, so it is not tagged: nothing came from the Hub "
        "in 3 seconds, waiting for 2x3-labyrinths"
    )


@pytest.mark.parametrize(
    ("method", "path", "times"),
    [
        ("GET", f"{R}$", 5),  # Repeated by us.
        ("POST", "/commit/", 5),  # By us, after a look at the branch.
    ],
    ids=lambda part: str(part).strip("/"),
)
def test_a_call_that_is_never_answered_ends_with_one_line(
    local_hub: LocalHub, releasable: Path, method: str, path: str, times: int
) -> None:
    rule = local_hub.faults.hold(method, path, times=UNLIMITED)
    done = publish(local_hub, releasable, seconds="0.5")
    assert UNLIMITED - rule.times == times
    told = f"{local_hub.url} does not answer as it should: timed out (tried {times} times in "
    assert error_of(done).startswith(told)


@pytest.mark.parametrize("silent", [False, True], ids=["dropped", "silent"])
def test_a_commit_whose_answer_is_lost_is_found_and_made_once(
    local_hub: LocalHub, releasable: Path, silent: bool
) -> None:
    if silent:  # What is sent once more is then refused, as the branch has moved.
        local_hub.faults.hold("POST", "/commit/", after=True)
    else:
        local_hub.faults.lose_response("POST", "/commit/")
    done = publish(local_hub, releasable, seconds="0.5")
    assert "tagged 1.0.0" in done.stdout
    assert held(local_hub, "1.0.0") == held(local_hub) == built(releasable)
    assert len(local_hub.history(REPO)) == 2


def test_somebody_elses_commit_in_between_is_told_and_never_lost(
    local_hub: LocalHub, releasable: Path
) -> None:
    local_hub.create_repo(REPO)
    rule = local_hub.faults.hold("POST", "/commit/")
    with publishing(local_hub, releasable, until=rule) as process:
        theirs = local_hub.commit(REPO)
        local_hub.faults.release()
        error = last_line(process)
    assert error.startswith(f"error: {REPO} got another commit meanwhile")
    assert process.returncode == 1
    assert local_hub.history(REPO)[0] == theirs
    assert local_hub.log.find("POST", "/commit/", 412)
    published(local_hub, releasable)
    tree = held(local_hub, "1.0.0")
    assert tree.pop("NEWS.md") == theirs.tree["NEWS.md"].sha256
    assert tree == built(releasable)


def test_a_tag_that_another_sets_meanwhile_is_never_moved(
    local_hub: LocalHub, releasable: Path
) -> None:
    local_hub.create_repo(REPO)
    first = local_hub.refs(REPO)["refs/heads/main"]
    local_hub.faults.occupy_tag()
    error = error_of(publish(local_hub, releasable))
    commit = local_hub.refs(REPO)["refs/heads/main"]
    assert f"points to {first[:12]}, not to the release at {commit[:12]}" in error
    assert error.endswith("choose another publish.version")
    assert held(local_hub) == built(releasable)
    assert local_hub.refs(REPO)["refs/tags/1.0.0"] == first


UNSEEN = (
    "{} does not exist, or this token may not see it, and the token may not create it: use another "
    "token, or create it empty on the Hub, and publish again"
)


@pytest.mark.parametrize(
    ("token", "repo", "exists", "message"),
    [
        (None, REPO, True, "there is no Hub token: set HF_TOKEN, or run `hf auth login`, which "),
        ("rejected", REPO, True, "the Hub rejects the token: make a new one"),
        ("read", REPO, True, f"the token may not write to {REPO}: use one with write access"),
        ("rejected", REPO, False, "the Hub rejects the token: make a new one"),
        ("read", REPO, False, UNSEEN),
        ("write", "stranger/labyrinth", True, UNSEEN),
    ],
)
def test_a_token_that_does_not_do_has_its_own_line(
    local_hub: LocalHub, releasable: Path, token: str | None, repo: str, exists: bool, message: str
) -> None:
    if exists:
        local_hub.create_repo(repo, private=repo != REPO)
    before = built(releasable)
    done = publish(local_hub, releasable, token=token, repo=repo)
    assert error_of(done).startswith(message.format(repo))
    assert len(done.stderr.splitlines()) == 1
    assert [call.path for call in changes(local_hub)] == ["/api/repos/create"] * (message == UNSEEN)
    assert local_hub.has(repo) == exists
    assert built(releasable) == before


def test_a_token_for_one_repository_releases_there_alone(
    local_hub: LocalHub, releasable: Path
) -> None:
    def job(repo: str = REPO, **more: str) -> subprocess.CompletedProcess[str]:
        resource = {"HF_OIDC_RESOURCE": f"datasets/{REPO}"} | more
        return publish(local_hub, releasable, token=None, repo=repo, verify=True, **resource)

    no_token = f"HF_OIDC_RESOURCE=datasets/{REPO}: the Hub gives this job no token: "
    assert error_of(job()).startswith(f"{no_token}HF_OIDC_RESOURCE is set but no OIDC id token")
    assert error_of(job(HF_OIDC_ID_TOKEN=ID_TOKEN)).startswith(f"{no_token}Bad request: ")
    local_hub.create_repo(REPO)
    done = job(HF_OIDC_ID_TOKEN=ID_TOKEN)
    assert done.returncode == 0, done.stderr
    assert held(local_hub, "1.0.0") == held(local_hub) == built(releasable)
    assert {call.token for call in changes(local_hub)} == {"none", "one repository"}
    asked = len(local_hub.log)
    local_hub.create_repo("user/other")
    error = error_of(job("user/other", HF_OIDC_ID_TOKEN=ID_TOKEN))
    assert error.startswith("the token may not write to user/other")
    assert {call.path for call in changes(local_hub, asked)} == {"/oauth/token"}
    error = error_of(job("user/new", HF_OIDC_ID_TOKEN=ID_TOKEN))
    assert error == UNSEEN.format("user/new")


@pytest.mark.parametrize("status", [429, 503])
def test_a_list_of_files_that_the_hub_does_not_give_is_not_taken_for_missing(
    released_hub: LocalHub, other_shard: Path, status: int
) -> None:
    before = held(released_hub)
    released_hub.faults.fail("GET|HEAD", "/resolve/.*SHA256SUMS", status=status, times=UNLIMITED)
    error = error_of(publish(released_hub, other_shard, "1.1.0"))
    assert error.startswith(f"the Hub answers {status}: ")
    assert held(released_hub) == before
    released_hub.faults.clear()
    published(released_hub, other_shard, "1.1.0")
    assert held(released_hub, "1.1.0") == built(other_shard)


@pytest.mark.parametrize("token", ["hf_secret\x07", "hf_sécret"])
def test_a_token_that_cannot_be_sent_is_never_printed(
    local_hub: LocalHub, releasable: Path, token: str
) -> None:
    done = publish(local_hub, releasable, "1.0.0", HF_TOKEN=token)
    load = f"from labyrinth_core import load_arrays; load_arrays({REPO!r}, '5x5', 'test')"
    loading = run_python(local_hub, "-c", load, HF_TOKEN=token)
    for ended in done, loading:
        assert ended.returncode == 1
        assert "the Hub token is malformed" in ended.stderr.splitlines()[-1]
        assert "cret" not in ended.stdout + ended.stderr
    assert error_of(done).startswith("the Hub token is malformed")
    assert len(local_hub.log) == 0


WARM = """
import sys
from datasets import load_dataset
from huggingface_hub import hf_hub_download
for split in ("train", "validation", "test", "random", "s0", "s0_and_g"):
    load_dataset(sys.argv[1], "2x3", split=split, revision=sys.argv[2])
hf_hub_download(sys.argv[1], "2x3/manifest.json", repo_type="dataset", revision=sys.argv[2])
print(load_dataset(sys.argv[1], "2x3", split="test", revision=sys.argv[2]).num_rows)
"""


def test_a_stale_cache_is_never_taken_for_a_verification(
    local_hub: LocalHub, releasable: Path, tmp_path: Path
) -> None:
    home = str(tmp_path / "home")
    caches = {"HF_HOME": home, "HF_HUB_CACHE": f"{home}/hub", "HF_DATASETS_CACHE": f"{home}/data"}
    rule = local_hub.faults.hold("POST", "/commit/", after=True)
    with publishing(local_hub, releasable, until=rule, verify=True, **caches) as process:
        commit = local_hub.refs(REPO)["refs/heads/main"]
        for _ in range(2):  # The second time from the cache, all contents being out of reach.
            warm = run_script(local_hub, WARM, REPO, commit, USE_TORCH="0", **caches)
            assert warm.stdout == "12\n"
            local_hub.faults.fail("GET|HEAD", "/resolve", status=501, times=UNLIMITED)
        rule.released.set()
        error = last_line(process)
    failed = f"error: the verification of {commit[:12]} failed, so it is not tagged: "
    # Not only what is streamed, which comes last and is in no cache.
    assert error.startswith(f"{failed}2x3-labyrinths cannot be loaded: ")
    assert "refs/tags/1.0.0" not in local_hub.refs(REPO)
    assert held(local_hub) == built(releasable)


def test_other_bytes_than_were_sent_are_not_tagged(local_hub: LocalHub, releasable: Path) -> None:
    shard = "2x3/random-00000-of-00001.parquet"
    rule = local_hub.faults.hold("POST", "/commit/", after=True)
    with publishing(local_hub, releasable, until=rule, verify=True) as process:
        blob = local_hub.blob(built(releasable)[shard])
        blob.write_bytes(blob.read_bytes()[:-1] + b"0")
        local_hub.faults.release()
        error = last_line(process)
    assert "failed, so it is not tagged: 2x3 cannot be loaded: " in error
    assert "refs/tags/1.0.0" not in local_hub.refs(REPO)


def test_a_card_that_the_hub_refuses_is_told_in_one_line(
    local_hub: LocalHub, releasable: Path
) -> None:
    readme = releasable / "README.md"
    text = readme.read_text(encoding="utf-8")
    readme.write_text(text.replace("---\n", "---\nlanguage: 5\n", 1), encoding="utf-8")
    error = error_of(publish(local_hub, releasable))
    assert error.startswith("the Hub's client refuses: Invalid metadata in README.md")
    assert '"language" must be a string' in error
    assert held(local_hub) == {}


def test_a_damaged_shard_is_found_before_anything_is_sent(
    local_hub: LocalHub, releasable: Path
) -> None:
    shard = releasable / "2x3" / "test-00000-of-00001.parquet"
    shard.write_bytes(shard.read_bytes()[:-1])
    before = built(releasable)
    assert error_of(publish(local_hub, releasable)).startswith(f"{shard} ")
    assert changes(local_hub) == []
    assert not local_hub.has(REPO)
    assert built(releasable) == before
