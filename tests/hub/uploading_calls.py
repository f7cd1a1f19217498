"""Calls that bring contents to the Hub: LFS in one piece or in parts, or hf-xet's own store."""

from __future__ import annotations

import base64
import time
from math import ceil
from pathlib import PurePosixPath
from typing import Any
from urllib.parse import parse_qs

from hub.blobs import BrokenUploadError
from hub.exchange import (
    REPO,
    Answer,
    RefusalError,
    Request,
    as_json,
    find_commit,
    route,
    visible,
    writable,
)
from hub.repositories import Repository
from hub.state import GITATTRIBUTES, HubState

LARGEST_REGULAR = 10_000_000
"""Bytes of a text file above which it goes to LFS."""
LFS_SUFFIXES = {
    line.split()[0][1:].decode() for line in GITATTRIBUTES.splitlines() if line.startswith(b"*.")
}
XET_TOKEN_SECONDS = 3600
LFS_REPO = r"(?:/(?P<kind>dataset|space)s)?/(?P<name>[^/]+/[^/]+?)\.git/info/lfs"


@route("POST", f"{REPO}/preupload/(?P<revision>[^/]+)")
def preupload(hub: HubState, request: Request, kind: str, name: str, revision: str) -> Answer:
    """Answer how each file is to be uploaded, and what is there already under its path."""
    repository = writable(hub, request, kind, name, request.flag("create_pr"))
    tree = find_commit(repository, revision).tree
    files = []
    for file in request.json()["files"]:
        mode = _upload_mode(file)
        answer = {"path": file["path"], "uploadMode": mode, "shouldIgnore": False}
        entry = tree.get(file["path"])
        if entry is not None and entry.is_lfs == (mode == "lfs"):
            answer["oid"] = entry.sha256 if entry.is_lfs else entry.oid
        files.append(answer)
    return as_json({"files": files})


@route("POST", f"{LFS_REPO}/objects/batch")
def lfs_batch(hub: HubState, request: Request, kind: str, name: str) -> Answer:
    """Answer where to send each content; no actions for those that are there already."""
    wanted = request.json()
    repository = writable(hub, request, kind or "model", name, "ref" not in wanted)
    objects = [_lfs_object(hub, repository, each) for each in wanted["objects"]]
    return as_json({"transfer": "basic", "objects": objects})


@route("POST", f"{LFS_REPO}/verify")
def lfs_verify(hub: HubState, request: Request, kind: str, name: str) -> Answer:
    """Answer 200 if a content has arrived whole."""
    writable(hub, request, kind or "model", name, create_pr=True)
    wanted = request.json()
    if not hub.blobs.has(wanted["oid"], wanted["size"]):
        raise RefusalError(404, f"object {wanted['oid']} of {wanted['size']} bytes has not arrived")
    return as_json({})


@route("PUT", r"/lfs/(?P<sha256>[0-9a-f]{64})")
def receive(hub: HubState, request: Request, sha256: str) -> Answer:
    """Store a content."""
    check_signature(hub, request)
    try:
        hub.blobs.receive(sha256, request.chunks())
    except BrokenUploadError as error:
        raise RefusalError(400, str(error)) from error
    return Answer(200, headers={"ETag": f'"{sha256}"'})


@route("PUT", r"/parts/(?P<upload>[0-9a-f]{32})/(?P<number>\d{5})")
def receive_part(hub: HubState, request: Request, upload: str, number: str) -> Answer:
    """Store a part of a content."""
    check_signature(hub, request)
    etag = hub.blobs.receive_part(upload, int(number), request.body())
    return Answer(200, headers={"ETag": f'"{etag}"'})


@route("POST", r"/api/complete-multipart/(?P<upload>[0-9a-f]{32})")
def complete(hub: HubState, request: Request, upload: str) -> Answer:
    """Join the parts of a content; the signed path stands for a token, as on the real Hub."""
    check_signature(hub, request)
    wanted = request.json()
    parts = sorted(wanted["parts"], key=lambda part: part["partNumber"])
    try:
        with hub.lock:
            etags = [part["etag"].strip('"') for part in parts]
            hub.blobs.join_parts(upload, wanted["oid"], etags)
    except BrokenUploadError as error:
        raise RefusalError(400, str(error)) from error
    return as_json({"success": True})


@route("GET", f"{REPO}/xet-(?P<access>read|write)-token/(?P<revision>[^/]+)")
def xet_token(
    hub: HubState, request: Request, kind: str, name: str, access: str, revision: str
) -> Answer:
    """Answer where hf-xet keeps contents: in a folder of this Hub, with its own code."""
    create_pr = request.flag("create_pr")
    if access == "write":
        repository = writable(hub, request, kind, name, create_pr)
    else:
        repository = visible(hub, request, kind, name)
    if not create_pr:
        find_commit(repository, revision)
    if hub.mode != "xet":
        raise RefusalError(404, f"this Hub takes {hub.mode} only: set HF_HUB_DISABLE_XET=1")
    token, expiry = f"xet-{access}-token", int(time.time()) + XET_TOKEN_SECONDS
    headers = {
        "X-Xet-Cas-Url": hub.blobs.xet.url,
        "X-Xet-Access-Token": token,
        "X-Xet-Token-Expiration": str(expiry),
    }
    body = {"accessToken": token, "casUrl": hub.blobs.xet.url, "exp": expiry}
    return as_json(body, 200, headers)


def check_signature(hub: HubState, request: Request) -> None:
    """Refuse a call to a path that this Hub has not signed."""
    signature = parse_qs(request.raw_query).get("X-Signature", [""])[0]
    if not hub.is_signed(request.method, request.path, signature):
        raise RefusalError(403, "SignatureDoesNotMatch")


def _upload_mode(file: dict[str, Any]) -> str:
    """Return how a file is to be uploaded, by its name, its size and how it begins."""
    sample = base64.b64decode(file["sample"])
    if PurePosixPath(file["path"]).suffix in LFS_SUFFIXES or file["size"] > LARGEST_REGULAR:
        return "lfs"
    return "lfs" if b"\0" in sample else "regular"


def _lfs_object(hub: HubState, repository: Repository, wanted: dict[str, Any]) -> dict[str, Any]:
    """Return what to do for a content."""
    oid, size = wanted["oid"], wanted["size"]
    answer: dict[str, Any] = {"oid": oid, "size": size}
    if hub.blobs.has(oid, size):
        return answer
    prefix = "" if repository.kind == "model" else f"{repository.kind}s/"
    verify = {"href": f"{hub.url}/{prefix}{repository.name}.git/info/lfs/verify"}
    if hub.mode == "lfs-multipart":
        upload = _multipart_action(hub, size)
    else:
        upload = {"href": hub.sign("PUT", f"/lfs/{oid}")}
    return answer | {"actions": {"upload": upload, "verify": verify}}


def _multipart_action(hub: HubState, size: int) -> dict[str, Any]:
    """Return where to send each part of a content, and where to say that all are sent."""
    upload = hub.blobs.begin_parts()
    header = {"chunk_size": str(hub.part_size)}
    for number in range(1, ceil(size / hub.part_size) + 1):
        header[f"{number:05d}"] = hub.sign("PUT", f"/parts/{upload}/{number:05d}")
    signed = hub.sign("POST", f"/api/complete-multipart/{upload}")
    return {"href": signed.replace(hub.cdn_url, hub.url), "header": header}
