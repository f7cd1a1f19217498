"""Calls about what is in a repository."""

from __future__ import annotations

import hashlib
from datetime import datetime
from typing import Any
from urllib.parse import parse_qs, urlencode

import yaml

from hub.card import read_front_matter
from hub.exchange import REPO, Answer, RefusalError, Request, as_json, find_commit, route, visible
from hub.faults import PAGE_SIZE
from hub.repositories import Commit, Entry, Repository, Tree
from hub.state import HubState

IN_EVERY_INFO = ("_id", "id")


@route("GET", REPO)
@route("GET", f"{REPO}/revision/(?P<revision>[^/]+)")
def repo_info(
    hub: HubState, request: Request, kind: str, name: str, revision: str = "main"
) -> Answer:
    """Answer with what a repository is, and its files."""
    repository = visible(hub, request, kind, name)
    commit = find_commit(repository, revision)
    info: dict[str, Any] = {
        "_id": f"id-of-{kind}-{name}",
        "id": name,
        "author": name.split("/")[0],
        "sha": commit.oid,
        "createdAt": repository.created,
        "lastModified": commit.date,
        "private": repository.private,
        "gated": False,
        "disabled": False,
        "downloads": 0,
        "likes": 0,
        "tags": ["region:us"],
        "usedStorage": sum(entry.size for entry in commit.tree.values()),
        "cardData": _card_data(hub, commit),
        "siblings": [
            _sibling(path, commit.tree[path], request.flag("blobs")) for path in sorted(commit.tree)
        ],
    }
    if kind == "space":
        info["sdk"] = (info["cardData"] or {}).get("sdk")
    if wanted := request.query.get("expand", request.query.get("expand[]")):
        info = {key: info[key] for key in (*IN_EVERY_INFO, *wanted) if key in info}
    return as_json(info)


@route("GET", f"{REPO}/tree/(?P<revision>[^/]+)(?:/(?P<path>.*))?")
def list_tree(
    hub: HubState, request: Request, kind: str, name: str, revision: str, path: str
) -> Answer:
    """Answer with a page of the files and folders in a folder, or in all that it contains."""
    repository = visible(hub, request, kind, name)
    commit = find_commit(repository, revision)
    folder = f"{path.rstrip('/')}/" if path else ""
    below = {key: entry for key, entry in commit.tree.items() if key.startswith(folder)}
    if folder and not below:
        raise RefusalError(404, f"{path} does not exist on {revision!r}", "EntryNotFound")
    names = sorted(set(below) | _folders(below, folder))
    if not request.flag("recursive"):
        names = [each for each in names if "/" not in each[len(folder) :]]
    page, headers = _page(hub, request, names)
    return as_json([_describe(repository, commit, each, request) for each in page], 200, headers)


@route("POST", f"{REPO}/paths-info/(?P<revision>[^/]+)")
def paths_info(hub: HubState, request: Request, kind: str, name: str, revision: str) -> Answer:
    """Answer with the files and folders that are asked for; missing ones are left out."""
    repository = visible(hub, request, kind, name)
    commit = find_commit(repository, revision)
    form = parse_qs(request.body().decode())
    expand = form.get("expand", ["false"])[0].lower() == "true"
    folders = _folders(commit.tree, "")
    return as_json(
        [
            _describe(repository, commit, path, request, expand)
            for path in form.get("paths", [])
            if path in commit.tree or path in folders
        ]
    )


@route("GET", f"{REPO}/refs")
def list_refs(hub: HubState, request: Request, kind: str, name: str) -> Answer:
    """Answer with the branches and tags, and the pull requests if they are asked for."""
    repository = visible(hub, request, kind, name)
    answer: dict[str, list[dict[str, str]]] = {"branches": [], "converts": [], "tags": []}
    prefixes = {"branches": "refs/heads/", "tags": "refs/tags/"}
    if request.flag("include_prs"):
        prefixes["pullRequests"] = "refs/pr/"
    for key, prefix in prefixes.items():
        answer[key] = [
            {"name": ref.removeprefix(prefix), "ref": ref, "targetCommit": oid}
            for ref, oid in sorted(repository.refs.items())
            if ref.startswith(prefix)
        ]
    return as_json(answer)


