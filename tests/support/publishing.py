"""Publishing to the Hub on loopback by the real command line, and looking at what came of it.

A release is published in this process, which is quicker. It gets one of its own where it loads a
sample, where it is killed, and where its environment has variables of which the Hub's client reads
some when it is imported.
"""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import chdir, contextmanager, suppress
from pathlib import Path

import pytest
from hub.faults import Rule
from hub.local_hub import LocalHub
from hub.state import TOKENS, Exchange
from huggingface_hub import constants, file_download
from huggingface_hub.utils import disable_progress_bars

from support.commands import answered
from support.quick_python import python

ROOT = Path(__file__).parents[2]
REPO = "user/labyrinth"
SECONDS = 600
MADE_BY_THE_HUB = ".gitattributes"
STRICT = ("-W", "error", "-W", "ignore:Use 'content=<...>':DeprecationWarning")
"""The client's own uploads through LFS deserve the second warning."""

UNVERIFIED = """
import sys
from pipeline.__main__ import main
from pipeline.release import publish

publish.loaded = lambda *_: ""
sys.exit(main())
"""
"""The program without a sample loaded, which takes longer than all else; a test asks for it."""


@pytest.fixture
def local_hub(tmp_path: Path) -> Iterator[LocalHub]:
    """Yield a Hub on loopback that is new and empty; the test fails if the server itself does."""
    with LocalHub(tmp_path / "hub") as hub:
        yield hub
    assert not hub.failures, "\n".join(hub.failures)


def asked(data_dir: Path, version: str, *options: str, repo: str = REPO) -> list[str]:
    """Return the options of a release."""
    own = f"data_dir={data_dir}", f"publish.repo_id={repo}", f"publish.version={version}"
    return ["stages=[publish]", *own, *options]


def command(*options: str, verify: bool) -> list[str]:
    """Return the arguments of a Python that publishes."""
    program = [str(ROOT / "run.py")] if verify else ["-c", UNVERIFIED]
    return [*STRICT, *program, *options]


def environment(hub: LocalHub, token: str | None = "write", **more: str) -> dict[str, str]:
    """Return the environment of a fresh process, whose temporary files are the Hub's."""
    temporary = hub.folder / "temporary"
    temporary.mkdir(exist_ok=True)
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    # Without a git repository: a commit to it during the tests would change the card.
    own = {"TMPDIR": str(temporary), "PYTHONPATH": path, "GIT_DIR": str(temporary)}
    own |= {"QUICK_PYTHON_SLEEP": "0.02"}
    variables = hub.env(token) | own
    return variables | {"XDG_CACHE_HOME": variables["HF_HOME"]} | more


@contextmanager
def connected(hub: LocalHub, token: str | None = "write") -> Iterator[pytest.MonkeyPatch]:
    """Let this process talk to a Hub with an empty cache, and not wait before it repeats a call.

    The client has read the environment already, so what it has made of it is changed.
    """
    home = Path(hub.env()["HF_HOME"])
    changed = {
        "ENDPOINT": hub.url,
        "HUGGINGFACE_CO_URL_TEMPLATE": f"{hub.url}/{{repo_id}}/resolve/{{revision}}/{{filename}}",
        "HF_HUB_CACHE": str(home / "hub"),
        "HF_HUB_OFFLINE": False,
        "HF_HUB_DISABLE_XET": True,
    }
    disable_progress_bars()
    with pytest.MonkeyPatch.context() as patch:
        for name, value in changed.items():
            patch.setattr(constants, name, value)
        patch.setenv("LABYRINTH_HUB_SECONDS", "5")
        patch.setattr(file_download.time, "sleep", lambda _: None)
        patch.delenv("HF_TOKEN", raising=False)
        if token is not None:
            patch.setenv("HF_TOKEN", TOKENS[token])
        yield patch


def publish_here(
    hub: LocalHub, token: str | None, *options: str, seconds: str
) -> subprocess.CompletedProcess[str]:
    """Return what became of a release that this process makes, without a sample loaded.

    Args:
        hub: The Hub.
        token: The label of a token; None for none.
        options: Those of the release.
        seconds: Without a byte, after which a call fails.
    """
    own = environment(hub, token)
    with connected(hub, token) as patch, chdir(hub.folder), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Use 'content=<...>'", DeprecationWarning)
        for name in ("TMPDIR", "GIT_DIR", "XDG_CACHE_HOME"):
            patch.setenv(name, own[name])
        patch.setenv("LABYRINTH_HUB_SECONDS", seconds)
        patch.setattr(tempfile, "tempdir", own["TMPDIR"])
        patch.setattr("pipeline.release.publish.loaded", lambda *_: "")
        return answered(*options)


