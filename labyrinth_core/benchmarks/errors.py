"""`CertifyError`: what a user of `certify` can mend."""

from __future__ import annotations


class CertifyError(ValueError):
    """A benchmark cannot be certified as asked; the message is one line that says why."""
