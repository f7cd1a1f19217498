"""Running the real clients against the Hub on loopback, each time in a fresh process."""

from __future__ import annotations

import json
import subprocess
import urllib.request
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hub.local_hub import LocalHub

REPO = "user/labyrinth"
PRELUDE = """
import hashlib, io, json, os, sys, warnings
from pathlib import Path
from huggingface_hub import CommitOperationAdd, CommitOperationDelete, HfApi
from huggingface_hub import hf_hub_download, snapshot_download
from huggingface_hub.utils import logging
logging.set_verbosity_error()
api = HfApi()
R = "user/labyrinth"
D = {"repo_type": "dataset"}
results = {}

def attempt(name, call, *arguments, **options):
    try:
        result = call(*arguments, **options)
        results[name] = result if type(result) in (str, list) else "done"
    except Exception as error:
        status = getattr(getattr(error, "response", None), "status_code", None)
        results[name] = [type(error).__name__, status]

def add(path, content):
    return CommitOperationAdd(path, content)

def commit(*operations, **options):
    return api.create_commit(R, operations, commit_message="Change", **D, **options).oid
"""
EPILOGUE = "\nprint(json.dumps(results))\n"
CARD = """---
configs:
- config_name: 3x3
  default: true
  data_files:
  - {split: train, path: 3x3/train-*.parquet}
  - {split: test, path: 3x3/test-*.parquet}
dataset_info:
- config_name: 3x3
  splits:
  - {name: train, num_examples: 4000, num_bytes: 1}
  - {name: test, num_examples: 2000, num_bytes: 1}
---
# Labyrinths
"""
RELEASE = """
import numpy, pyarrow, pyarrow.parquet

def shard(seed):
    rng = numpy.random.default_rng(seed)
    pictures = [rng.bytes(30) for _ in range(2000)]
    buffer = io.BytesIO()
    table = pyarrow.table({"picture": pictures, "action": rng.integers(0, 4, 2000)})
    pyarrow.parquet.write_table(table, buffer)
    return buffer.getvalue()

def release(seeds, card):
    names = "3x3/train-00000-of-00002", "3x3/train-00001-of-00002", "3x3/test-00000-of-00001"
    contents = {f"{name}.parquet": shard(seed) for name, seed in zip(names, seeds)}
    additions = [add(path, content) for path, content in contents.items()]
    base = api.repo_info(R, **D).sha
    for addition in additions:
        api.preupload_lfs_files(R, additions=[addition], **D)
    oid = commit(*additions, add("README.md", card.encode()), parent_commit=base)
    hashes = {path: hashlib.sha256(content).hexdigest() for path, content in contents.items()}
    results.update(base=base, oid=oid, hashes=hashes)
"""


def run(hub: LocalHub, script: str, *arguments: str, **options: Any) -> dict[str, Any]:
    """Return what a script, run by a fresh process, put into `results`."""
    done = hub.run(PRELUDE + script + EPILOGUE, *arguments, **options)
    return json.loads(done.stdout.splitlines()[-1])


def release(hub: LocalHub, seeds: tuple[int, int, int] = (1, 2, 3)) -> dict[str, Any]:
    """Return what was released: three shards and a card."""
    script = f"api.create_repo(R, exist_ok=True, **D)\nrelease({seeds!r}, {CARD!r})"
    return run(hub, RELEASE + script)


def open_url(url: str, **headers: str) -> tuple[int, bytes, dict[str, str]]:
    """Return status, body and headers of an answer."""
    request = urllib.request.Request(url, headers=headers)
    with urllib.request.urlopen(request, timeout=10) as answer:
        return answer.status, answer.read(), dict(answer.headers)


def control(hub: LocalHub, **commands: dict[str, Any]) -> dict[str, Any]:
    """Return what the control endpoint answers, as another process would use it."""
    body = json.dumps(commands).encode()
    with urllib.request.urlopen(f"{hub.url}/__control__", data=body, timeout=10) as answer:
        return json.load(answer)


@contextmanager
def killing(command: Sequence[str | Path], **options: Any) -> Iterator[subprocess.Popen[str]]:
    """Yield a process that is killed at the end, if it still runs."""
    with subprocess.Popen(command, text=True, **options) as process:
        try:
            yield process
        finally:
            process.kill()
