"""Calls about who may do what, and which repositories there are."""

from __future__ import annotations

import re

from hub.card import validate
from hub.exchange import REPO, Answer, RefusalError, Request, as_json, route, visible, writable
from hub.state import HubState

NAME = re.compile(r"[\w.-]{1,96}")
PREFIXES = {"dataset": "datasets/", "space": "spaces/", "model": ""}


@route("GET", "/api/whoami-v2")
def whoami(hub: HubState, request: Request) -> Answer:  # noqa: ARG001
    """Answer with the user, their organizations, and the role of their token."""
    if request.account is None:
        raise RefusalError(401, "Invalid username or password.")
    return as_json(request.account.describe())


@route("GET", "/api/agent-harnesses")
def agent_harnesses(hub: HubState, request: Request) -> Answer:  # noqa: ARG001
    """Answer that no program is known that works on somebody's behalf; clients ask daily."""
    return as_json({"standardEnvVars": [], "harnesses": {}})


@route("GET", f"{REPO}/auth-check(?P<write>/write)?")
def auth_check(hub: HubState, request: Request, kind: str, name: str, write: str) -> Answer:
    """Answer 200 if the token may read, or write, the repository."""
    check = writable if write else visible
    check(hub, request, kind, name)
    return as_json({})


@route("POST", "/api/validate-yaml")
def validate_yaml(hub: HubState, request: Request) -> Answer:  # noqa: ARG001
    """Answer with what is wrong with a card: 400 if anything is."""
    card = request.json()
    errors, warnings = validate(card["content"], card.get("repoType", "model"))
    answer = {
        "errors": [{"message": message} for message in errors],
        "warnings": [{"message": message} for message in warnings],
    }
    return as_json(answer, 400 if errors else 200)


@route("POST", "/api/repos/create")
def create_repo(hub: HubState, request: Request) -> Answer:
    """Make a repository: 403 outside one's namespaces, 409 with its URL if it exists."""
    wanted = request.json()
    kind = wanted.get("type", "model")
    name = _full_name(request, wanted)
    url = f"{hub.url}/{PREFIXES[kind]}{name}"
    with hub.lock:
        if hub.repository(kind, name) is not None:
            message = f"You already created this {kind} repo: {name}"
            return as_json({"error": message, "url": url}, 409, {"X-Error-Message": message})
        private = wanted.get("private") is True or wanted.get("visibility") == "private"
        author = request.account.user if request.account else ""
        hub.create_repository(kind, name, private, author)
    return as_json({"url": url, "name": name, "id": f"id-of-{kind}-{name}"})


@route("DELETE", "/api/repos/delete")
def delete_repo(hub: HubState, request: Request) -> Answer:
    """Remove a repository."""
    wanted = request.json()
    name = _full_name(request, wanted)
    with hub.lock:
        hub.delete_repository(writable(hub, request, wanted.get("type", "model"), name))
    return as_json({})


@route("PUT", f"{REPO}/settings")
def change_settings(hub: HubState, request: Request, kind: str, name: str) -> Answer:
    """Change who may see a repository."""
    wanted = request.json()
    with hub.lock:
        repository = writable(hub, request, kind, name)
        if "visibility" in wanted:
            repository.private = wanted["visibility"] == "private"
        elif "private" in wanted:
            repository.private = wanted["private"] is True
        repository.save()
    return as_json({"private": repository.private})


def _full_name(request: Request, wanted: dict[str, str | None]) -> str:
    """Return the name of the repository to make or remove, in a namespace of the token's user."""
    if request.account is None:
        raise RefusalError(401, "Invalid username or password.")
    namespace = wanted.get("organization") or request.account.user
    name = f"{namespace}/{wanted.get('name')}"
    if not NAME.fullmatch(str(wanted.get("name"))):
        raise RefusalError(400, f"name is {wanted.get('name')!r}; it must match {NAME.pattern}")
    if not request.account.may_write(name):
        kind = wanted.get("type", "model")
        message = f'You don\'t have the rights to create a {kind} under the namespace "{namespace}"'
        raise RefusalError(403, message)
    return name
