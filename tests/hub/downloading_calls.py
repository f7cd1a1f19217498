"""Calls that give contents: redirected, as on the real Hub, to a cache or to the CDN."""

from __future__ import annotations

import re
from urllib.parse import quote

from hub.exchange import REPO, Answer, RefusalError, Request, find_commit, route, visible
from hub.repositories import Commit, Entry
from hub.state import HubState
from hub.uploading_calls import check_signature

RANGE = re.compile(r"bytes=(\d*)-(\d*)")


@route(
    "GET",
    r"(?:/(?P<kind>dataset|space)s)?/(?P<name>[^/]+/[^/]+)/resolve/(?P<revision>[^/]+)/(?P<path>.+)",
)
def resolve(
    hub: HubState, request: Request, kind: str, name: str, revision: str, path: str
) -> Answer:
    """Redirect: 307 to a path of the Hub for a file in git, 302 to the CDN for one in LFS."""
    kind = kind or "model"
    commit, entry = _find(hub, request, kind, name, revision, path)
    etag = entry.sha256 if entry.is_lfs else entry.oid
    headers = {
        "X-Repo-Commit": commit.oid,
        "X-Linked-Etag": f'"{etag}"',
        "X-Linked-Size": str(entry.size),
        "Vary": "Origin, Accept",
    }
    if not entry.is_lfs:
        cached = f"/api/resolve-cache/{kind}s/{name}/{commit.oid}/{quote(path)}"
        return Answer(307, headers={**headers, "Location": f"{cached}?etag=%22{etag}%22"})
    headers["Location"] = hub.sign("GET", f"/lfs/{entry.sha256}")
    if entry.xet_hash and hub.mode == "xet":
        token = f"{hub.url}/api/{kind}s/{name}/xet-read-token/{commit.oid}"
        headers |= {"X-Xet-Hash": entry.xet_hash, "Link": f'<{token}>; rel="xet-auth"'}
    return Answer(302, headers=headers)


@route(
    "GET",
    f"{REPO.replace('/api/', '/api/resolve-cache/')}/(?P<revision>[^/]+)/(?P<path>.+)",
)
def resolve_cache(
    hub: HubState, request: Request, kind: str, name: str, revision: str, path: str
) -> Answer:
    """Answer with a file that is in git."""
    commit, entry = _find(hub, request, kind, name, revision, path)
    answer = _content(hub, request, entry.sha256, entry.oid)
    answer.headers["X-Repo-Commit"] = commit.oid
    return answer


@route("GET", r"/lfs/(?P<sha256>[0-9a-f]{64})")
def cdn(hub: HubState, request: Request, sha256: str) -> Answer:
    """Answer with a content, to all who know its signed path."""
    check_signature(hub, request)
    return _content(hub, request, sha256, sha256)


def _find(
    hub: HubState, request: Request, kind: str, name: str, revision: str, path: str
) -> tuple[Commit, Entry]:
    """Return a file, and the commit that it is looked up in."""
    repository = visible(hub, request, kind, name)
    commit = find_commit(repository, revision)
    entry = commit.tree.get(path)
    if entry is None:
        raise RefusalError(404, "Entry not found", "EntryNotFound", X_Repo_Commit=commit.oid)
    return commit, entry


def _content(hub: HubState, request: Request, sha256: str, etag: str) -> Answer:
    """Return a content, or the range of it that is asked for."""
    file = hub.blobs.path(sha256)
    size = file.stat().st_size
    headers = {
        "ETag": f'"{etag}"',
        "Accept-Ranges": "bytes",
        "Content-Type": "application/octet-stream",
    }
    start, stop = 0, size
    wanted = RANGE.fullmatch(request.headers.get("Range", "").replace(" ", ""))
    if wanted and any(wanted.groups()):
        first, last = wanted.groups()
        start = int(first) if first else max(0, size - int(last))
        stop = min(size, int(last) + 1) if first and last else size
        if start >= stop:
            raise RefusalError(416, "Range Not Satisfiable", Content_Range=f"bytes */{size}")
        headers["Content-Range"] = f"bytes {start}-{stop - 1}/{size}"
    status = 206 if "Content-Range" in headers else 200
    return Answer(status, headers=headers, file=file, start=start, size=stop - start)
