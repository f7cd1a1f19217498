"""Who may do what: the users of the Hub on loopback and their tokens."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Account:
    """What a token stands for: a user, and what the token lets them do."""

    label: str
    """What tests and the request log call the token."""
    token: str
    user: str
    organizations: tuple[str, ...]
    role: str
    """`write` or `read`."""

    @property
    def namespaces(self) -> tuple[str, ...]:
        """Where this user's repositories are: their own name and their organizations."""
        return (self.user, *self.organizations)

    def may_read(self, repository: str, private: bool) -> bool:
        """Return whether a repository is visible to this token."""
        return not private or repository.split("/")[0] in self.namespaces

    def may_write(self, repository: str) -> bool:
        """Return whether this token may change a repository."""
        return self.role == "write" and repository.split("/")[0] in self.namespaces

    def describe(self) -> dict[str, Any]:
        """Return the answer of `whoami-v2`."""
        return {
            "type": "user",
            "id": f"id-of-{self.user}",
            "name": self.user,
            "fullname": self.user.title(),
            "email": f"{self.user}@example.org",
            "emailVerified": True,
            "isPro": False,
            "canPay": False,
            "orgs": [
                {"type": "org", "id": f"id-of-{name}", "name": name, "fullname": name.title()}
                for name in self.organizations
            ],
            "auth": {
                "type": "access_token",
                "accessToken": {"displayName": self.label, "role": self.role},
            },
        }


TOKENS = {
    "write": "hf_loopbackTokenThatMayWrite",
    "read": "hf_loopbackTokenThatMayRead",
    "stranger": "hf_loopbackTokenOfSomebodyElse",
    "rejected": "hf_loopbackTokenThatTheHubRejects",
}
"""All tokens by their labels; the Hub does not know the last one."""


def make_accounts(user: str, organizations: tuple[str, ...]) -> tuple[Account, ...]:
    """Return the accounts: two tokens of one user, and one of a stranger."""
    return (
        Account("write", TOKENS["write"], user, organizations, "write"),
        Account("read", TOKENS["read"], user, organizations, "read"),
        Account("stranger", TOKENS["stranger"], "stranger", (), "write"),
    )


def token_of(label: str) -> str:
    """Return the token with that label.

    Raises:
        ValueError: if there is no such token.
    """
    if label not in TOKENS:
        raise ValueError(f"token is {label!r}; allowed are {', '.join(TOKENS)} and None")
    return TOKENS[label]
