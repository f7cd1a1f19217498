"""Check that other libraries read our data with their own code, and get what our loader returns.

    python scripts/check_clients.py --folder clients
    python scripts/check_clients.py --folder clients --only Minari --again

A small dataset is built, exported in all formats, and released on a fake Hub on this machine. Then
each client is installed in its own virtual environment, where a script of scripts/clients/ reads
the data, compares every value, and trains for a few steps if the client can train. The results are
printed as a table, for docs/clients.md. They are also saved in the folder, so that an interrupted
check continues; --again repeats finished clients.

LeRobot needs python3.12 on the PATH. pip installs the packages as its environment variables and its
configuration say, with a constraint on torch, whose CPU-only build is enough.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = ROOT / "scripts" / "clients"
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from hub.local_hub import LocalHub  # noqa: E402

from labyrinth_core import load_episodes  # noqa: E402
from labyrinth_core.data.manifest import Manifest  # noqa: E402

TORCH = "torch==2.13.0"
CONFIG, SPLITS, FORMATS = "5x5", ("train", "random"), ("minari", "imitation", "lerobot")
SECONDS = 1800
"""The time limit of each installation step, and of the script of a client."""


@dataclass(frozen=True)
class Client:
    """A library that reads our data."""

    name: str
    script: str
    requirements: tuple[str, ...]
    bare: str = ""
    """A package to install without its dependencies."""
    stands_in: bool = False
    """Whether a stub replaces torchvision."""
    python: str = sys.executable
    """The interpreter that the client needs, such as `python3.12`."""
    environment: str = ""
    """The client whose environment it shares; by default it has its own."""


LEROBOT = Client(
    "LeRobot",
    "read_lerobot.py",
    (
        *("datasets>=4.8,<5", "huggingface-hub>=1.6,<2", "jsonlines", "packaging<26", "torch"),
        *("numpy<2.3", "pandas<3", "pyarrow<30", "einops", "av>=15,<16", "draccus>=0.11.6,<0.12"),
        *("termcolor", "deepdiff", "accelerate", "gymnasium<2", "safetensors", "pillow<13"),
        *("tqdm", "requests", "torchvision", "opencv-python-headless<4.14"),
    ),
    bare="lerobot==0.6.1",
    python="python3.12",
)
MINARI_CLIENT = Client("Minari", "read_minari.py", ("minari[hdf5,hf]==0.5.4", "pillow"))
CLIENTS = (
    MINARI_CLIENT,
    replace(MINARI_CLIENT, name="Minari-release", environment="Minari"),
    Client("imitation", "read_imitation.py", ("imitation==1.0.1", "numpy<2", "pyarrow<22")),
    LEROBOT,
    replace(LEROBOT, name="LeRobot-release", environment="LeRobot"),
    replace(LEROBOT, name="LeRobot-policy", script="evaluate_lerobot.py", environment="LeRobot"),
    replace(LEROBOT, name="EnvHub", script="use_envhub.py", environment="LeRobot"),
    Client(
        "IL-Datasets",
        "read_il_datasets.py",
        (
            *("datasets==3.4.1", "torch", "pandas", "tqdm", "psutil", "shimmy>=0.2.1", "pillow"),
            *("stable_baselines3", "sb3_contrib", "huggingface_sb3", "tensorboard-wrapper", "gym"),
        ),
        bare="IL-Datasets==1.0.0",
        stands_in=True,
    ),
    Client("inspect-ai", "read_inspect.py", ("inspect-ai==0.3.285", "datasets>=4", "numpy")),
    Client("maze-dataset", "count_maze_dataset.py", ("maze-dataset==1.4.2", "muutils<0.9")),
)


def make(folder: Path, hub: LocalHub) -> None:
    """Make the dataset, its exports, its release, and the reference data from our loader."""
    data, done = folder / "data", folder / "reference" / "done"
    if done.exists():
        return
    common = [sys.executable, str(ROOT / "run.py"), "size=5", f"data_dir={data}"]
    commands = [["stages=[build,questions,card]"]] + [
        ["stages=[export]", f"export.format={format_}", f"export.folder={folder / 'exports'}"]
        for format_ in FORMATS
    ]
    for command in commands:
        subprocess.run([*common, *command], check=True)
    release = ["stages=[publish]", "publish.repo_id=user/labyrinth", "publish.version=1.0.0"]
    for more in (
        ["publish.env=user/labyrinth"],
        ["export.format=minari", "publish.export=user/labyrinth-minari"],
        ["export.format=lerobot", "publish.export=user/labyrinth-lerobot", "export.splits=[train]"],
    ):
        command = [*common, *release, *more, f"export.folder={folder / 'exports'}"]
        subprocess.run(command, check=True, env=os.environ | hub.env("write"))
    done.parent.mkdir(exist_ok=True)
    rows = pq.read_table(data / CONFIG / Manifest.TABLE).to_pylist()
    table = json.dumps([[*row.values()] for row in rows])
    (done.parent / "labyrinths.json").write_text(table, encoding="utf-8")
    for split in SPLITS:
        np.savez(done.parent / f"{split}.npz", **reference(data, split))
        np.savez(done.parent / f"{split}-600.npz", **large_pairs(data, split))
    done.touch()


def reference(data: Path, split: str) -> dict[str, Any]:
    """Return all episodes of a split, concatenated, as our loader returns them."""
    episodes = list(load_episodes(data, CONFIG, split=split))
    return {
        "observations": np.concatenate([each.observations for each in episodes]),
        "actions": np.concatenate([each.actions for each in episodes]),
        "rewards": np.concatenate([each.rewards for each in episodes]),
        "lengths": [len(each) for each in episodes],
        "terminated": [each.terminated for each in episodes],
    }


def large_pairs(data: Path, split: str) -> dict[str, Any]:
    """Return all actions of a split, and every 30th pair of pictures of 600 x 600 pixels."""
    actions: list[int] = []
    places, states, next_states = [], [], []
    for episode in load_episodes(data, CONFIG, split=split, image_size=600):
        for step, action in enumerate(episode.actions.tolist()):
            if len(actions) % 30 == 0:
                places.append(len(actions))
                states.append(episode.observations[step])
                next_states.append(episode.observations[step + 1])
            actions.append(action)
    return {"actions": actions, "places": places, "states": states, "next_states": next_states}


def check(client: Client, folder: Path, hub: LocalHub) -> dict[str, Any]:
    """Install and run a client; return its versions and what it compared, or why it failed."""
    place = folder / "environments" / (client.environment or client.name)
    python = place / "bin" / "python"
    log = (folder / f"{client.name}.log").open("w+", encoding="utf-8")
    variables = os.environ | hub.env("write") | {"MINARI_DATASETS_PATH": f"{folder}/exports/minari"}
    outside = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    constraints = folder / "constraints.txt"
    constraints.write_text(f"{TORCH}\n", encoding="utf-8")
    install = [str(python), "-m", "pip", "install", "-q"]
    script = [str(SCRIPTS / client.script), str(folder), client.name.lower()]
    if client.stands_in:
        script.insert(0, str(SCRIPTS / "torchvision_stand_in.py"))
    interpreter = shutil.which(client.python)
    if interpreter is None:
        return {"failed": f"{client.python} is not installed"}
    steps = [
        ([interpreter, "-m", "venv", str(place)], outside),
        *[([*install, "--no-deps", client.bare], outside)] * bool(client.bare),
        ([*install, "-c", str(constraints), *client.requirements], outside),
        ([str(python), *script], variables | {"PYTHONPATH": str(ROOT)}),
    ]
    if python.exists():  # Installed by an earlier run.
        steps = steps[-1:]
    with log:
        for command, environment in steps:
            done = subprocess.run(
                command, env=environment, stdout=log, stderr=log, check=False, timeout=SECONDS
            )
            if done.returncode:
                break
        log.seek(0)
        last = (log.read().strip().splitlines() or [""])[-1]
    return {"failed": last} if done.returncode else json.loads(last)


def row(client: Client, found: dict[str, Any]) -> str:
    """Return the row of a client in the table."""
    if "failed" in found:
        return f"| {client.name} | | failed: {found['failed']} | |"
    versions = ", ".join(f"{name} {number}" for name, number in found["versions"].items())
    return f"| {client.name} | {versions} | {found['compared']} | {found['trained'] or 'no'} |"


def main() -> int:
    """Check the clients, print the table, and return 1 if one of them failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [client.name for client in CLIENTS]
    parser.add_argument("--folder", type=Path, required=True, help="for all that the check makes")
    parser.add_argument("--only", nargs="+", choices=names, default=names, help="clients to check")
    parser.add_argument("--again", action="store_true", help="also those that passed before")
    arguments = parser.parse_args()
    folder = arguments.folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    with LocalHub(folder / "hub") as hub:
        make(folder, hub)
        for client in CLIENTS:
            if client.name not in arguments.only:
                continue
            kept = folder / f"{client.name}.json"
            if kept.exists() and not arguments.again:
                found = json.loads(kept.read_bytes())
            else:
                found = check(client, folder, hub)
            if "failed" not in found:
                kept.write_text(json.dumps(found), encoding="utf-8")
            rows.append(row(client, found))
            print(rows[-1], flush=True)
    python = ".".join(map(str, sys.version_info[:3]))
    print(f"\n{date.today()}, Python {python}:\n")
    print("| client | versions | equal to what our loader gives | learns |")
    print("\n".join(["|---|---|---|---|", *rows]))
    return int(any("failed:" in each for each in rows))


if __name__ == "__main__":
    sys.exit(main())
