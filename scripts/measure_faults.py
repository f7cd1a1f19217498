"""Print what becomes of a release and of a load if the Hub answers one of their calls wrongly.

    python scripts/measure_faults.py                 # all: some minutes
    python scripts/measure_faults.py WAY CALL FAULT  # those whose names contain these texts

A Hub on loopback answers each call in turn with each fault, once and always. Each cell tells how
the release or the load ends: `right`, or with the one line of its error. A load must not give other
rows. After each release the Hub must hold the old release or the new one, whole, a tag must be on a
right tree, and the same command must finish without the fault. Cells that break this begin with a
word in capitals; the script counts them at the end. After the table of a way it prints the same
cells as letters: right, error, or the older commit.
"""

from __future__ import annotations

import copy
import io
import os
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT)]

from hub.faults import UNLIMITED  # noqa: E402
from hub.local_hub import SETTINGS, LocalHub  # noqa: E402
from hub.state import TOKENS  # noqa: E402

REPO, CONFIG = "user/labyrinth", "2x3"
AS_JSON = {"Content-Type": "application/json"}
HTML = b"<html><body>Welcome to Hotel Lorraine. Log in for the Internet.</body></html>"

FAULTS: dict[str, Callable[..., Any]] = {
    **{
        f"{status}": lambda faults, *call, status=status, **how: faults.fail(
            *call, status=status, **how
        )
        for status in (401, 403, 404, 412, 500, 502, 503)
    },
    "429, Retry-After": lambda faults, *call, **how: faults.fail(
        *call, status=429, headers={"Retry-After": "1"}, **how
    ),
    "dropped": lambda faults, *call, **how: faults.drop(*call, **how),
    "silence": lambda faults, *call, **how: faults.hold(*call, **how),
    "cut body": lambda faults, *call, **how: faults.cut(*call, **how),
    "wrong byte": lambda faults, *call, **how: faults.damage(*call, **how),
    "HTML": lambda faults, *call, **how: faults.answer(
        *call, status=200, body=HTML, headers={"Content-Type": "text/html"}, **how
    ),
    **{
        text: lambda faults, *call, text=text, **how: faults.answer(
            *call,
            status=200,
            body=text.encode(),
            headers=AS_JSON,
            **how,
        )
        for text in ("{}", "null", "[]")
    },
    "empty": lambda faults, *call, **how: faults.answer(*call, status=200, **how),
    "lost reply": lambda faults, *call, **how: faults.lose_response(*call, **how),
    "stale main": lambda faults, *call, **how: faults.stale(*call, **how),
    "foreign commit before": lambda faults, *call, **how: faults.intrude(*call, **how),
    "foreign commit after": lambda faults, *call, **how: faults.intrude(*call, after=True, **how),
    "done, {}": lambda faults, *call, **how: faults.answer(
        *call, status=200, body=b"{}", after=True, **how
    ),
    "done, 500": lambda faults, *call, **how: faults.answer(*call, status=500, after=True, **how),
}
"""Name -> how the faults of a Hub strike a call."""


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory(prefix="labyrinth-faults-") as place:
        os.environ |= SETTINGS | {
            "HF_HOME": f"{place}/home",
            "HF_TOKEN": TOKENS["write"],
            "XDG_CACHE_HOME": f"{place}/caches",
            "HF_HUB_DOWNLOAD_TIMEOUT": "2",
            "HF_HUB_ETAG_TIMEOUT": "2",
            "LABYRINTH_HUB_SECONDS": "2",
        }
        with LocalHub(Path(place, "hub")) as hub:
            os.environ["HF_ENDPOINT"] = hub.url
            from huggingface_hub import file_download

            file_download._ETAG_RETRY_TIMEOUT = 1
            time.sleep = lambda _: None  # Before all retries.
            Table(hub, Path(place)).print(*sys.argv[1:])


