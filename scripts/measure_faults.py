"""Print what becomes of every call of a load if the Hub answers it wrongly, as a table.

    python scripts/measure_faults.py [CALL [FAULT]]

A Hub on loopback answers each call in turn with each fault, once and always. A cell tells what a
person gets: `right` for the right rows, else the error; `WRONG` and `TRACEBACK` are defects. A load
is made with an empty cache, with the files of an older commit in it, and as a stream.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests" / "support"), str(ROOT)]

from hub.faults import UNLIMITED, Faults  # noqa: E402
from hub.local_hub import SETTINGS, LocalHub  # noqa: E402
from hub.state import TOKENS  # noqa: E402

REPO, MODEL, CONFIG = "user/labyrinth", "user/planner", "2x3"
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
            *call, status=200, body=text.encode(), headers={"Content-Type": "application/json"}, **how
        )
        for text in ("{}", "null", "[]")
    },
    "empty": lambda faults, *call, **how: faults.answer(*call, status=200, **how),
    "lost reply": lambda faults, *call, **how: faults.lose_response(*call, **how),
    "stale main": lambda faults, *call, **how: faults.stale(*call, **how),
    "foreign commit": lambda faults, *call, **how: faults.intrude(*call, **how),
}
"""Name -> how the faults of a Hub strike a call."""


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory(prefix="labyrinth-faults-") as place:
        os.environ |= SETTINGS | {
            "HF_HOME": f"{place}/home",
            "HF_TOKEN": TOKENS["write"],
            "XDG_CACHE_HOME": f"{place}/caches",
            "HF_HUB_DOWNLOAD_TIMEOUT": "1",
            "HF_HUB_ETAG_TIMEOUT": "1",
            "LABYRINTH_HUB_SECONDS": "1",
        }
        with LocalHub(Path(place, "hub")) as hub:
            os.environ["HF_ENDPOINT"] = hub.url
            Loads(hub, Path(place)).table(*sys.argv[1:])


class Loads:
    """Loads from a faulty Hub, each with a cache of its own."""

    def __init__(self, hub: LocalHub, place: Path) -> None:
        from making import make

        self.hub, self.place = hub, place
        for name, seed in (("old", 1), ("new", 0)):
            make(place / name, CONFIG, labyrinths=3, random_steps=5, seed=seed)
            if name == "old":
                hub.create_repo(REPO)
            for path in sorted((place / name).glob(f"{CONFIG}/*")):
                hub.commit(REPO, path.relative_to(place / name).as_posix(), path.read_bytes())
            if name == "old":
                hub.tag(REPO, "0.9.0")
        self.saved = hub.repositories["dataset", REPO]
        time.sleep = lambda _: None

    def load(self, way: str) -> Any:
        """Return the values of a load."""
        import labyrinth_core as lib

        if way == "stream":
            return [e.actions.tolist() for e in lib.stream_episodes(REPO, CONFIG, image_size=8)]
        if way == "some":
            found = lib.load_transitions(REPO, CONFIG, labyrinths=2, image_size=8, cache_dir=False)
        elif way == "hf://":
            found = lib.load_transitions(
                f"hf://datasets/{REPO}", CONFIG, image_size=8, cache_dir=False
            )
        else:
            found = lib.load_transitions(REPO, CONFIG, image_size=8, cache_dir=False)
        return found.observations.tobytes(), found.actions.tolist()

    def fresh(self, way: str) -> None:
        """Give the client an empty cache, or one with an older commit, and the Hub its state."""
        from huggingface_hub import constants
        from huggingface_hub.hf_file_system import HfFileSystem

        HfFileSystem.clear_instance_cache()
        cache = Path(tempfile.mkdtemp(dir=self.place))
        constants.HF_HUB_CACHE = str(cache)
        self.hub.faults.clear()
        repository = self.hub.repositories["dataset", REPO]
        repository.refs["refs/heads/main"] = self.head
        if way == "warm":
            repository.refs["refs/heads/main"] = repository.refs["refs/tags/0.9.0"]
            self.load(way)
            repository.refs["refs/heads/main"] = self.head

    def table(self, only_call: str = "", only_fault: str = "") -> None:
        """Print all cells, or those whose call and fault contain a text."""
        self.head = self.hub.refs(REPO)["refs/heads/main"]
        defects = Counter()
        for way in ("empty cache", "warm", "some", "stream", "hf://"):
            self.fresh(way)
            since = len(self.hub.log)
            right = self.load(way)
            asked = self.hub.log.find(since=since)
            calls = dict.fromkeys((each.method, pattern_of(each.path)) for each in asked)
            print(f"\n{way}: {len(calls)} calls")
            for method, path in calls:
                if only_call not in f"{method} {path}":
                    continue
                for name, fault in FAULTS.items():
                    if only_fault not in name:
                        continue
                    cells = []
                    for times in (1, UNLIMITED):
                        self.fresh(way)
                        fault(self.hub.faults, method, path, times=times)
                        cells.append(self.cell(way, right))
                        self.hub.faults.clear()
                        self.hub.wait_until_quiet()
                        if (after := self.cell(way, right)) != "right":
                            cells[-1] += f"; THEN {after}"
                    for cell in cells:
                        defects[re.split("[:;]", cell)[0] if cell.isupper() else "right" if cell == "right" else "error" if cell.startswith("error") else cell[:20]] += 1
                    print(f"{method:5}{path[-44:]:45}{name:17}{cells[0]:.60} | {cells[1]:.150}")
        print(defects)

    def cell(self, way: str, right: Any) -> str:
        """Return what becomes of a load."""
        from labyrinth_core import DatasetError

        try:
            return "right" if self.load(way) == right else "WRONG"
        except DatasetError as error:
            text = str(error)
            return f"error: {text.partition('Hub: ')[2] or text}" if "\n" not in text else "LINES"
        except Exception as error:
            return f"TRACEBACK {type(error).__name__}: {error}".replace("\n", " ")


def pattern_of(path: str) -> str:
    """Return a pattern for a path, with any commit."""
    return re.sub("[0-9a-f]{40}", "[0-9a-f]{40}", path) + "$"


if __name__ == "__main__":
    main()
