"""The process that computes an ONNX graph, for `graph.py` alone; nothing else of ours is in it.

Its memory is limited, and it may open no file. It reads the graph, then batches of observations:
the number of bytes (`ASKED`), then the bytes. It answers each with a flag for an error and the
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
"""The number of bytes that come in."""
ANSWERED = struct.Struct("<?Q")
"""Whether an error goes out, and its number of bytes, or those of an answer."""


def serve(incoming: BinaryIO, outgoing: BinaryIO, memory: int) -> None:
    """Answer until nothing comes in any more.

    Args:
        incoming: Where the graph and observations come from.
        outgoing: Where the answers go.
        memory: The most bytes of memory.
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
    # What is written is computed: optimised, a graph would be run in parts before it is checked.
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    for limit, most in (
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_NOFILE, 0),  # So that no data lie in another file.
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
                raise ValueError(f"it answers {scores.shape} to {len(observations)} observations")
            send(scores.astype(np.float32).tobytes())
    except Exception as error:  # Of any kind: the graph is a stranger's.
        send(f"{type(error).__name__}: {error}".encode(), error=True)


TYPES = {
    "tensor(uint8)": "uint8",
    "tensor(int32)": "int32",
    "tensor(int64)": "int64",
    "tensor(float)": "float32",
}
"""Type of observations in a graph -> the same for numpy."""

if __name__ == "__main__":
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # What libraries print is no answer.
    serve(sys.stdin.buffer, answers, int(sys.argv[1]))
