"""Calls of the Hub's client: a limit on silence, retries, errors in one line, files of one commit.

A call fails after a minute without a byte. The client limits downloads itself
(HF_HUB_DOWNLOAD_TIMEOUT, HF_HUB_ETAG_TIMEOUT), but not most other calls. It also retries some calls
that fail, for up to 23 seconds. Within `repeated` it does not, as `repeated` retries all of them.

The client answers from its cache, in silence, if the Hub refuses or is down. Readers therefore ask
which commit a revision means (`commit_of`), which no cache answers, and read files of that commit.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import time
import traceback
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from contextvars import ContextVar
from functools import partial
from json import JSONDecodeError
from pathlib import Path
from typing import Any, TypeVar

from huggingface_hub import HfApi, constants, get_session, get_token, hf_hub_download
from huggingface_hub.errors import (  # type: ignore[attr-defined]
    FileMetadataError,
    HTTPError,
    LocalEntryNotFoundError,
    RemoteEntryNotFoundError,
    RevisionNotFoundError,
)
from huggingface_hub.file_download import repo_folder_name
from huggingface_hub.utils import hf_raise_for_status  # type: ignore[attr-defined]

from labyrinth_core.errors import MALFORMED, DatasetError, one_line

VARIABLE, SECONDS = "LABYRINTH_HUB_SECONDS", "60"
"""Environment variable for the seconds without a byte after which a call fails; its default."""

UNAVAILABLE = (OSError, ValueError, HTTPError, RuntimeError)
"""The client's errors for a file or repository that it cannot provide; RuntimeError is Xet's."""

WAITS = (0.2, 1.0, 3.0, 6.0)
"""Seconds before each retry of a call, unless the answer's Retry-After asks for more."""
LONGEST = 90.0
"""Seconds after the first try in which the last retry begins."""

_repeating = ContextVar("repeating", default=False)
"""Whether `repeated` makes the calls of this thread, so that the client must not retry them."""

FAILED = (*UNAVAILABLE, *MALFORMED)
"""The client's errors, also for answers that it cannot read."""

ID = re.compile(r"(?!.*(--|\.\.))\w[\w.-]*/\w[\w.-]*", re.ASCII)
"""The ids of repositories."""
COMMIT = re.compile(r"[0-9a-f]{40}")
_CACHED = re.compile(r"(model|dataset)s--([^/]+)--([^/]+)/snapshots/([0-9a-f]{40})/(.+)")
"""The path of a file in the client's cache."""

Result = TypeVar("Result")


def prepare_client() -> None:
    """Set a time limit for calls of the Hub's client that have none, and check the token.

    Raises:
        DatasetError: The environment variable is not a positive number of seconds, or the token
            cannot be sent; an error of the client's own would print it.
    """
    _seconds()
    # With HF_OIDC_RESOURCE the Hub itself gives a job its token, at the first call that needs it.
    token = "" if os.environ.get("HF_OIDC_RESOURCE") else get_token() or ""
    if not (token.isascii() and token.isprintable()):
        raise DatasetError(
            "the Hub token is malformed, with characters that no token has: copy it again into "
            "HF_TOKEN, or run `hf auth login`"
        )
    session: Any = get_session()
    if not isinstance(session.send, partial):
        session.send = partial(_sent, session.send)


def _sent(send: Callable[..., Any], request: Any, **options: Any) -> Any:
    """Return the response to a request of httpx, with a time limit if it has none.

    Raises:
        HTTPError: There is no answer, or, within `repeated`, one that may pass. The client retries
            only exceptions of other classes and responses.
    """
    limits = request.extensions["timeout"]
    if not any(limits.values()):
        request.extensions["timeout"] = dict.fromkeys(limits, _seconds())
    try:
        response = send(request, **options)
    except HTTPError as error:
        if _repeating.get():
            raise HTTPError(one_line(error)) from error
        raise
    if _repeating.get() and _may_pass(response.status_code):
        response.read()
        hf_raise_for_status(response)
    return response


def _may_pass(status: int) -> bool:
    return status >= 500 or status in (408, 429)


