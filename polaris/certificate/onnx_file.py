"""Layers of a network from its ONNX file: the protocol buffer read byte by byte, as data.

Written from the formats' descriptions, for a chain of operators; what it does not know is not decided.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .document import Law
from .files import contents
from .layers import Layer
from .verdict import Rejected, Undecided

LARGEST = 64 * 2**20
"""Most bytes of a file."""

Fields = dict[int, list[Any]]
Constants = dict[str, tuple[list[int], list[float]]]
"""Shape and values by name."""

SAME = ("Identity", "Flatten", "Reshape", "Squeeze", "Unsqueeze", "Cast", "Dropout")
"""Operators that change no value of a vector."""
ACTIVATIONS = {
    "Relu": ("relu", 0.0),
    "LeakyRelu": ("relu", 0.01),
    "Tanh": ("tanh", 0.0),
    "Sigmoid": ("sigmoid", 0.0),
}
"""Kind and default of ``alpha`` by operator."""


def check_file(law: Law, path: Path) -> None:
    """The layers of a law are those of a file: `Rejected` if not, `Undecided` if it is not understood."""
    try:
        layers = read_layers(contents(path, LARGEST), len(law.input_scale))
    except (ValueError, IndexError, KeyError, UnicodeDecodeError, struct.error, ZeroDivisionError) as error:
        raise Undecided("controllers", f"{path.name} is not understood: {error}") from error
    if layers != law.layers:
        raise Rejected("controllers", f"{law.name} has other layers than {path.name}")


def read_layers(data: bytes, width: int) -> list[Layer]:
    """Layers of a model that reads so many values; `ValueError` if it is no chain of known operators."""
    graph = _fields(_one(_fields(data), 7))
    if graph.get(15):
        raise ValueError("sparse weights")
    constants: Constants = dict(_tensor(item) for item in graph.get(5, ()))
    given = [_text(_fields(item), 1) for item in graph.get(11, ())]
    names = [name for name in given if name not in constants]
    if len(names) != 1:
        raise ValueError("more than one input")
    at, layers = names[0], list[Layer]()
    for node in map(_fields, graph.get(1, ())):
        kind, into = _text(node, 4), [item.decode() for item in node.get(1, ())]
        more = {_text(item, 1): item for item in map(_fields, node.get(5, ()))}
        if kind == "Constant":
            constants[_text(node, 2)] = _tensor(_one(more["value"], 5))[1]
            continue
        if into.count(at) != 1:
            raise ValueError(f"{kind} does not take the output before it once")
        domain = node.get(7, [b""])[-1].decode()
        if domain not in ("", "ai.onnx") or (kind == "Cast" and more["to"].get(3) not in ([1], [11])):
            raise ValueError(f"the operator {domain}.{kind} is not known, or changes values")
        values = [None if name == at or not name else constants[name] for name in into]
        if kind not in SAME:
            layers.append(_layer(kind, values, more, width))
            width = len(layers[-1].b) or width
        at = _text(node, 2)
    if [_text(_fields(item), 1) for item in graph.get(12, ())] != [at]:
        raise ValueError("the output is not the end of the chain")
    return layers


def _layer(kind: str, values: list[Any], more: dict[str, Fields], width: int) -> Layer:
    """What one operator does to a vector."""
    if kind in ACTIVATIONS:
        name, low = ACTIVATIONS[kind]
        return Layer(name, low=_float(more, "alpha", low))
    if kind == "Clip":
        ends = [_float(more, "min", math.nan), _float(more, "max", math.nan)]
        for i, value in enumerate(values[1:3]):
            ends[i] = ends[i] if value is None else value[1][0]
        if any(map(math.isnan, ends)):
            raise ValueError("Clip without limits")
        return Layer("clip", low=ends[0], high=ends[1])
    if kind in ("Gemm", "MatMul"):
        (rows, columns), flat = values[1]
        alpha, beta = _float(more, "alpha", 1.0), _float(more, "beta", 1.0)
        if values[0] is not None or _whole(more, "transA"):
            raise ValueError(f"{kind} with the input on the other side")
        if len(flat) != rows * columns:
            raise ValueError("weights of another number than their shape says")
        W = [[alpha * x for x in flat[i * columns : (i + 1) * columns]] for i in range(rows)]
        W = W if _whole(more, "transB") else [list(column) for column in zip(*W, strict=True)]
        if any(len(row) != width for row in W):
            raise ValueError(f"weights of another shape follow {width} values")
        b = values[2][1] if len(values) > 2 and values[2] is not None else [0.0]
        return Layer("affine", W, _spread([beta * x for x in b], len(W)))
    scale, shift = _scaling(kind, values, more)
    scales = _spread(scale, width)
    diagonal = [[x if i == j else 0.0 for j in range(width)] for i, x in enumerate(scales)]
    return Layer("affine", diagonal, _spread(shift, width))


def _scaling(kind: str, values: list[Any], more: dict[str, Fields]) -> tuple[list[float], list[float]]:
    """``scale y + shift`` of an operator that takes every component for itself."""
    if kind == "BatchNormalization":
        gain, shift, mean, variance = (value[1] for value in values[1:5])
        eps = _float(more, "epsilon", 1e-5)
        if values[0] is not None or _whole(more, "training_mode"):
            raise ValueError("BatchNormalization of training")
        scale = [g / math.sqrt(v + eps) for g, v in zip(gain, variance, strict=True)]
        return scale, [b - a * s for b, a, s in zip(shift, mean, scale, strict=True)]
    first = values[0] is None
    value: list[float] = values[1 if first else 0][1]
    if kind == "Add":
        return [1.0], value
    if kind == "Sub":
        return ([1.0], [-x for x in value]) if first else ([-1.0], value)
    if kind == "Mul" or (kind == "Div" and first):
        return (value if kind == "Mul" else [1 / x for x in value]), [0.0]
    raise ValueError(f"the operator {kind} is not known")


def _spread(values: Sequence[float], width: int) -> list[float]:
    """One value for all components, or one each."""
    found = list(values) * width if len(values) == 1 else list(values)
    if len(found) != width:
        raise ValueError(f"{len(found)} constants for {width} values")
    return found


# -- the protocol buffer ------------------------------------------------------------------------------


def _fields(data: bytes) -> Fields:
    """Values by field number: whole numbers, or bytes."""
    found: Fields = {}
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        wire, size = key & 7, {1: 8, 5: 4}.get(key & 7, 0)
        if wire == 0:
            value, at = _varint(data, at)
            found.setdefault(key >> 3, []).append(value)
            continue
        if wire == 2:
            size, at = _varint(data, at)
        elif not size:
            raise ValueError("no protocol buffer")
        if at + size > len(data):
            raise ValueError("cut off")
        found.setdefault(key >> 3, []).append(data[at : at + size])
        at += size
    return found


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A whole number of seven bits a byte, and where it ends."""
    value = 0
    for shift in range(0, 70, 7):
        byte = data[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
    raise ValueError("a number without end")


def _one(fields: Fields, number: int) -> Any:
    found = fields.get(number, [])
    if len(found) != 1:
        raise ValueError(f"field {number} stands {len(found)} times")
    return found[0]


def _text(fields: Fields, number: int) -> str:
    return str(fields[number][0].decode())


def _float(more: dict[str, Fields], name: str, default: float) -> float:
    """An attribute in single precision."""
    return float(struct.unpack("<f", _one(more[name], 2))[0]) if name in more else default


def _whole(more: dict[str, Fields], name: str) -> int:
    return int(more[name].get(3, [0])[-1]) if name in more else 0


def _tensor(data: bytes) -> tuple[str, tuple[list[int], list[float]]]:
    """Name, shape and values of a tensor; of whole numbers, which only shapes are made of, no values."""
    read = _fields(data)
    name, kind = (_text(read, 8) if 8 in read else ""), _one(read, 2)
    if read.get(14, [0])[-1] or read.get(3):
        raise ValueError(f"the weights {name} lie in another file, or in parts")
    dims: list[int] = []
    for item in read.get(1, ()):
        at = 0
        dims += [item] if isinstance(item, int) else []
        while not isinstance(item, int) and at < len(item):
            size, at = _varint(item, at)
            dims.append(size)
    letter, own = {1: ("f", 4), 11: ("d", 10)}.get(kind, ("", 0))
    raw = b"".join(read.get(9, read.get(own, ()))) if letter else b""
    width = struct.calcsize(letter) if letter else 1
    values = list(struct.unpack(f"<{len(raw) // width}{letter}", raw)) if letter else []
    if not all(map(math.isfinite, values)):
        raise ValueError(f"the weights {name} are not finite")
    return name, (dims, values)
