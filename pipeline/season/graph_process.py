"""The process that runs an ONNX graph for `graph.py`; it imports no other module of ours.

Its memory is limited, and it cannot open files. It reads the graph, then batches of observations,
each as the number of bytes (`ASKED`) and the bytes. To each it answers with an error flag and the
number of bytes (`ANSWERED`), then the bytes: a description of the graph's inputs and outputs as
JSON, scores as float32, or the text of an error.
"""

from __future__ import annotations

import json
import os
import struct
import sys
from typing import BinaryIO

ASKED = struct.Struct("<Q")
"""The header of a request: its number of bytes."""
ANSWERED = struct.Struct("<?Q")
"""The header of an answer: whether it is an error, and its number of bytes."""

MEMORY = 4 << 30
"""The maximum memory of the process in bytes, libraries included."""

TYPES = {
    "tensor(uint8)": "uint8",
    "tensor(int32)": "int32",
    "tensor(int64)": "int64",
    "tensor(float)": "float32",
}
"""Type of observations in a graph -> NumPy dtype."""


def serve(incoming: BinaryIO, outgoing: BinaryIO) -> None:
    """Answer requests until the input ends.

    Args:
        incoming: The stream of requests: the graph, then observations.
        outgoing: The stream for the answers.
    """
    import resource  # Not on Windows.

    import numpy as np
    import onnxruntime

    def receive() -> bytes:
        header = incoming.read(ASKED.size)
        return incoming.read(*ASKED.unpack(header)) if header else b""

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
            receive(), options, providers=["CPUExecutionProvider"]
        )
        sides = [session.get_inputs(), session.get_outputs()]
        told = [[[each.name, each.type, each.shape] for each in side] for side in sides]
        send(json.dumps(told).encode())
        (name, kind, shape), *_ = told[0] or [["", "", []]]
        dtype = np.dtype(TYPES.get(kind, "uint8"))
        while content := receive():
            observations = np.frombuffer(content, dtype).reshape(-1, *shape[1:])
            scores = session.run(None, {name: observations})[0]
            if scores.shape != (len(observations), 4):
                raise ValueError(f"{len(observations)} observations give an output {scores.shape}")
            send(scores.astype(np.float32).tobytes())
    except Exception as error:  # Any error: the graph is not trusted.
        send(f"{type(error).__name__}: {error}".encode(), error=True)


if __name__ == "__main__":
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # Output of libraries must not mix with the answers.
    serve(sys.stdin.buffer, answers)