def _seconds() -> float:
    text = os.environ.get(VARIABLE, SECONDS)
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0 < seconds < 1e6:
        raise DatasetError(f"{VARIABLE}={text:.60}: give a number of seconds, such as {SECONDS}")
    return seconds


class WrongAnswerError(ValueError):
    """An answer that no Hub gives, or none for long.

    Such as the page on which a hotel's network asks for a login, or tags without the newest one.
    """


def repeated(call: Callable[[], Result]) -> Result:
    """Return the result of an idempotent call, retried after errors that may pass.

    A call within `call` is not retried by itself. An error after several tries has a note, which
    `reason_of` prints.

    Raises:
        DatasetError: `call` raises one.
        WrongAnswerError: The client cannot read the answer.
        OSError, ValueError, HTTPError, RuntimeError: The client's other errors.
    """
    if _repeating.get():
        return call()
    begun, before = time.monotonic(), _repeating.set(True)
    try:
        for tries, pause in enumerate((*WAITS, math.inf), 1):
            try:
                prepare_client()  # The client starts another session after some errors.
                return call()
            except DatasetError:
                raise
            except FAILED as error:
                wait, tried = seconds_to_wait(error), time.monotonic() - begun
                if wait is None or tried + max(pause, wait) > LONGEST:
                    failed = _readable(error)
                    if tries > 1:
                        failed.add_note(f"tried {tries} times in {tried:.0f} s")
                    raise failed from failed.__cause__
            time.sleep(max(pause, wait))
    finally:
        _repeating.reset(before)
    raise AssertionError


def _readable(error: Exception) -> Exception:
    """Return an error, or a WrongAnswerError in place of one from parsing an answer."""
    if isinstance(error, WrongAnswerError) or not is_not_of_a_hub(error):
        return error
    told = f"what answers at {constants.ENDPOINT} is not a Hub: {one_line(error):.200}"
    wrong = WrongAnswerError(told)
    wrong.__cause__ = error
    return wrong


def seconds_to_wait(error: Exception) -> float | None:
    """Return the seconds that an answer asks to wait for; None if a retry cannot help.

    A retry may help after a network or server error, a rate limit, a download that was cut, or an
    answer that is not a Hub's.
    """
    cause, status = _cause(error), status_of(error)
    if status is None:
        was_cut = "Consistency check failed" in str(cause)
        passing = isinstance(cause, HTTPError) or was_cut or is_not_of_a_hub(error)
    else:
        passing = _may_pass(status)
    response = getattr(cause, "response", None)
    asked = "" if response is None else response.headers.get("retry-after", "")
    seconds = float(asked) if re.fullmatch(r"\d{1,9}", asked) else 0.0
    return seconds if passing else None


def _cause(error: Exception) -> Exception:
    """Return the error that the client wraps in one that says what else it tried."""
    wraps = isinstance(error, (LocalEntryNotFoundError, RuntimeError)) or (
        isinstance(error, ValueError) and str(error).startswith("Force download failed")
    )
    cause = error.__cause__
    if wraps and isinstance(cause, UNAVAILABLE) and is_of_client(error):
        return _cause(cause)
    return error


def status_of(error: Exception) -> int | None:
    """Return the status of the Hub's answer, None if there was no answer."""
    response = getattr(_cause(error), "response", None)
    status: int | None = getattr(response, "status_code", None)
    return status


def is_not_of_a_hub(error: Exception) -> bool:
    """Return whether the client failed because an answer has not the form of a Hub's."""
    cause = _cause(error)
    if isinstance(cause, (FileMetadataError, JSONDecodeError, WrongAnswerError)):
        return True
    told = re.search("malformed|improperly formatted", str(cause), re.IGNORECASE)
    wrong = (LookupError, TypeError, AttributeError) if told is None else MALFORMED
    return isinstance(cause, wrong) and is_of_client(cause)


