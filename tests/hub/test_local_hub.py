"""The Hub on loopback as a person and the real clients see it; releases test the rest."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path
from urllib.error import HTTPError

import pytest
from publishing import REPO, local_hub, run_script
from quick_python import python

from hub.card import errors_of
from hub.local_hub import SETTINGS, LocalHub

__all__ = ["local_hub"]

pytestmark = pytest.mark.slow

ATTEMPTS = """
import json, sys
from huggingface_hub import CommitOperationAdd, HfApi, hf_hub_download

api, name, results = HfApi(), sys.argv[1], {}
D = {"repo_type": "dataset"}
files = [CommitOperationAdd("a.parquet", b"content"), CommitOperationAdd("a", b"a")]

def attempt(label, call, *arguments, **options):
    try:
        call(name, *arguments, **D, **options)
        results[label] = "done"
    except Exception as error:
        status = getattr(getattr(error, "response", None), "status_code", None)
        results[label] = [type(error).__name__, status]

attempt("read", api.auth_check)
attempt("info", api.repo_info)
attempt("download", hf_hub_download, ".gitattributes")
attempt("write", api.auth_check, write=True)
attempt("create", api.create_repo)
attempt("upload", api.preupload_lfs_files, files[:1])
attempt("commit", api.create_commit, files[1:], commit_message="a")
attempt("tag", api.create_tag, tag="1.0.0")
attempt("branch", api.create_branch, branch="next")
print(json.dumps(results))
"""


def attempt(hub: LocalHub, name: str, token: str | None) -> dict[str, object]:
    """Return what came of each call that is attempted of a repository."""
    results: dict[str, object] = json.loads(run_script(hub, ATTEMPTS, name, token=token).stdout)
    return results


READS, CHANGES = ("read", "info", "download"), ("write", "upload", "commit", "tag", "branch")


@pytest.mark.parametrize(
    ("token", "reads", "changes"),
    [
        ("write", "done", "done"),
        (None, "done", ["HfHubHTTPError", 401]),
        ("read", "done", ["HfHubHTTPError", 403]),
        ("stranger", "done", ["HfHubHTTPError", 403]),
        ("rejected", ["HfHubHTTPError", 401], ["HfHubHTTPError", 401]),
    ],
)
def test_a_token_does_what_it_may(
    local_hub: LocalHub, token: str | None, reads: object, changes: object
) -> None:
    local_hub.create_repo(REPO)
    results = attempt(local_hub, REPO, token)
    create = ["HfHubHTTPError", 409] if token == "write" else changes
    assert results == (
        dict.fromkeys(READS, reads) | dict.fromkeys(CHANGES, changes) | {"create": create}
    )
    assert (len(local_hub.history(REPO)) == 2) == (token == "write")


@pytest.mark.parametrize(("token", "status"), [(None, 401), ("stranger", 404)])
def test_a_private_repository_looks_as_if_it_were_not_there(
    local_hub: LocalHub, token: str | None, status: int
) -> None:
    local_hub.create_repo(REPO, private=True)
    hidden, missing = (attempt(local_hub, name, token) for name in (REPO, "user/missing"))
    assert hidden == missing
    del hidden["create"]
    assert set(hidden) == {*READS, *CHANGES}
    assert all(result == ["RepositoryNotFoundError", status] for result in hidden.values())
    assert attempt(local_hub, REPO, "read")["download"] == "done"


@pytest.mark.parametrize(
    ("metadata", "kind", "error"),
    [
        ("license: mit\nsize_categories: [1K<n<10K]", "dataset", None),
        ("configs: [", "dataset", "while parsing"),
        ("language: 5", "dataset", '"language" must be a string or a list of strings'),
        ("size_categories: [huge]", "dataset", "must be such as 10K<n<100K"),
        (
            "configs:\n- {config_name: a, default: true, data_files: []}\n"
            "- {config_name: b, default: true, data_files: []}",
            "dataset",
            '"configs" must have at most one default',
        ),
        (
            "configs:\n- {config_name: a, data_files: [{split: a-b, path: a}]}",
            "dataset",
            "must match",
        ),
        ("sdk: static\ncolorFrom: green", "space", None),
        ("sdk: static\ncolorFrom: violet", "space", '"colorFrom" must be one of red, yellow'),
    ],
)
def test_a_card_that_the_hub_cannot_read_is_refused(
    metadata: str, kind: str, error: str | None
) -> None:
    errors = errors_of(f"---\n{metadata}\n---\n# Card", kind)
    assert len(errors) == (error is not None)
    assert error is None or error in errors[0]


def test_a_person_can_start_a_hub_make_it_fail_stop_it_and_start_it_again(tmp_path: Path) -> None:
    script = Path(__file__).parents[2] / "scripts" / "local_hub"
    command = [sys.executable, script, "--folder", tmp_path / "hub", "--user", "ada"]
    client = """
from huggingface_hub import HfApi
api = HfApi()
print(api.create_repo("ada/mazes", repo_type="dataset", exist_ok=True).repo_id)
print(api.whoami()["name"])
"""
    for time in range(2):
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        ) as process:
            try:
                assert process.stdout is not None
                lines = [process.stdout.readline() for _ in range(5)]
                exports = dict(line.split()[1].split("=") for line in lines if "export" in line)
                assert exports.keys() == {"HF_ENDPOINT", "HF_TOKEN", "HF_HUB_DISABLE_XET"}
                control = f"{exports['HF_ENDPOINT']}/__control__"
                fault = b'{"fail": {"method": "GET", "path": "/whoami"}}'
                assert urllib.request.urlopen(control, fault, timeout=10).status == 200
                with pytest.raises(HTTPError, match="400"):
                    urllib.request.urlopen(control, b'{"explode": {}}', timeout=10)
                done = subprocess.run(
                    [python(), "-c", client],
                    env={**os.environ, **SETTINGS, **exports, "HF_HOME": str(tmp_path / "home")},
                    capture_output=True,
                    text=True,
                    check=False,
                )
                assert done.stdout == "ada/mazes\n"
                assert "the Hub answers 503 on demand" in done.stderr
                process.send_signal(signal.SIGINT)
                written, _ = process.communicate(timeout=20)
            finally:
                process.kill()
        assert f"{409 if time else 200} POST   /api/repos/create (write)" in written
        assert "503 GET    /api/whoami-v2 (write)" in written
        assert written.endswith("# stopped\n")
        assert process.returncode == 0
