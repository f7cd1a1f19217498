"""Calls about collections of repositories."""

from __future__ import annotations

import hashlib
import re
from typing import Any

from hub.exchange import Answer, RefusalError, Request, as_json, route
from hub.repositories import now
from hub.state import HubState

COLLECTION = r"/api/collections/(?P<slug>[^/]+/[^/]+)"
ITEMS_IN_A_LIST = 4
"""Items of each collection that the Hub shows in a list of collections."""


@route("POST", "/api/collections")
def create_collection(hub: HubState, request: Request) -> Answer:
    """Make a collection; 409 with its slug if the namespace has one with that title."""
    wanted = request.json()
    namespace, title = wanted["namespace"], wanted["title"]
    words = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
    slug = f"{namespace}/{words}-{hashlib.sha256(title.encode()).hexdigest()[:24]}"
    _check_writer(request, namespace)
    with hub.lock:
        if slug in hub.collections:
            return as_json({"error": "This collection already exists", "slug": slug}, 409)
        hub.collections[slug] = {
            "slug": slug,
            "title": title,
            "description": wanted.get("description"),
            "owner": {"name": namespace, "type": "user"},
            "items": [],
            "lastUpdated": now(),
            "position": len(hub.collections),
            "private": wanted.get("private", False),
            "theme": "green",
            "upvotes": 0,
        }
        hub.save_collections()
    return as_json(hub.collections[slug])


@route("GET", "/api/collections")
def list_collections(hub: HubState, request: Request) -> Answer:
    """Answer with the collections of an owner, or with an item such as `datasets/user/name`."""
    owner, item = (request.query.get(key, [None])[0] for key in ("owner", "item"))
    found = [
        {**collection, "items": collection["items"][:ITEMS_IN_A_LIST]}
        for collection in hub.collections.values()
        if _is_visible(request, collection)
        and owner in (None, collection["owner"]["name"])
        and (item is None or item in _items(collection))
    ]
    for collection in found:
        del collection["position"]  # The client counts for itself, and fails on two of them.
    limit = int(request.query.get("limit", [str(len(found))])[0])
    return as_json(found[:limit])


@route("GET", COLLECTION)
def get_collection(hub: HubState, request: Request, slug: str) -> Answer:
    """Answer with a collection and all its items."""
    return as_json(_find(hub, request, slug))


@route("PATCH", COLLECTION)
def change_collection(hub: HubState, request: Request, slug: str) -> Answer:
    """Change what is said about a collection."""
    changes = request.json()
    with hub.lock:
        collection = _find(hub, request, slug, to_write=True)
        for key in ("title", "description", "private", "theme", "position"):
            collection[key] = changes.get(key, collection[key])
        hub.save_collections()
    return as_json({"success": True, "data": collection})


@route("DELETE", COLLECTION)
def delete_collection(hub: HubState, request: Request, slug: str) -> Answer:
    """Remove a collection."""
    with hub.lock:
        _find(hub, request, slug, to_write=True)
        del hub.collections[slug]
        hub.save_collections()
    return as_json({"success": True})


@route("POST", f"{COLLECTION}/items")
def add_item(hub: HubState, request: Request, slug: str) -> Answer:
    """Add a repository to a collection; 409 if it is there."""
    wanted = request.json()
    kind, name = wanted["item"]["type"], wanted["item"]["id"]
    with hub.lock:
        collection = _find(hub, request, slug, to_write=True)
        repository = hub.repository(kind, name)
        if repository is None:
            raise RefusalError(404, f"{kind} {name} not found")
        if f"{kind}s/{name}" in _items(collection):
            raise RefusalError(409, "Item already in collection")
        item: dict[str, Any] = {
            "_id": hashlib.sha256(f"{slug} {kind} {name}".encode()).hexdigest()[:24],
            "id": name,
            "type": kind,
            "position": len(collection["items"]),
            "private": repository.private,
        }
        if "note" in wanted:
            item["note"] = {"text": wanted["note"], "html": wanted["note"]}
        collection["items"].append(item)
        collection["lastUpdated"] = now()
        hub.save_collections()
    return as_json(collection)


@route("DELETE", f"{COLLECTION}/items/(?P<item>[^/]+)")
def delete_item(hub: HubState, request: Request, slug: str, item: str) -> Answer:
    """Remove a repository from a collection."""
    with hub.lock:
        collection = _find(hub, request, slug, to_write=True)
        kept = [each for each in collection["items"] if each["_id"] != item]
        if len(kept) == len(collection["items"]):
            raise RefusalError(404, f"item {item} not found")
        collection["items"] = kept
        hub.save_collections()
    return as_json({"success": True})


def _find(hub: HubState, request: Request, slug: str, to_write: bool = False) -> dict[str, Any]:
    """Return a collection that the token may see, and change if that is wanted."""
    collection = hub.collections.get(slug)
    if collection is None or not _is_visible(request, collection):
        raise RefusalError(404, "Collection not found")
    if to_write:
        _check_writer(request, slug.split("/")[0])
    return collection


def _is_visible(request: Request, collection: dict[str, Any]) -> bool:
    if not collection["private"]:
        return True
    return request.account is not None and request.account.may_read(collection["slug"], True)


def _check_writer(request: Request, namespace: str) -> None:
    if request.account is None:
        raise RefusalError(401, "Invalid username or password.")
    if not request.account.may_write(f"{namespace}/"):
        raise RefusalError(403, f"You don't have the rights to change collections of {namespace}")


def _items(collection: dict[str, Any]) -> list[str]:
    return [f"{item['type']}s/{item['id']}" for item in collection["items"]]