@route("GET", f"{REPO}/commits/(?P<revision>[^/]+)")
def list_commits(hub: HubState, request: Request, kind: str, name: str, revision: str) -> Answer:
    """Answer with a page of the commits up to a revision, newest first."""
    repository = visible(hub, request, kind, name)
    commits = list(repository.history(find_commit(repository, revision)))
    page, headers = _page(hub, request, commits)
    return as_json(
        [
            {
                "id": commit.oid,
                "title": commit.title,
                "message": commit.message,
                "authors": [{"user": commit.author}],
                "date": commit.date,
            }
            for commit in page
        ],
        200,
        headers,
    )


def _page(hub: HubState, request: Request, entries: list[Any]) -> tuple[list[Any], dict[str, str]]:
    """Return a page, and the header that links to the next one."""
    size = hub.faults.page_size or PAGE_SIZE
    query = request.query
    start = int(query.get("cursor", ["0"])[0])
    page = entries[start : start + size]
    if start + size >= len(entries):
        return page, {}
    following = urlencode({**query, "cursor": [str(start + size)]}, doseq=True)
    return page, {"Link": f'<{hub.url}{request.raw_path}?{following}>; rel="next"'}


def _folders(tree: Tree, above: str) -> set[str]:
    """Return the folders below a folder in which there are files."""
    found = set()
    for path in tree:
        while "/" in path[len(above) :]:
            path = path.rsplit("/", 1)[0]
            found.add(path)
    return found


def _describe(
    repository: Repository,
    commit: Commit,
    path: str,
    request: Request,
    expand: bool | None = None,
) -> dict[str, Any]:
    """Return what the Hub says of a file or a folder."""
    entry = commit.tree.get(path)
    if entry is None:
        inside = [f"{key} {commit.tree[key].oid}" for key in sorted(commit.tree)]
        oid = hashlib.sha1("\n".join([path, *inside]).encode()).hexdigest()
        described: dict[str, Any] = {"type": "directory", "oid": oid, "size": 0, "path": path}
    else:
        described = {"type": "file", "oid": entry.oid, "size": entry.size, "path": path}
        if entry.is_lfs:
            lfs = {"oid": entry.sha256, "size": entry.size, "pointerSize": entry.pointer_size}
            described["lfs"] = lfs
        if entry.xet_hash:
            described["xetHash"] = entry.xet_hash
    if request.flag("expand") if expand is None else expand:
        change = repository.last_change(commit, path) if entry else commit
        described["lastCommit"] = {"id": change.oid, "title": change.title, "date": change.date}
        if entry:
            scan = {"status": "safe", "avScan": None, "pickleImportScan": None}
            described["securityFileStatus"] = scan
    return described


def _sibling(path: str, entry: Entry, with_blobs: bool) -> dict[str, Any]:
    """Return what the information about a repository says of a file."""
    sibling: dict[str, Any] = {"rfilename": path}
    if with_blobs:
        sibling |= {"size": entry.size, "blobId": entry.oid}
        if entry.is_lfs:
            lfs = {"sha256": entry.sha256, "size": entry.size, "pointerSize": entry.pointer_size}
            sibling["lfs"] = lfs
    return sibling


def _card_data(hub: HubState, commit: Commit) -> dict[str, Any] | None:
    """Return the YAML of the README.md, None where it has none, or none that can be read."""
    readme = commit.tree.get("README.md")
    if readme is None:
        return None
    try:
        metadata = read_front_matter(hub.content(readme).decode())
    except (yaml.YAMLError, UnicodeDecodeError):
        return None
    return _jsonable(metadata) if isinstance(metadata, dict) else None


def _jsonable(value: Any) -> Any:
    """Return a YAML value without the types that JSON does not have."""
    if isinstance(value, dict):
        return {str(key): _jsonable(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_jsonable(each) for each in value]
    return value.isoformat() if isinstance(value, datetime) else value
