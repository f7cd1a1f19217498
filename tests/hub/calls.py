"""The calls that the Hub on loopback answers."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlencode

from hub.card import errors_of, read_front_matter
from hub.server import Answer, RefusalError, Request, as_json, route
from hub.state import ID_TOKEN, Account, Commit, Entry, Repository

if TYPE_CHECKING:
    from hub.local_hub import LocalHub

NAME = re.compile(r"[\w.-]{1,96}")
RANGE = re.compile(r"bytes=(\d*)-(\d*)")
REPO = r"/api/(?P<kind>dataset|model)s/(?P<name>[^/]+/[^/]+)"
FILES = r"(?:/(?P<kind>dataset)s)?/(?P<name>[^/]+/[^/]+?)"
REVISION = r"(?P<revision>[^/]+)"
PREFIXES = {"dataset": "datasets/", "model": ""}
HEAD_MOVED = "A commit has happened since. Please refresh and try again."
NOT_UPLOADED = "Your push was rejected because an LFS pointer pointed to a file that does not exist"


def _visible(hub: LocalHub, request: Request, kind: str, name: str) -> Repository:
    """Return a repository; one that is private and of others looks as if it were not there."""
    repository = hub.repositories.get((kind, name))
    if repository is not None and not repository.private:
        return repository
    if request.account is None:
        raise RefusalError(401, "Invalid username or password.", "RepoNotFound")
    if repository is None or not request.account.owns(name):
        raise RefusalError(404, "Repository not found", "RepoNotFound")
    return repository


def _writable(hub: LocalHub, request: Request, kind: str, name: str) -> Repository:
    """Return a repository that the token may change."""
    repository = _visible(hub, request, kind, name)
    _check_writer(request, name)
    return repository


def _check_writer(request: Request, name: str) -> None:
    """Refuse an account that may not write to a repository."""
    account = request.account
    if account is None:
        raise RefusalError(401, "Invalid username or password.")
    if account.role != "write" or not account.owns(name):
        raise RefusalError(403, "Forbidden: you need write access, or pass `create_pr=1`")


def _user(request: Request) -> Account:
    """Return the account of a user; a token for one repository does for calls about that alone."""
    if request.account is None or request.account.only:
        raise RefusalError(401, "Invalid username or password.")
    return request.account


def _commit(repository: Repository, revision: str) -> Commit:
    """Return the commit that a revision means."""
    try:
        return repository.find(revision)
    except LookupError as error:
        raise RefusalError(404, str(error.args[0]), "RevisionNotFound") from error


@route("POST", "/oauth/token")
def exchange_token(hub: LocalHub, request: Request) -> Answer:
    """Answer a job, which is a trusted publisher of every repository there is."""
    asked = request.json()
    *kind, owner, name = asked["resource"].split("/")
    name = f"{owner}/{name}"
    there = ("".join(kind).removesuffix("s") or "model", name) in hub.repositories
    if asked["subject_token"] != ID_TOKEN or not there:
        raise RefusalError(400, "invalid_grant: no publisher of this resource matches the token")
    token = f"hf_jwt_loopback-{asked['resource']}"
    hub.accounts[token] = Account("one repository", "", (), "write", only=name)
    return as_json({"access_token": token, "token_type": "bearer", "expires_in": 3600})


@route("GET", "/api/whoami-v2")
def whoami(hub: LocalHub, request: Request) -> Answer:  # noqa: ARG001
    account = _user(request)
    organizations = [{"type": "org", "name": name} for name in account.organizations]
    token = {"displayName": account.label, "role": account.role}
    auth = {"type": "access_token", "accessToken": token}
    return as_json({"type": "user", "name": account.user, "orgs": organizations, "auth": auth})


@route("GET", f"{REPO}/auth-check(?P<write>/write)?")
def auth_check(hub: LocalHub, request: Request, kind: str, name: str, write: str) -> Answer:
    (_writable if write else _visible)(hub, request, kind, name)
    return as_json({})


@route("POST", "/api/validate-yaml")
def validate_yaml(hub: LocalHub, request: Request) -> Answer:  # noqa: ARG001
    errors = errors_of(request.json()["content"])
    told = {"errors": [{"message": message} for message in errors], "warnings": []}
    return as_json(told, 400 if errors else 200)


@route("POST", "/api/repos/create")
def create_repo(hub: LocalHub, request: Request) -> Answer:
    asked = request.json()
    kind, label = asked.get("type", "model"), str(asked.get("name"))
    account = _user(request)
    name = f"{asked.get('organization') or account.user}/{label}"
    if not NAME.fullmatch(label):
        raise RefusalError(400, f"name is {label!r}; it must match {NAME.pattern}")
    _check_writer(request, name)
    url = f"{hub.url}/{PREFIXES[kind]}{name}"
    if (kind, name) in hub.repositories:
        message = f"You already created this {kind} repo: {name}"
        return as_json({"error": message, "url": url}, 409, {"X-Error-Message": message})
    private = asked.get("private") is True or asked.get("visibility") == "private"
    hub.create_repo(name, private, kind)
    return as_json({"url": url, "name": name})


@route("GET", "/api/datasets")
def list_datasets(hub: LocalHub, request: Request) -> Answer:
    """List the datasets of an author whose names contain a text, with what is asked for."""
    author, texts = request.query["author"][0], request.query.get("search", [])
    found = []
    for (kind, name), repository in hub.repositories.items():
        owner, _, label = name.partition("/")
        owns = request.account is not None and request.account.owns(name)
        if kind != "dataset" or owner != author or (repository.private and not owns):
            continue
        if all(text in label for text in texts):
            found.append(_info(hub, repository, "main"))
    return as_json(found)


@route("GET", f"{REPO}(?:/revision/{REVISION})?")
def repo_info(hub: LocalHub, request: Request, kind: str, name: str, revision: str) -> Answer:
    info = _info(hub, _visible(hub, request, kind, name), revision or "main")
    if asked := request.query.get("expand", request.query.get("expand[]")):
        info = {key: value for key, value in info.items() if key in ("id", *asked)}
    return as_json(info)


def _info(hub: LocalHub, repository: Repository, revision: str) -> dict[str, Any]:
    """Return what the Hub says of a repository at a revision."""
    commit = _commit(repository, revision)
    readme = commit.tree.get("README.md")
    card = None
    if readme is not None:
        card = read_front_matter(hub.blob(readme.sha256).read_text(encoding="utf-8"))
    return {
        "id": repository.name,
        "author": repository.name.split("/")[0],
        "sha": commit.oid,
        "private": repository.private,
        "tags": [],
        "cardData": card,
        "siblings": [{"rfilename": path} for path in sorted(commit.tree)],
    }


@route("GET", f"{REPO}/tree/{REVISION}(?:/(?P<path>.*))?")
def list_tree(
    hub: LocalHub, request: Request, kind: str, name: str, revision: str, path: str
) -> Answer:
    tree = _commit(_visible(hub, request, kind, name), revision).tree
    folder = f"{path.rstrip('/')}/" if path else ""
    names = sorted(each for each in {*tree, *_folders(tree)} if each.startswith(folder))
    if folder and not names:
        raise RefusalError(404, f"{path} does not exist on {revision!r}", "EntryNotFound")
    if not request.flag("recursive"):
        names = [each for each in names if "/" not in each[len(folder) :]]
    size, start = hub.faults.page_size, int(request.query.get("cursor", ["0"])[0])
    headers = {}
    if start + size < len(names):
        following = urlencode({**request.query, "cursor": [str(start + size)]}, doseq=True)
        headers["Link"] = f'<{hub.url}{request.raw_path}?{following}>; rel="next"'
    page = names[start : start + size]
    return as_json([_described(tree, each) for each in page], headers=headers)


@route("POST", f"{REPO}/paths-info/{REVISION}")
def paths_info(hub: LocalHub, request: Request, kind: str, name: str, revision: str) -> Answer:
    tree = _commit(_visible(hub, request, kind, name), revision).tree
    asked, there = parse_qs(request.body().decode()).get("paths", []), {*tree, *_folders(tree)}
    return as_json([_described(tree, path) for path in asked if path in there])


def _folders(tree: Mapping[str, Entry]) -> set[str]:
    return {str(folder) for path in tree for folder in PurePosixPath(path).parents[:-1]}


def _described(tree: Mapping[str, Entry], path: str) -> dict[str, Any]:
    """Return what the Hub says of a file or a folder."""
    entry = tree.get(path)
    if entry is None:
        oid = hashlib.sha1(path.encode()).hexdigest()
        return {"type": "directory", "oid": oid, "size": 0, "path": path}
    described = {"type": "file", "oid": entry.oid, "size": entry.size, "path": path}
    if entry.is_lfs:
        described["lfs"] = {"oid": entry.sha256, "size": entry.size, "pointerSize": 130}
    return described


@route("GET", f"{REPO}/refs")
def list_refs(hub: LocalHub, request: Request, kind: str, name: str) -> Answer:
    refs = _visible(hub, request, kind, name).refs
    told: dict[str, list[dict[str, str]]] = {"converts": []}
    for key, prefix in {"branches": "refs/heads/", "tags": "refs/tags/"}.items():
        found = {ref: oid for ref, oid in sorted(refs.items()) if ref.startswith(prefix)}
        told[key] = [
            {"name": ref.removeprefix(prefix), "ref": ref, "targetCommit": oid}
            for ref, oid in found.items()
        ]
    return as_json(told)


@route("POST", f"{REPO}/preupload/{REVISION}")
def preupload(hub: LocalHub, request: Request, kind: str, name: str, revision: str) -> Answer:
    tree = _commit(_writable(hub, request, kind, name), revision).tree
    files = []
    for file in request.json()["files"]:
        is_lfs = b"\0" in base64.b64decode(file["sample"])
        mode = "lfs" if is_lfs else "regular"
        files.append({"path": file["path"], "uploadMode": mode, "shouldIgnore": False})
        entry = tree.get(file["path"])
        if entry is not None and entry.is_lfs == is_lfs:
            files[-1]["oid"] = entry.sha256 if is_lfs else entry.oid
    return as_json({"files": files})


@route("POST", rf"{FILES}\.git/info/lfs/objects/batch")
def lfs_batch(hub: LocalHub, request: Request, kind: str, name: str) -> Answer:
    asked = request.json()
    _writable(hub, request, kind or "model", name)
    verify = {"href": f"{hub.url}{request.raw_path.replace('/objects/batch', '/verify')}"}
    objects = []
    for each in asked["objects"]:
        objects.append({"oid": each["oid"], "size": each["size"]})
        if not hub.blob(each["oid"]).exists():
            upload = {"href": f"{hub.url}/lfs/{each['oid']}"}
            objects[-1]["actions"] = {"upload": upload, "verify": verify}
    return as_json({"transfer": "basic", "objects": objects})


@route("POST", rf"{FILES}\.git/info/lfs/verify")
def lfs_verify(hub: LocalHub, request: Request, kind: str, name: str) -> Answer:  # noqa: ARG001
    if not hub.blob(request.json()["oid"]).exists():
        raise RefusalError(404, "the object has not arrived")
    return as_json({})


@route("PUT", r"/lfs/(?P<sha256>[0-9a-f]{64})")
def receive(hub: LocalHub, request: Request, sha256: str) -> Answer:
    if not hub.receive(sha256, request.chunks):
        raise RefusalError(400, "the content has another SHA-256")
    return Answer()


@route("POST", f"{REPO}/commit/{REVISION}")
def commit(hub: LocalHub, request: Request, kind: str, name: str, revision: str) -> Answer:
    """Commit all operations or none, on a parent that is checked if it is given."""
    lines = map(json.loads, request.body().splitlines())
    header, *operations = [(line["key"], line["value"]) for line in lines]
    repository = _writable(hub, request, kind, name)
    ref, parent = f"refs/heads/{revision}", _commit(repository, revision)
    if ref not in repository.refs:
        raise RefusalError(404, f"Invalid rev id: {revision}", "RevisionNotFound")
    if header[1].get("parentCommit") not in (None, parent.oid):
        raise RefusalError(412, HEAD_MOVED)
    tree = dict(parent.tree)
    for key, value in operations:
        path = value["path"]
        if key == "file":
            tree[path] = hub.regular_entry(base64.b64decode(value["content"]))
        elif key == "lfsFile" and hub.blob(value["oid"]).exists():
            tree[path] = hub.lfs_entry(value["oid"])
        elif key == "lfsFile":
            raise RefusalError(400, f"{NOT_UPLOADED}: {path}")
        elif tree.pop(path, None) is None:  # A deletedFile.
            raise RefusalError(404, f"A file with this name doesn't exist: {path}", "EntryNotFound")
    url = f"{hub.url}/{PREFIXES[kind]}{name}"
    made = repository.commit(ref, tree, header[1]["summary"])
    hub.save()
    told = {"success": True, "commitOid": made.oid, "commitUrl": f"{url}/commit/{made.oid}"}
    return as_json(told)


@route("POST", f"{REPO}/tag/{REVISION}")
def create_tag(hub: LocalHub, request: Request, kind: str, name: str, revision: str) -> Answer:
    repository, ref = _writable(hub, request, kind, name), f"refs/tags/{request.json()['tag']}"
    if hub.faults.tags_to_occupy:
        hub.faults.tags_to_occupy -= 1
        *_, first = repository.history(repository.find("main"))
        repository.refs[ref] = first.oid
    target = _commit(repository, revision)
    if ref in repository.refs:
        raise RefusalError(409, f"Reference {ref} already exists")
    repository.refs[ref] = target.oid
    hub.save()
    return as_json({})


@route("DELETE", rf"{REPO}/tag/(?P<tag>[^/]+)")
def delete_tag(hub: LocalHub, request: Request, kind: str, name: str, tag: str) -> Answer:
    repository = _writable(hub, request, kind, name)
    if repository.refs.pop(f"refs/tags/{tag}", None) is None:
        raise RefusalError(404, f"Tag {tag} does not exist", "RevisionNotFound")
    hub.save()
    return as_json({})


@route("GET", f"{REPO}/commits/{REVISION}")
def list_commits(hub: LocalHub, request: Request, kind: str, name: str, revision: str) -> Answer:
    repository = _visible(hub, request, kind, name)
    return as_json(
        [
            {
                "id": commit.oid,
                "title": commit.title,
                "message": "",
                "authors": [{"user": name.split("/")[0]}],
                "date": "2026-11-23T00:00:00.000Z",
            }
            for commit in repository.history(_commit(repository, revision))
        ]
    )


@route("GET", rf"{FILES}/resolve/{REVISION}/(?P<path>.+)")
def resolve(
    hub: LocalHub, request: Request, kind: str, name: str, revision: str, path: str
) -> Answer:
    """Answer with a file, or the range of it that is asked for."""
    commit = _commit(_visible(hub, request, kind or "model", name), revision)
    entry = commit.tree.get(path)
    if entry is None:
        raise RefusalError(404, "Entry not found", "EntryNotFound")
    etag = entry.sha256 if entry.is_lfs else entry.oid
    headers = {"X-Repo-Commit": commit.oid, "ETag": f'"{etag}"', "Accept-Ranges": "bytes"}
    content = hub.blob(entry.sha256).read_bytes()
    asked = RANGE.fullmatch(request.headers.get("Range", ""))
    if asked is None:
        return Answer(200, content, headers)
    first, last = asked.groups()
    size = len(content)
    start = int(first) if first else max(0, size - int(last))
    stop = min(size, int(last) + 1) if first and last else size
    if start >= stop:
        raise RefusalError(416, "Range Not Satisfiable")
    headers["Content-Range"] = f"bytes {start}-{stop - 1}/{size}"
    return Answer(206, content[start:stop], headers)
