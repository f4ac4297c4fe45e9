"""Layers of a network from its ONNX file, read as data by the package ``onnx``.

For a chain of operators; what it does not know is not decided.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .parts import Law, Layer
from .structure import contents
from .verdict import Rejected, Undecided

LARGEST = 64 * 2**20  # most bytes of a file

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
    data = contents(path, LARGEST)
    try:
        layers = read_layers(data, len(law.input_scale))
    except ImportError as error:
        rule = f"reading {path.name} needs the package onnx: pip install 'polaris-rta[networks]'"
        raise Undecided("controllers", rule) from error
    except Exception as error:  # the package raises errors of its own where a file is garbled
        raise Undecided("controllers", f"{path.name} is not understood: {error}") from error
    if layers != law.layers:
        raise Rejected("controllers", f"{law.name} has other layers than {path.name}")


def read_layers(data: bytes, width: int) -> list[Layer]:
    """Layers of a model that reads so many values, or an error: a chain of known operators only."""
    import onnx

    # Shapes are inferred by the package: components must stay along the last axis, and nothing be repeated.
    model = onnx.load_model_from_string(data)
    graph = onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True).graph
    known = [*graph.input, *graph.value_info, *graph.output]
    shapes = {item.name: [axis.dim_value for axis in item.type.tensor_type.shape.dim] for item in known}
    if graph.sparse_initializer:
        raise ValueError("sparse weights")
    constants = {tensor.name: _tensor(tensor) for tensor in graph.initializer}
    names = [item.name for item in graph.input if item.name not in constants]
    if len(names) != 1:
        raise ValueError("more than one input")
    at, layers = names[0], list[Layer]()
    for node in graph.node:
        kind, into = node.op_type, list(node.input)
        more = {item.name: onnx.helper.get_attribute_value(item) for item in node.attribute}
        if kind == "Constant":
            constants[node.output[0]] = _tensor(more["value"])
            continue
        if into.count(at) != 1:
            raise ValueError(f"{kind} does not take the output before it once")
        real = onnx.TensorProto.FLOAT, onnx.TensorProto.DOUBLE
        domain, changes = node.domain, kind == "Cast" and more["to"] not in real
        if domain not in ("", "ai.onnx") or changes:
            raise ValueError(f"the operator {domain}.{kind} is not known, or changes values")
        values = [None if name == at or not name else constants[name] for name in into]
        if kind not in SAME:
            layers.append(_layer(kind, values, more, width))
            width = len(layers[-1].b) or width
        at = node.output[0]
        sizes = shapes.get(at) or [0]
        if sizes[-1] != width or any(size > 1 for size in sizes[:-1]):
            raise ValueError(f"after {kind} the components are not {width} along the last axis")
    if not layers or [item.name for item in graph.output] != [at]:
        raise ValueError("the output is not the end of the chain")
    return layers


def _tensor(tensor: Any) -> tuple[list[int], list[float]]:
    """Shape and values; of whole numbers, which only shapes are made of, no values."""
    from onnx import TensorProto, numpy_helper

    if tensor.data_location == TensorProto.EXTERNAL:
        raise ValueError(f"the weights {tensor.name} lie in another file")
    known = tensor.data_type in (TensorProto.FLOAT, TensorProto.DOUBLE)
    values = [float(value) for value in numpy_helper.to_array(tensor).ravel()] if known else []
    if not all(map(math.isfinite, values)):
        raise ValueError(f"the weights {tensor.name} are not finite")
    return list(tensor.dims), values


def _layer(kind: str, values: list[Any], more: dict[str, Any], width: int) -> Layer:
    """What one operator does to a vector."""
    if kind in ACTIVATIONS:
        name, low = ACTIVATIONS[kind]
        slope = more.get("alpha", low)
        if not 0 <= slope <= 1:
            raise ValueError(f"{kind} with a slope of {slope}")
        return Layer(name, low=slope)
    if kind == "Clip":
        ends = [more.get("min", math.nan), more.get("max", math.nan)]
        for i, value in enumerate(values[1:3]):
            (ends[i],) = [ends[i]] if value is None else value[1]
        if not ends[0] <= ends[1]:
            raise ValueError("Clip without limits, or with limits upside down")
        return Layer("clip", low=ends[0], high=ends[1])
    if kind in ("Gemm", "MatMul"):
        (rows, columns), flat = values[1]
        alpha, beta = more.get("alpha", 1.0), more.get("beta", 1.0)
        if values[0] is not None or more.get("transA"):
            raise ValueError(f"{kind} with the input on the other side")
        if len(flat) != rows * columns:
            raise ValueError("weights of another number than their shape says")
        W = [[alpha * x for x in flat[i * columns : (i + 1) * columns]] for i in range(rows)]
        W = W if more.get("transB") else [list(column) for column in zip(*W, strict=True)]
        if any(len(row) != width for row in W):
            raise ValueError(f"weights of another shape follow {width} values")
        b = values[2][1] if len(values) > 2 and values[2] is not None else [0.0]
        return Layer("affine", W, _spread([beta * x for x in b], len(W)))
    scale, shift = _scaling(kind, values, more)
    scales = _spread(scale, width)
    diagonal = [[x if i == j else 0.0 for j in range(width)] for i, x in enumerate(scales)]
    return Layer("affine", diagonal, _spread(shift, width))


def _scaling(kind: str, values: list[Any], more: dict[str, Any]) -> tuple[list[float], list[float]]:
    """``scale y + shift`` of an operator that takes every component for itself."""
    if kind == "BatchNormalization":
        gain, shift, mean, variance = (value[1] for value in values[1:5])
        eps = more.get("epsilon", 1e-5)
        if values[0] is not None or more.get("training_mode"):
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
