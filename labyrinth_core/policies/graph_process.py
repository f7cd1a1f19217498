"""The process that runs an ONNX graph for `graph.py`; it imports no other module of ours.

Its memory is limited, it cannot open files, and it ends with the process that started it. It reads
the graph, then batches of observations, each as the number of bytes, the number of observations
(`ASKED`), and the bytes. To each it answers with an error flag and the
number of bytes (`ANSWERED`), then the bytes: a description of the graph's inputs and outputs as
JSON, scores as float32, or the text of an error.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import struct
import sys
from typing import BinaryIO

ASKED = struct.Struct("<QQ")
"""The header of a request: its number of bytes, and of observations, 0 for a graph."""
ANSWERED = struct.Struct("<?Q")
"""The header of an answer: whether it is an error, and its number of bytes."""

PR_SET_PDEATHSIG = 1
"""Of Linux's prctl.h."""

MEMORY = 4 << 30
"""The maximum memory of the process in bytes, libraries included."""

SECONDS = 60
"""The maximum seconds, of processor time in the process, for a graph and for each request."""

TYPES = {
    "tensor(uint8)": "uint8",
    "tensor(int32)": "int32",
    "tensor(int64)": "int64",
    "tensor(float)": "float32",
}
"""Type of observations in a graph -> NumPy dtype."""


def end_with(parent: int) -> None:
    """Let the system end this process when its parent ends, whose id is `parent`."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # It ended before.
        os._exit(1)


def serve(incoming: BinaryIO, outgoing: BinaryIO) -> None:
    """Answer requests until the input ends.

    Args:
        incoming: The stream of requests: the graph, then observations.
        outgoing: The stream for the answers.
    """
    import resource  # Not on Windows.

    import numpy as np
    import onnxruntime

    def receive() -> tuple[bytes, int]:
        header = incoming.read(ASKED.size)
        if len(header) < ASKED.size:
            return b"", 0
        size, count = ASKED.unpack(header)
        content = incoming.read(size)
        used = resource.getrusage(resource.RUSAGE_SELF)
        most = int(used.ru_utime + used.ru_stime) + SECONDS + 1
        resource.setrlimit(resource.RLIMIT_CPU, (most, resource.RLIM_INFINITY))
        return content, count

    def send(content: bytes, *, error: bool = False) -> None:
        outgoing.write(ANSWERED.pack(error, len(content)) + content)
        outgoing.flush()

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    # No optimisation: it would run parts of the graph before the graph is checked.
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    for limit, most in (
        (resource.RLIMIT_AS, MEMORY),
        (resource.RLIMIT_NOFILE, 0),  # So that the graph cannot read data from another file.
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(limit, (most, most))
    try:
        session = onnxruntime.InferenceSession(
            receive()[0], options, providers=["CPUExecutionProvider"]
        )
        sides = [session.get_inputs(), session.get_outputs()]
        told = [[[each.name, each.type, each.shape] for each in side] for side in sides]
        send(json.dumps(told).encode())
        (name, kind, shape), *_ = told[0] or [["", "", []]]
        dtype = np.dtype(TYPES.get(kind, "uint8"))
        sides_of_one = [each if isinstance(each, int) else -1 for each in shape[1:]]
        while (request := receive())[0]:
            content, count = request
            observations = np.frombuffer(content, dtype).reshape(count, *sides_of_one)
            scores = session.run(None, {name: observations})[0]
            if scores.shape != (len(observations), 4):
                raise ValueError(f"{len(observations)} observations give an output {scores.shape}")
            send(scores.astype(np.float32).tobytes())
    except Exception as error:  # Any error: the graph is not trusted.
        send(f"{type(error).__name__}: {error}".encode(), error=True)


if __name__ == "__main__":
    end_with(int(sys.argv[1]))
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # Output of libraries must not mix with the answers.
    serve(sys.stdin.buffer, answers)