class Table:
    """What becomes of loads and releases, each with a cache of its own."""

    def __init__(self, hub: LocalHub, place: Path) -> None:
        from support.making import make

        from pipeline.release.card import write_card
        from pipeline.release.texts import Release

        self.hub, self.place, self.ends = hub, place, Counter[str]()
        for version, (name, seed) in {"0.9.0": ("old", 1), "1.0.0": ("new", 0)}.items():
            with redirect_stdout(io.StringIO()):
                make(place / name, CONFIG, labyrinths=3, random_steps=5, seed=seed)
            write_card(place / name, Release(REPO, version))
        hub.create_repo(REPO)
        self.release("old", "0.9.0")
        self.before = copy.deepcopy(hub.repositories["dataset", REPO])
        self.blobs = {*hub.blobs.iterdir()}
        self.release("new", "1.0.0")
        self.after = copy.deepcopy(hub.repositories["dataset", REPO])

    def release(self, name: str = "new", version: str = "1.0.0") -> str:
        """Release a dataset, and return how it ends."""
        from huggingface_hub import HfApi

        from pipeline.release import publish
        from pipeline.release.faults import explained
        from pipeline.release.options import PublishOptions
        from pipeline.release.repository import Repository, listed

        publish.loaded = lambda *_: ""  # Loads are below.
        options = PublishOptions(repo_id=REPO, version=version)
        folder = self.place / name
        with redirect_stdout(io.StringIO()), explained(REPO):
            repository = Repository(HfApi(), REPO, "dataset")
            publish.release(options, repository, listed(folder), folder)
        return "right"

    def load(self, way: str) -> Any:
        """Return the values of a load."""
        import labyrinth_core as lib

        if way == "stream":
            return [e.actions.tolist() for e in lib.stream_episodes(REPO, CONFIG, image_size=8)]
        source = f"hf://datasets/{REPO}" if way == "hf://" else REPO
        how = {"labyrinths": 2} if way == "some" else {}
        found = lib.load_transitions(source, CONFIG, image_size=8, cache_dir=False, **how)
        return found.observations.tobytes(), found.actions.tolist()

    def fresh(self, way: str) -> None:
        """Give the client an empty cache, or one with an older commit, and the Hub its state."""
        from huggingface_hub import constants
        from huggingface_hub.hf_file_system import HfFileSystem

        HfFileSystem.clear_instance_cache()
        constants.HF_HUB_CACHE = tempfile.mkdtemp(dir=self.place)
        self.hub.faults.clear()
        self.hub.wait_until_quiet()
        old, new = map(copy.deepcopy, (self.before, self.after))
        if way == "warm":
            self.hub.repositories["dataset", REPO] = old
            self.load(way)
        self.hub.repositories["dataset", REPO] = old if way == "release" else new
        if way == "release":
            for blob in {*self.hub.blobs.iterdir()} - self.blobs:
                blob.rename(self.place / blob.name)
        else:
            for blob in self.place.glob("?" * 64):
                blob.rename(self.hub.blobs / blob.name)

    def print(self, only_way: str = "", only_call: str = "", only_fault: str = "") -> None:
        """Print all cells, or those whose way, call and fault contain these texts."""
        for way in ("release", "empty cache", "warm", "some", "stream", "hf://"):
            if only_way not in way:
                continue
            self.fresh(way)
            since = len(self.hub.log)
            right = self.release() if way == "release" else self.load(way)
            self.older = []
            if way != "release":
                self.hub.faults.stale("GET", "/revision/main$", times=UNLIMITED)
                self.older = [self.load(way)]
            asked = self.hub.log.find(since=since)
            calls = Counter((each.method, pattern_of(each.path)) for each in asked)
            print(f"\n## {way}: {len(calls)} kinds of calls\n")
            print("| call | fault | once | always |\n|---|---|---|---|")
            letters: dict[str, list[str]] = {}
            for (method, path), count in calls.items():
                short = path.replace("/api/datasets/user/labyrinth", "").replace(HASH, "*")[:-1]
                for name, fault in FAULTS.items():
                    if only_call not in f"{method} {path}" or only_fault not in name:
                        continue
                    hows = [{"times": 1}, {"times": UNLIMITED}]
                    if way == "release" and 1 < count < 4:  # Also the last of them.
                        hows.append({"times": 1, "skip": count - 1})
                    cells = [self.cell(way, right, fault, method, path, how) for how in hows]
                    print(f"| {method} {short} | {name} | {' | '.join(cells)} |", flush=True)
                    told = "".join("o" if cell[:9] == "the older" else cell[0] for cell in cells)
                    letters.setdefault(f"{method} {short}", []).append(told)
            width = max(map(len, letters), default=0)
            print("\n".join(["", *(f"{c:{width}} {' '.join(own)}" for c, own in letters.items())]))
        print()
        for end, count in sorted(self.ends.items()):
            print(f"{count:5} {end}")

    def cell(
        self, way: str, right: Any, fault: Callable[..., Any], method: str, path: str, how: Any
    ) -> str:
        """Return how a release or a load ends that a fault strikes."""
        self.fresh(way)
        fault(self.hub.faults, method, path, **how)
        end = self.ended(way, right)
        self.hub.faults.clear()
        self.hub.wait_until_quiet()
        problem = self.problem() if way == "release" else ""
        again = self.ended(way, right)
        if way == "release" and again.endswith("other data (2x3/manifest.json)"):
            again = "right"
        if not problem and again != "right":
            problem = f"NEVER: {again}"
        if not problem and way == "release":
            problem = self.problem(finished=True)
        end = problem or end
        self.ends[end.partition(" ")[0] if end.split()[0].isupper() else end[:5]] += 1
        return end[:160].replace("|", "/")

    def ended(self, way: str, right: Any) -> str:
        """Return how a release or a load ends."""
        from labyrinth_core import DatasetError

        try:
            found = self.release() if way == "release" else self.load(way)
        except DatasetError as error:
            text = str(error)
            told = text.partition("available on the Hub: ")[2] or text
            return f"error: {told}" if "\n" not in text else f"LINES {text!r}"
        except Exception as error:
            return f"TRACEBACK {type(error).__name__}: {error}".replace("\n", " ")
        if found == right:
            return "right"
        return "the older commit, whole" if found in self.older else "WRONG rows"

    def problem(self, *, finished: bool = False) -> str:
        """Return what is wrong with the Hub after a release, or nothing."""
        repository = self.hub.repositories["dataset", REPO]
        foreign = "NEWS.md"
        trees = [self.before.find("main").tree, self.after.find("main").tree]
        head = {p: e for p, e in repository.find("main").tree.items() if p != foreign}
        if head not in trees:
            return "HALF a release is on main"
        if repository.refs.get("refs/tags/0.9.0") != self.before.refs["refs/tags/0.9.0"]:
            return "MOVED is the old tag"
        tag = repository.refs.get("refs/tags/1.0.0")
        if tag is None:
            return "UNTAGGED" if finished else ""
        commit = repository.commits[tag]
        tagged = {p: e for p, e in commit.tree.items() if p != foreign}
        if tagged != trees[1]:
            return "TAGGED is a wrong tree"
        return "" if commit.title == "Release 1.0.0" else "TAGGED is a stranger's commit"


HASH = "[0-9a-f]{40}"


def pattern_of(path: str) -> str:
    """Return a pattern for a path, with any commit or content."""
    path = re.sub("[0-9a-f]{64}", "[0-9a-f]{64}", path)
    return re.sub("(?<![0-9a-f])[0-9a-f]{40}(?![0-9a-f])", HASH, path) + "$"


if __name__ == "__main__":
    main()
