"""What each token may do with the Hub on loopback, as the real clients see it."""

from __future__ import annotations

import pytest

from hub.client import REPO, run
from hub.local_hub import LocalHub

pytestmark = pytest.mark.slow

ATTEMPTS = """
name = sys.argv[1]
attempt("whoami", api.whoami)
attempt("read", api.auth_check, name, **D)
attempt("write", api.auth_check, name, write=True, **D)
attempt("info", api.repo_info, name, **D)
attempt("create", api.create_repo, name, **D)
attempt("create again", api.create_repo, name, exist_ok=True, **D)
attempt("upload", api.preupload_lfs_files, name, [add("a.parquet", b"content")], **D)
attempt("commit", api.create_commit, name, [add("a", b"")], commit_message="a", **D)
attempt("tag", api.create_tag, name, tag="1.0.0", **D)
attempt("branch", api.create_branch, name, branch="next", **D)
attempt("download", hf_hub_download, name, ".gitattributes", **D)
if isinstance(results["download"], str):
    results["download"] = "done"
D["create_pr"] = True
attempt("propose", api.create_commit, name, [add("a", b"")], commit_message="a", **D)
"""
CHANGES = ("write", "create", "upload", "commit", "tag", "branch", "propose")
READS = ("read", "info", "download")


@pytest.mark.parametrize(
    ("token", "error"),
    [
        (None, ["HfHubHTTPError", 401]),
        ("read", ["HfHubHTTPError", 403]),
        ("stranger", ["HfHubHTTPError", 403]),
        ("rejected", ["HfHubHTTPError", 401]),
    ],
)
def test_a_token_without_the_right_changes_nothing(
    local_hub: LocalHub, token: str | None, error: list[object]
) -> None:
    local_hub.create_repo(REPO)
    refs = local_hub.refs(REPO)
    results = run(local_hub, ATTEMPTS, REPO, token=token)
    if token == "stranger":
        assert results.pop("propose") == "done"
        assert local_hub.refs(REPO).keys() == {"refs/heads/main", "refs/pr/1"}
    else:
        assert local_hub.refs(REPO) == refs
    assert {name: results[name] for name in CHANGES if name in results} == dict.fromkeys(
        [name for name in CHANGES if name in results], error
    )
    readable = error if token == "rejected" else "done"
    assert {name: results[name] for name in READS} == dict.fromkeys(READS, readable)
    assert local_hub.refs(REPO)["refs/heads/main"] == refs["refs/heads/main"]
    missing = ["LocalTokenNotFoundError", None]
    assert results["whoami"] == {None: missing, "rejected": error}.get(token, "done")


@pytest.mark.parametrize(("token", "status"), [(None, 401), ("stranger", 404)])
def test_a_private_repository_looks_as_if_it_were_not_there(
    local_hub: LocalHub, token: str | None, status: int
) -> None:
    local_hub.create_repo(REPO, private=True)
    hidden = run(local_hub, ATTEMPTS, REPO, token=token)
    missing = run(local_hub, ATTEMPTS, "user/missing", token=token)
    assert hidden == missing
    for name in ("info", "read", "write", "upload", "commit", "tag", "download"):
        assert hidden[name] == ["RepositoryNotFoundError", status]
    assert run(local_hub, ATTEMPTS, REPO, token="read")["info"] == "done"