def run_python(
    hub: LocalHub, *arguments: str | Path, token: str | None = "write", **more: str
) -> subprocess.CompletedProcess[str]:
    """Return what became of a Python with these arguments; `more` is in its environment."""
    return subprocess.run(
        [python(), *map(str, arguments)],
        env=environment(hub, token, **more),
        cwd=hub.folder,
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=False,
        timeout=SECONDS,
    )


def publish(
    hub: LocalHub,
    data_dir: Path,
    version: str = "1.0.0",
    *options: str,
    token: str | None = "write",
    repo: str = REPO,
    verify: bool = False,
    seconds: str = "5",
    **more: str,
) -> subprocess.CompletedProcess[str]:
    """Return what became of a release; `more` are variables of its environment."""
    options = asked(data_dir, version, *options, repo=repo)
    if verify or more:
        return run_python(hub, *command(*options, verify=verify), token=token, **more)
    return publish_here(hub, token, *options, seconds=seconds)


def run_script(
    hub: LocalHub, script: str, *arguments: str | Path, token: str | None = None, **more: str
) -> subprocess.CompletedProcess[str]:
    """Return what a Python script against a Hub prints, in a process whose caches are empty."""
    done = run_python(hub, "-c", script, *arguments, token=token, **more)
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def published(
    hub: LocalHub, data_dir: Path, version: str = "1.0.0", *options: str, verify: bool = False
) -> str:
    """Return what a release that succeeds prints."""
    done = publish(hub, data_dir, version, *options, verify=verify)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def error_of(done: subprocess.CompletedProcess[str]) -> str:
    """Return the one line that a release that fails ends with."""
    assert done.returncode == 1, done.stdout + done.stderr
    *others, last = done.stderr.splitlines()
    # The client says what it repeats; a person never sees a traceback.
    said = ("Retry", "thrown while requesting")
    assert all(any(part in line for part in said) for line in others), done.stderr
    assert last.startswith("error: ")
    return last.removeprefix("error: ")


@contextmanager
def publishing(
    hub: LocalHub,
    data_dir: Path,
    version: str = "1.0.0",
    *options: str,
    until: Rule,
    verify: bool = False,
    **more: str,
) -> Iterator[subprocess.Popen[str]]:
    """Publish until a call is held; the process is killed in the end, with all that it started."""
    with subprocess.Popen(
        [python(), *command(*asked(data_dir, version, *options), verify=verify)],
        env=environment(hub, **more),
        cwd=hub.folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            while not until.reached.wait(0.05):
                assert process.poll() is None, (until, *process.communicate())
            yield process
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.communicate()  # It has ended when its files are closed.


def last_line(process: subprocess.Popen[str]) -> str:
    """Return the last line that a process writes to standard error until it ends."""
    _, errors = process.communicate()
    return errors.splitlines()[-1]


def kill_in(hub: LocalHub, held: Rule, data_dir: Path, version: str, *options: str) -> None:
    """Publish, and kill it while a call is held."""
    with publishing(hub, data_dir, version, *options, until=held):
        pass
    hub.faults.clear()
    hub.wait_until_quiet()


def built(data_dir: Path) -> dict[str, str]:
    """Return the SHA-256 of all files of a folder but the lists of its configs."""
    return {
        path.relative_to(data_dir).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in data_dir.rglob("*")
        if path.is_file() and not path.match("*/*x*/SHA256SUMS")
    }


def held(
    hub: LocalHub, revision: str = "main", repo: str = REPO, kind: str = "dataset"
) -> dict[str, str]:
    """Return the SHA-256 of all files of a revision but the one that the Hub makes."""
    tree = hub.tree(repo, revision, kind)
    return {path: entry.sha256 for path, entry in tree.items() if path != MADE_BY_THE_HUB}


def large(hub: LocalHub, revision: str = "main") -> set[str]:
    """Return the SHA-256 of the contents that are not in git itself."""
    return {entry.sha256 for entry in hub.tree(REPO, revision).values() if entry.is_lfs}


def changes(hub: LocalHub, since: int = 0) -> list[Exchange]:
    """Return the calls that may change something, whatever was answered."""
    return [call for call in hub.log.find(since=since) if call.method not in ("GET", "HEAD")]