def is_of_client(error: BaseException) -> bool:
    """Return whether the Hub's client, or code that it calls, raised an error."""
    frames = traceback.walk_tb(error.__traceback__)
    modules = (str(frame.f_globals.get("__name__", "")) for frame, _ in frames)
    return any(module.partition(".")[0] == "huggingface_hub" for module in modules)


def reason_of(error: Exception) -> str:
    """Return what the Hub answered, or why it did not, and how long it was tried, in one line."""
    cause, status = _cause(error), status_of(error)
    if status is None:
        told = one_line(cause)
    else:
        message = getattr(cause, "server_message", None) or one_line(cause)
        told = f"the Hub answers {status}: {message.partition(' For more information')[0]}"
    return " ".join([f"{told:.300}", *(f"({note})" for note in getattr(error, "__notes__", ()))])


def why_unavailable(source: str, error: Exception) -> str:
    """Explain an error with which the Hub's client or `datasets` failed to provide a dataset."""
    file = error.filename if isinstance(error, OSError) else None
    if file is not None and not Path(file).resolve().is_relative_to(Path(source).resolve()):
        return f"{source}: the cache of the Hub's client cannot be used (HF_HOME moves it)"
    if Path(source).is_dir():
        return f"{source} cannot be read"
    return f"{source} is neither a folder (labyrinth-datasets makes one) nor available on the Hub"


def commit_of(repo_id: str, repo_type: str, revision: str | None) -> str:
    """Return the commit that a revision means, as the Hub says; without HF_HUB_OFFLINE=1 only so.

    Args:
        repo_id: The repository.
        repo_type: `dataset` or `model`.
        revision: A branch, tag or commit; None for `main`.

    Raises:
        DatasetError: The Hub does not say, but the cache has a commit, which may be an older one.
        OSError, ValueError, HTTPError: The client's errors; `RevisionNotFoundError` if there is no
            such revision.
    """
    name = revision or constants.DEFAULT_REVISION
    if COMMIT.fullmatch(name):
        return name
    prepare_client()
    known = known_commit(repo_id, repo_type, name)
    if constants.HF_HUB_OFFLINE and known:
        return known

    def asked() -> str:
        commit = HfApi().repo_info(repo_id, repo_type=repo_type, revision=name).sha
        if not COMMIT.fullmatch(commit or ""):
            raise WrongAnswerError(f"{constants.ENDPOINT} names no commit of {repo_id}")
        return str(commit)

    try:
        commit = repeated(asked)
    except UNAVAILABLE as error:
        if not known or isinstance(error, RevisionNotFoundError):
            raise
        raise DatasetError(
            f"{repo_id}: {reason_of(error)}; to read {known[:12]}, the newest commit of {name} "
            "that this machine has read, set HF_HUB_OFFLINE=1"
        ) from error
    if commit != known:
        with suppress(OSError):  # The cache need not be writable if it has the files.
            reference = _reference(repo_id, repo_type, name)
            reference.parent.mkdir(parents=True, exist_ok=True)
            reference.write_text(commit, encoding="utf-8")
    return commit


def known_commit(repo_id: str, repo_type: str, revision: str | None) -> str | None:
    """Return the commit that a revision meant when this machine last asked; None if unknown."""
    name = revision or constants.DEFAULT_REVISION
    if COMMIT.fullmatch(name):
        return name
    try:
        text = _reference(repo_id, repo_type, name).read_text(encoding="utf-8").strip()
    except (OSError, ValueError):
        return None
    return text if COMMIT.fullmatch(text) else None


def _reference(repo_id: str, repo_type: str, name: str) -> Path:
    """Return the file in the client's cache that holds the commit of a branch or tag.

    https://huggingface.co/docs/huggingface_hub/guides/manage-cache
    """
    folder = repo_folder_name(repo_id=repo_id, repo_type=repo_type)
    return Path(constants.HF_HUB_CACHE, folder, "refs", name)


def snapshot_of(repo_id: str, repo_type: str, commit: str) -> Path:
    """Return the folder in the client's cache for the files of a commit."""
    folder = repo_folder_name(repo_id=repo_id, repo_type=repo_type)
    return Path(constants.HF_HUB_CACHE, folder, "snapshots", commit)


