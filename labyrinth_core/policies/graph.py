"""Run an ONNX graph as a policy, in a process with limits on memory, time and files.

A graph has one input and one output. The input is observations: pictures of shape (batch, pixels,
pixels, 3), uint8 or float32 from 0 to 255; or vectors of shape (batch, length), int32, int64 or
float32. The output is the scores of the four actions, float32 of shape (batch, 4).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from contextlib import suppress
from importlib.util import find_spec
from threading import Event, Timer
from typing import Any, NoReturn
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.evaluation import PolicyError
from labyrinth_core.pictures import PICTURE_SIZE
from labyrinth_core.policies import graph_process
from labyrinth_core.policies.graph_process import ANSWERED, ASKED, TYPES
from labyrinth_core.world import Action

SECONDS = float(graph_process.SECONDS)
"""The maximum seconds for loading a graph, and for answering a batch of observations."""

_ELSEWHERE = b"\n\x08location\x12"
"""In a graph whose weights lie in another file: the key of its name (`TensorProto.external_data` in
onnx.proto)."""

_LONGEST = 1 << 20
"""The maximum bytes of a description or an error."""


class GraphPolicy:
    """An ONNX graph as a policy: a function from observations to scores, computed elsewhere.

    The process that computes it ends with `close`, with a `with` block, or with the object.
    """

    run = None
    """No record says how it was trained."""

    def __init__(self, content: bytes, named: str) -> None:
        """Start a process and load a graph into it.

        Args:
            content: The graph.
            named: The name of the policy in messages.

        Raises:
            DatasetError: Onnxruntime is not installed, or the system is not Linux.
            PolicyError: The graph cannot be loaded, or has other inputs or outputs than a policy.
        """
        if sys.platform != "linux":
            raise DatasetError(f"{named}: ONNX graphs need Linux, where memory can be limited")
        if find_spec("onnxruntime") is None:
            needed = "pip install 'labyrinth-datasets[onnx]'"
            raise DatasetError(f"{named}: an ONNX graph needs onnxruntime: {needed}")
        # As a file, so that the process imports no package of ours.
        command = [sys.executable, "-P", graph_process.__file__, str(os.getpid())]
        self._named = named
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd="/",
            env={
                "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))
            },  # No token, no key.
        )
        self.close = finalize(self, _end, self._process)
        """Ends the process."""
        try:
            self._load(content)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> GraphPolicy:
        """Return the policy itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the process."""
        self.close()

    def _load(self, content: bytes) -> None:
        try:
            inputs, outputs = json.loads(self._ask(content, 0, None))
        except PolicyError:
            if _ELSEWHERE in content:
                self._refuse(
                    "its weights are in another file, but one file is needed: export it with "
                    "torch.onnx.export(..., external_data=False)"
                )
            raise
        if len(inputs) != 1 or len(outputs) != 1:
            self._refuse(f"it has {len(inputs)} inputs and {len(outputs)} outputs, not one of each")
        (_, seen, shape), (_, answered, scores) = inputs[0], outputs[0]
        pictures = _are_pictures(seen, shape)
        vectors = seen in TYPES and seen != "tensor(uint8)" and len(shape) == 2
        if not (pictures or vectors) or type(shape[0]) is int:
            self._refuse(
                f"its input is {seen} of shape {shape}: give uint8 or float of shape [batch, "
                "pixels, pixels, 3], or vectors of shape [batch, length]"
            )
        other = len(scores) != 2 or (type(scores[1]) is int and scores[1] != len(Action))
        if answered != "tensor(float)" or other:
            self._refuse(f"its output is {answered} of shape {scores}: give float of [batch, 4]")
        self.observation = "image" if pictures else "vector"
        self.image_size: int | None = shape[1] if pictures else None
        self._length = shape[1] if vectors and type(shape[1]) is int else None
        self._dtype = np.dtype(TYPES[seen])

    def __call__(self, observations: NDArray[Any]) -> NDArray[np.float32]:
        """Return the scores of the four actions, shape (B, 4).

        Raises:
            PolicyError: The graph returns anything else, or takes too much time or memory.
        """
        count = len(observations)
        if self._length not in (None, observations.shape[1]):
            length = observations.shape[1]
            self._refuse(
                f"its vectors have {self._length} numbers, those of these labyrinths {length}"
            )
        content = np.ascontiguousarray(observations, self._dtype).tobytes()
        answer = self._ask(content, count, 4 * len(Action) * count)
        return np.frombuffer(answer, np.float32).reshape(count, len(Action))

    def _ask(self, content: bytes, count: int, size: int | None) -> bytes:
        """Send the graph or observations to the process, and return its answer.

        Args:
            content: The bytes to send.
            count: The number of observations; 0 for a graph.
            size: The length of the answer in bytes; None for any length up to `_LONGEST`.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        late = Event()

        def end() -> None:
            late.set()
            self._process.kill()

        timer = Timer(SECONDS, end)
        timer.start()
        try:
            with suppress(BrokenPipeError):
                self._process.stdin.write(ASKED.pack(len(content), count) + content)
                self._process.stdin.flush()
            header = self._process.stdout.read(ANSWERED.size)
            if len(header) < ANSWERED.size:
                self._refuse_ended(late)
            is_error, length = ANSWERED.unpack(header)
            fits = length <= _LONGEST if size is None or is_error else length == size
            if not fits:
                self._refuse(f"its answer has {length} bytes")
            answer = self._process.stdout.read(length)
            if len(answer) < length:
                self._refuse_ended(late)
        finally:
            timer.cancel()
        if is_error:
            self._refuse(one_line(ValueError(answer.decode(errors="replace"))))
        return answer

    def _refuse_ended(self, late: Event) -> NoReturn:
        if late.is_set():
            self._refuse(f"it takes more than {SECONDS:g} seconds")
        self._refuse("its process ended, perhaps because memory ran out")

    def _refuse(self, reason: str) -> NoReturn:
        raise PolicyError(f"{self._named} is refused: {reason:.300}")


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    with suppress(BrokenPipeError):  # Bytes that it has not read are lost.
        process.communicate()


def _are_pictures(kind: str, shape: list[int | str | None]) -> bool:
    """Return whether an input takes square pictures, of a size that we can draw."""
    if kind not in ("tensor(uint8)", "tensor(float)") or len(shape) != 4:
        return False
    _, height, width, channels = shape
    return type(height) is int and 1 <= height <= PICTURE_SIZE and (width, channels) == (height, 3)
