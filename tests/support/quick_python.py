"""A Python that starts at once: forked from a process that has imported the slow libraries.

Most of the time of a short command goes into importing NumPy, pandas, Arrow and Hydra, and the
tests run hundreds. `[python(), "run.py", ...]` is a process like that of `sys.executable`: it has
arguments, environment, folder, files and an exit status of its own, and it can be killed. It
imports itself what reads the environment when it is imported, such as `huggingface_hub`. It is not
for tests of imports, of other signals, of memory or of seeds of hashes.

With `QUICK_PYTHON_SLEEP=0.05` in its environment, it and the processes that it starts sleep a
twentieth of the time: what a client of the Hub waits before it repeats a call.

As a program, this module is the process that is forked.
"""

from __future__ import annotations

import atexit
import builtins
import gc
import json
import os
import re
import runpy
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType

LIBRARIES = (
    *("numpy", "pandas", "pyarrow.dataset", "pyarrow.parquet", "PIL.Image", "PIL.ImageFont"),
    *("hydra", "hydra.core.hydra_config", "omegaconf", "yaml", "rich.console", "rich.progress"),
    *("asyncio", "dill", "fsspec", "httpx2", "multiprocess.pool", "xxhash", "tqdm.auto"),
    *("filelock", "joblib", "unittest.mock", "rich._emoji_codes", "rich.table", "gymnasium"),
    *("torch", "safetensors.torch", "httpcore2", "truststore", "xml.etree.ElementTree"),
    # The first step of an optimizer imports this, and the record of a run is drawn with that.
    *("torch._dynamo", "matplotlib.figure", "matplotlib.backends.backend_agg"),
    *("h5py", "packaging.requirements"),
)
"""What takes long to be imported, and reads nothing then that a test sets in the environment."""

OURS = ("build", "validate", "analyse", "train", "evaluate")
"""The stages whose modules most commands import; none of them may import the Hub's client."""

LAUNCHER = """#!{python} -ISs
import json, os, socket, sys

# The workers of joblib and multiprocessing are given further files, and are ordinary processes.
if len(os.listdir("/proc/self/fd")) > 4:
    os.execv({python!r}, [{python!r}, *sys.argv[1:]])
with socket.socket(socket.AF_UNIX) as server:
    server.connect({address!r})
    socket.send_fds(server, [b"0"], [0, 1, 2])
    asked = json.dumps([sys.argv[1:], dict(os.environ), os.getcwd()]).encode()
    server.sendall(len(asked).to_bytes(8, "little") + asked)
    status = os.waitstatus_to_exitcode(int.from_bytes(server.recv(4), "little"))
if status < 0:
    os.kill(os.getpid(), -status)
sys.exit(status)
"""
"""The program that asks for a process, lends it its three files, and ends as it ends."""


@cache
def python() -> str:
    """Return the program to run in the place of `sys.executable`."""
    if not hasattr(os, "pidfd_open"):  # Not on Linux.
        return sys.executable
    folder = tempfile.mkdtemp(prefix="quick-python-")
    address, launcher = Path(folder, "socket"), Path(folder, "python")
    launcher.write_text(LAUNCHER.format(python=sys.executable, address=str(address)))
    launcher.chmod(0o755)
    command = [sys.executable, "-I", __file__, str(address), str(launcher)]
    server = subprocess.Popen(command, start_new_session=True)  # Out of reach of Ctrl-C.

    def stop() -> None:
        server.terminate()
        server.wait()
        shutil.rmtree(folder)

    atexit.register(stop)
    while not address.exists():
        assert server.poll() is None
        time.sleep(0.01)
    return str(launcher)