def download(repo_id: str, repo_type: str, commit: str, names: Iterable[str]) -> Path:
    """Download those of some files of a commit that exist; return the folder they are in.

    Raises:
        OSError, ValueError, HTTPError, RuntimeError: The client's errors.
    """
    prepare_client()

    def one(name: str) -> None:
        with suppress(RemoteEntryNotFoundError):
            repeated(partial(hf_hub_download, repo_id, name, repo_type=repo_type, revision=commit))

    folder, wanted = snapshot_of(repo_id, repo_type, commit), list(dict.fromkeys(names))
    missing = [name for name in wanted if not (folder / name).exists()]
    if len(missing) == 1:
        one(missing[0])
    elif missing:
        with ThreadPoolExecutor(min(8, len(missing))) as threads:
            list(threads.map(one, missing))
    return folder


def fetched(repo_id: str, revision: str | None, most: Mapping[str, int]) -> Path:
    """Download those files of a model that exist; return the folder they are in.

    With HF_HUB_OFFLINE=1 nothing is downloaded: the folder has what was downloaded before.

    Args:
        repo_id: The model.
        revision: A branch, tag or commit; None for `main`.
        most: Name -> the most bytes of the file. All sizes are checked before any download.

    Raises:
        DatasetError: A file is too large or damaged, or the Hub does not give it.
    """

    def size_of(name: str) -> Any:
        info = repeated(lambda: hf_hub_download(repo_id, name, revision=commit, dry_run=True))
        return info.file_size

    try:
        commit = commit_of(repo_id, "model", revision)
        asked: Mapping[str, int] = {} if constants.HF_HUB_OFFLINE else most
        for name, limit in asked.items():
            with suppress(RemoteEntryNotFoundError):
                size = size_of(name)
                if size is not None and size > limit:
                    raise DatasetError(f"{repo_id}: {name} has {size:,} bytes, more than {limit:,}")
        folder = download(repo_id, "model", commit, asked)
    except DatasetError:
        raise
    except UNAVAILABLE as error:
        reason = f"{repo_id} is not a folder, and cannot be loaded from the Hub"
        raise DatasetError(f"{reason}: {reason_of(error)}") from error
    for name in most:
        if (folder / name).exists():
            require_whole(folder / name)
    return folder


def download_again(path: Path) -> bool:
    """Replace a damaged file in the client's cache; return whether that was possible."""
    try:
        inside = path.absolute().relative_to(Path(constants.HF_HUB_CACHE).absolute())
    except ValueError:
        return False
    match = _CACHED.fullmatch(inside.as_posix())
    if match is None or constants.HF_HUB_OFFLINE:
        return False
    repo_type, owner, name, commit, file = match.groups()
    prepare_client()
    get = partial(hf_hub_download, repo_type=repo_type, revision=commit, force_download=True)
    try:
        repeated(partial(get, f"{owner}/{name}", file))
    except UNAVAILABLE:
        return False
    return True


def require_whole(path: Path) -> None:
    """Compare a small file in the client's cache with the hash that the Hub gave for it.

    The name of its blob is that hash. A damaged file is downloaded once more.

    Raises:
        DatasetError: The file has another hash still.
    """
    if not _has_its_hash(path) and not (download_again(path) and _has_its_hash(path)):
        raise DatasetError(f"{path} is damaged: its content has not the hash that the Hub gave")


def _has_its_hash(path: Path) -> bool:
    """Return whether a file has the hash that names its blob; also true if that is no hash."""
    if not path.is_symlink():  # As where the system has no links.
        return True
    digest, content = path.readlink().name, path.read_bytes()
    if re.fullmatch("[0-9a-f]{64}", digest):
        return hashlib.sha256(content).hexdigest() == digest
    if COMMIT.fullmatch(digest):  # Git's, or of a mirror that names files by their SHA-1.
        blob = b"blob %d\0%b" % (len(content), content)
        return digest in (hashlib.sha1(blob).hexdigest(), hashlib.sha1(content).hexdigest())
    return True
