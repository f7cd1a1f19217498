"""Calls that change a repository: commits, pull requests, tags and branches."""

from __future__ import annotations

import base64
import json
from typing import Any

from hub.exchange import REPO, Answer, RefusalError, Request, as_json, find_commit, route, writable
from hub.repositories import MAIN, Commit, Entry, Repository, lfs_entry, regular_entry
from hub.state import HubState

HEAD_MOVED = "A commit has happened since. Please refresh and try again."
NOT_UPLOADED = "Your push was rejected because an LFS pointer pointed to a file that does not exist"


@route("POST", f"{REPO}/commit/(?P<revision>[^/]+)")
def commit(hub: HubState, request: Request, kind: str, name: str, revision: str) -> Answer:
    """Commit all operations or none, on a parent that is checked if it is given."""
    create_pr = request.flag("create_pr")
    header, operations = _read(request)
    with hub.lock:
        repository = writable(hub, request, kind, name, create_pr)
        if hub.faults.take_interference("move head"):
            hub.commit_as_somebody_else(repository)
        ref = _ref_to_commit_to(repository, revision)
        parent = find_commit(repository, ref)
        wanted = header.get("parentCommit")
        if wanted is not None and not parent.oid.startswith(wanted):
            raise RefusalError(412, HEAD_MOVED)
        tree = dict(parent.tree)
        for key, value in operations:
            _apply(hub, tree, key, value)
        number = None
        if create_pr:
            number = 1 + sum(each.startswith("refs/pr/") for each in repository.refs)
            ref = f"refs/pr/{number}"
            repository.point(ref, parent.oid)
        author = request.account.user if request.account else ""
        title, message = header["summary"], header.get("description", "")
        made = repository.commit(ref, tree, title, message, author)
    return as_json(_describe(hub, repository, made, number))


@route("POST", f"{REPO}/tag/(?P<revision>[^/]+)")
def create_tag(hub: HubState, request: Request, kind: str, name: str, revision: str) -> Answer:
    """Let a new tag point at a revision; 409 if there is such a tag, wherever it points."""
    tag = request.json()["tag"]
    ref = f"refs/tags/{tag}"
    with hub.lock:
        repository = writable(hub, request, kind, name)
        if hub.faults.take_interference("occupy tag"):
            *_, first = repository.history(repository.find("main"))
            repository.point(ref, first.oid)
        target = find_commit(repository, revision)
        if ref in repository.refs:
            raise RefusalError(409, f"Tag {tag} already exists")
        repository.point(ref, target.oid)
    return as_json({})


@route("POST", f"{REPO}/branch/(?P<branch>[^/]+)")
def create_branch(hub: HubState, request: Request, kind: str, name: str, branch: str) -> Answer:
    """Let a new branch start at a revision, `main` if none is given; 409 if there is one."""
    start = request.json().get("startingPoint", "main")
    ref = f"refs/heads/{branch}"
    with hub.lock:
        repository = writable(hub, request, kind, name)
        target = find_commit(repository, start)
        if ref in repository.refs:
            raise RefusalError(409, f"Reference {ref} already exists")
        repository.point(ref, target.oid)
    return as_json({})


@route("DELETE", f"{REPO}/(?P<what>tag|branch)/(?P<label>[^/]+)")
def delete_ref(
    hub: HubState, request: Request, kind: str, name: str, what: str, label: str
) -> Answer:
    """Remove a tag, or a branch other than `main`."""
    ref = f"refs/{'tags' if what == 'tag' else 'heads'}/{label}"
    with hub.lock:
        repository = writable(hub, request, kind, name)
        if ref == MAIN:
            raise RefusalError(403, "Cannot delete the main branch")
        if ref not in repository.refs:
            raise RefusalError(404, f"Invalid rev id: {label}", "RevisionNotFound")
        repository.point(ref, None)
    return as_json({})


def _read(request: Request) -> tuple[dict[str, Any], list[tuple[str, Any]]]:
    """Return the header and the operations in the body, a JSON value a line."""
    try:
        lines = [json.loads(line) for line in request.body().splitlines() if line.strip()]
        (first, header), *operations = [(line["key"], line["value"]) for line in lines]
    except (ValueError, KeyError, TypeError) as error:
        raise RefusalError(400, f"body is not a commit: {error!r}") from error
    if first != "header" or not header.get("summary"):
        raise RefusalError(400, "body is not a commit: it begins with no header that has a summary")
    return header, operations


def _ref_to_commit_to(repository: Repository, revision: str) -> str:
    """Return the branch or pull request that is meant; nothing else can be committed to."""
    for ref in (f"refs/heads/{revision}", revision):
        if ref in repository.refs and not ref.startswith("refs/tags/"):
            return ref
    raise RefusalError(404, f"Invalid rev id: {revision}", "RevisionNotFound")


def _apply(hub: HubState, tree: dict[str, Entry], key: str, value: dict[str, Any]) -> None:
    """Change a tree as an operation says."""
    path = value["path"]
    if key == "file":
        content = base64.b64decode(value["content"])
        hub.blobs.add(content)
        tree[path] = regular_entry(content)
    elif key == "lfsFile":
        sha256 = value["oid"]
        if not hub.blobs.has(sha256, value.get("size")):
            raise RefusalError(400, f"{NOT_UPLOADED}: {path} ({sha256})")
        size = hub.blobs.path(sha256).stat().st_size
        xet_hash = hub.blobs.xet_hash(sha256) if hub.mode == "xet" else None
        tree[path] = lfs_entry(sha256, size, xet_hash)
    elif key == "deletedFile":
        if tree.pop(path, None) is None:
            raise RefusalError(404, f"A file with this name doesn't exist: {path}", "EntryNotFound")
    elif key == "deletedFolder":
        folder = f"{path.rstrip('/')}/"
        inside = [each for each in tree if each.startswith(folder)]
        if not inside:
            raise RefusalError(
                404, f"A folder with this name doesn't exist: {path}", "EntryNotFound"
            )
        for each in inside:
            del tree[each]
    else:
        raise RefusalError(400, f"operation is {key!r}")


def _describe(
    hub: HubState, repository: Repository, made: Commit, number: int | None
) -> dict[str, Any]:
    """Return the answer to a commit."""
    prefix = "" if repository.kind == "model" else f"{repository.kind}s/"
    url = f"{hub.url}/{prefix}{repository.name}"
    answer = {"success": True, "commitOid": made.oid, "commitUrl": f"{url}/commit/{made.oid}"}
    if number is not None:
        answer |= {"pullRequestUrl": f"{url}/discussions/{number}"}
    return answer