def serve(address: str, launcher: str) -> None:
    """Fork a process for each call, and return there, as its caller asks; tell how each ended."""
    parent, root = os.getppid(), str(Path(__file__).parents[2])
    for name in LIBRARIES:
        with suppress(ModuleNotFoundError):  # Earlier versions of the Hub's client have httpx.
            import_module(name)
    sys.path.insert(0, root)
    import_module("pipeline.command.launch")
    stages = import_module("pipeline.command.stages").STAGES
    for name in OURS:
        with suppress(ModuleNotFoundError):  # Without PyTorch.
            import_module(stages[name].module)
    sys.path.remove(root)
    assert "huggingface_hub" not in sys.modules
    sys.executable = launcher
    os.fsync = lambda _: None  # As in `conftest.py`.
    gc.freeze()  # What is there is shared by all, and never looked through.
    running: dict[int, tuple[int, socket.socket]] = {}  # By a file that can be read at the end.
    listening = socket.socket(socket.AF_UNIX)
    listening.bind(f"{address}.new")
    listening.listen(64)
    Path(f"{address}.new").rename(address)
    while os.getppid() == parent:
        callers = {caller: ended for ended, (_, caller) in running.items()}
        ready, _, _ = select.select([listening, *running, *callers], [], [], 1.0)
        for each in ready:
            if each is listening:
                caller, _ = listening.accept()
                try:
                    asked = _asked_by(caller)
                except (OSError, ValueError):  # The caller was killed before it had asked.
                    caller.close()
                    continue
                if (child := _fork()) == 0:
                    for file in (listening, caller, *callers):
                        file.close()
                    for ended in running:
                        os.close(ended)
                    return _become(*asked)
                for file in asked[0]:
                    os.close(file)
                _begin_group(child)
                running[os.pidfd_open(child)] = child, caller
            elif each in callers and callers[each] in running:
                os.killpg(running[callers[each]][0], signal.SIGKILL)  # The caller has gone.
            elif each in running:
                child, caller = running.pop(each)
                _, status = os.waitpid(child, 0)
                os.close(each)
                with caller, suppress(OSError):
                    caller.send(status.to_bytes(4, "little"))
    shutil.rmtree(Path(address).parent)  # For a parent that was killed, as xdist's may be.
    sys.exit()


def _fork() -> int:
    with warnings.catch_warnings():
        # From Python 3.12 on, about threads of numerical libraries, which are idle.
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _asked_by(caller: socket.socket) -> tuple[list[int], list[str], dict[str, str], str]:
    """Return the three files, the arguments, the environment and the folder that a caller sends."""
    _, files, *_ = socket.recv_fds(caller, 1, 3)
    with caller.makefile("rb") as incoming:
        size = int.from_bytes(incoming.read(8), "little")
        return files, *json.loads(incoming.read(size))


def _begin_group(process: int) -> None:
    """Make a process a group of its own; both it and the server call this, whoever is first."""
    with suppress(OSError):
        os.setpgid(process, process)


def _become(
    files: list[int], arguments: list[str], environment: dict[str, str], folder: str
) -> None:
    """Take over what a caller gives to its process."""
    _begin_group(os.getpid())
    for number, file in enumerate(files):
        os.dup2(file, number)
        os.close(file)
    for number, name in ((1, "stdout"), (2, "stderr")):  # The old ones may remember a file.
        stream = os.fdopen(number, "w", encoding="utf-8", closefd=False)
        stream.reconfigure(line_buffering=number == 2 or stream.isatty())
        setattr(sys, name, stream)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    tempfile.tempdir = None
    sys.argv[:] = arguments
    if share := environment.get("QUICK_PYTHON_SLEEP"):
        sleep = time.sleep
        time.sleep = lambda seconds: sleep(seconds * float(share))


def go_on() -> None:
    """Do what the arguments say: `[-W WARNING]... (-m MODULE | -c PROGRAM | FILE) ARGUMENT...`."""
    while sys.argv[0] == "-W":
        action, message, category, *_ = [*sys.argv[1].split(":"), "", ""]
        kind = getattr(builtins, category or "Warning")
        warnings.filterwarnings(action, re.escape(message), kind)
        del sys.argv[:2]
    sys.path[:0] = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
    kind = sys.argv[0]
    if kind in ("-m", "-c"):
        what = sys.argv[1]
        del sys.argv[0 if kind == "-m" else 1]
    if kind == "-m":
        sys.path.insert(0, str(Path.cwd()))
        runpy.run_module(what, run_name="__main__", alter_sys=True)
    elif kind == "-c":
        sys.path.insert(0, "")
        main = sys.modules["__main__"] = ModuleType("__main__")
        exec(compile(what, "<string>", "exec"), main.__dict__)
    else:
        sys.path.insert(0, str(Path(kind).resolve().parent))
        runpy.run_path(kind, run_name="__main__")


def end(status: int) -> None:
    """End as Python does, but without taking its memory apart, which takes longer than most runs.

    Where the output cannot be written, it returns, and Python says so itself.
    """
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    with suppress(OSError):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


if __name__ == "__main__":
    serve(*sys.argv[1:])
    try:
        go_on()
    except SystemExit as ended:
        if isinstance(ended.code, int | None):
            end(ended.code or 0)
        raise
    end(0)
