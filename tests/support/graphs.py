"""ONNX graphs for tests, written byte by byte: the package `onnx` is not needed to run them.

The numbers of fields and types are those of onnx.proto (github.com/onnx/onnx, version 1.17).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

TYPES = {"float32": 1, "uint8": 2, "int32": 6, "int64": 7, "bool": 9}


def _varint(number: int) -> bytes:
    parts = bytearray()
    while number > 127:
        parts.append(number & 127 | 128)
        number >>= 7
    return bytes([*parts, number])


def _message(fields: Sequence[tuple[int, Any]]) -> bytes:
    """Return a message: whole numbers as varints, texts and messages with their length."""
    parts = []
    for number, value in fields:
        if isinstance(value, int):
            parts.append(_varint(number << 3) + _varint(value))
        else:
            content = value.encode() if isinstance(value, str) else value
            parts.append(_varint(number << 3 | 2) + _varint(len(content)) + content)
    return b"".join(parts)


def tensor(name: str, array: np.ndarray) -> bytes:
    dims = [(1, size) for size in array.shape]
    return _message([*dims, (2, TYPES[str(array.dtype)]), (8, name), (9, array.tobytes())])


def elsewhere(name: str, shape: Sequence[int], location: str) -> bytes:
    """Return a tensor whose data lie in another file."""
    dims = [(1, size) for size in shape]
    place = _message([(1, "location"), (2, location)])
    return _message([*dims, (2, TYPES["float32"]), (8, name), (13, place), (14, 1)])


def node(op: str, inputs: Sequence[str], output: str, domain: str = "", **given: Any) -> bytes:
    """Return a node with one output; attributes are whole numbers or, as bytes, graphs."""
    attributes = [
        (5, _message([(1, name), (3, value), (20, 2)]))
        if isinstance(value, int)
        else (5, _message([(1, name), (6, value), (20, 5)]))
        for name, value in given.items()
    ]
    names = [(1, name) for name in inputs]
    return _message([*names, (2, output), (4, op), *attributes, (7, domain)])


def value(name: str, dtype: str, shape: Sequence[int | str]) -> bytes:
    dims = [(1, _message([(1 if isinstance(size, int) else 2, size)])) for size in shape]
    kind = _message([(1, _message([(1, TYPES[dtype]), (2, _message(dims))]))])
    return _message([(1, name), (2, kind)])


def graph(
    nodes: Sequence[bytes],
    inputs: Sequence[bytes],
    outputs: Sequence[bytes],
    tensors: Sequence[bytes] = (),
) -> bytes:
    parts = [(1, nodes), (5, tensors), (11, inputs), (12, outputs)]
    return _message([(2, "graph"), *((number, each) for number, all_ in parts for each in all_)])


def model(content: bytes) -> bytes:
    return _message([(1, 8), (7, content), (8, _message([(1, ""), (2, 17)]))])


def linear(
    weights: np.ndarray,
    dtype: str = "uint8",
    shape: Sequence[int | str] = ("batch", 64, 64, 3),
    nodes: Sequence[bytes] = (),
    scores: str = "product",
    tensors: Sequence[bytes] = (),
) -> bytes:
    """Return a model that flattens observations and multiplies them with weights.

    Args:
        weights: Shape (pixels, 4), float32.
        dtype: The type of observations.
        shape: Their shape.
        nodes: What is made of `product`, the result.
        scores: The name of the output.
        tensors: Constants of these nodes.
    """
    steps = [
        node("Cast", ["observations"], "numbers", to=1),
        node("Flatten", ["numbers"], "flat", axis=1),
        node("MatMul", ["flat", "weights"], "product"),
        *nodes,
    ]
    seen = value("observations", dtype, shape)
    answers = value(scores, "float32", ["batch", weights.shape[1]])
    return model(graph(steps, [seen], [answers], [tensor("weights", weights), *tensors]))


def endless(dtype: str = "uint8") -> bytes:
    """Return a model with a loop that does not end."""
    body = graph(
        [
            node("Identity", ["go"], "on"),
            node("Identity", ["carried"], "same"),
        ],
        [value("step", "int64", []), value("go", "bool", []), value("carried", "float32", [])],
        [value("on", "bool", []), value("same", "float32", [])],
    )
    loops = [
        node("Loop", ["", "yes", "zero"], "looped", body=body),
        node("Add", ["product", "looped"], "scores"),
    ]
    constants = [tensor("yes", np.array(True)), tensor("zero", np.float32(0))]
    return linear(
        np.zeros((12288, 4), np.float32), dtype, nodes=loops, scores="scores", tensors=constants
    )
