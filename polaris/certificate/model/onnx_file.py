"""Layers of a network from its ONNX file, read as data by the package ``onnx``.

For a chain of operators; what it does not know is not decided.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..files.entries import Law, Layer
from ..files.structure import contents
from ..kernel.verdict import Rejected, Undecided

LARGEST = 64 * 2**20  # most bytes of a file
DEEPEST = 1000  # most layers
LEAST = 2.0**-126  # below it single precision may take a number for 0
UNLIMITED = 1.7976931348623157e308  # limit of a Clip that gives none: the largest double

SAME = ("Identity", "Flatten", "Reshape", "Squeeze", "Unsqueeze", "Cast", "Dropout")
"""Operators that change no value of a vector."""
ACTIVATIONS = {
    "Relu": ("relu", 0.0),
    "LeakyRelu": ("relu", 0.01),
    "Tanh": ("tanh", 0.0),
    "Sigmoid": ("sigmoid", 0.0),
}
"""Kind and default of ``alpha`` by operator."""
MADE = "Gemm", "MatMul", "Clip", "BatchNormalization", "Add", "Sub", "Mul", "Div"  # into layers
KNOWN = {"Constant", *SAME, *ACTIVATIONS, *MADE}


def check_file(law: Law, path: Path) -> None:
    """Check that a law's layers are those of a file: `Rejected` if not, `Undecided` if not understood."""
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

    # The package infers shapes: components must stay along the last axis, and nothing be repeated.
    model = onnx.load_model_from_string(data)
    kinds = {(node.domain.removeprefix("ai.onnx"), node.op_type) for node in model.graph.node}
    if model.functions or not kinds <= {("", kind) for kind in KNOWN}:
        raise ValueError("an operator is not known")
    graph = onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True).graph
    if graph.sparse_initializer:
        raise ValueError("sparse weights")
    tensors = {tensor.name: tensor for tensor in graph.initializer}
    typed = [item for item in (*graph.input, *graph.value_info, *graph.output) if item.name not in tensors]
    real = onnx.TensorProto.FLOAT, onnx.TensorProto.DOUBLE
    if any(item.type.tensor_type.elem_type not in real for item in typed):
        raise ValueError("a value is neither float nor double")
    shapes = {item.name: [axis.dim_value for axis in item.type.tensor_type.shape.dim] for item in typed}
    names = [item.name for item in graph.input if item.name not in tensors]
    if len(names) != 1:
        raise ValueError("more than one input")
    current, layers, budget = names[0], list[Layer](), len(data)
    for node in graph.node:
        kind, into = node.op_type, list(node.input)
        fields = {item.name: onnx.helper.get_attribute_value(item) for item in node.attribute}
        if kind == "Constant":
            tensors[node.output[0]] = fields["value"]
            continue
        if into.count(current) != 1:
            raise ValueError(f"{kind} does not take the output before it once")
        inputs = [None if name == current or not name else tensors[name] for name in into]
        if kind not in SAME:
            values = [None if tensor is None else _numbers(tensor) for tensor in inputs]
            new_layers = _layers(kind, values, fields, width)
            layers += new_layers
            width = len(new_layers[0].W) or width
            budget -= sum(len(value[1]) for value in values if value is not None)
        elif (kind == "Cast" and fields["to"] not in real) or (kind == "Dropout" and _trains(inputs, fields)):
            raise ValueError(f"{kind} changes values")
        if len(layers) > DEEPEST or budget < 0:
            raise ValueError(
                f"the network has more than {DEEPEST} layers, or more numbers than the file bytes"
            )
        current = node.output[0]
        sizes = shapes.get(current) or [0]
        if sizes[-1] != width or any(size > 1 for size in sizes[:-1]):
            raise ValueError(f"after {kind} the components are not {width} along the last axis")
    if not layers or [item.name for item in graph.output] != [current]:
        raise ValueError("the output is not the end of the chain")
    return layers


def _trains(inputs: Sequence[Any], fields: dict[str, Any]) -> bool:
    """Return True if a Dropout drops anything: that of training does."""
    from onnx import numpy_helper

    training = len(inputs) > 2 and inputs[2] is not None and bool(numpy_helper.to_array(inputs[2]).any())
    return training or not fields.get("is_test", 1)


def _numbers(tensor: Any) -> tuple[list[int], list[float]]:
    """Shape and stored values of a tensor of float or double."""
    from onnx import TensorProto, numpy_helper

    if tensor.data_location == TensorProto.EXTERNAL:
        raise ValueError(f"the weights {tensor.name} lie in another file")
    typed = {TensorProto.FLOAT: (4, tensor.float_data), TensorProto.DOUBLE: (8, tensor.double_data)}
    if tensor.data_type not in typed:
        raise ValueError(f"the weights {tensor.name} are neither float nor double")
    size, listed = typed[tensor.data_type]
    stored = len(tensor.raw_data) / size if tensor.raw_data else len(listed)
    if any(length < 1 for length in tensor.dims) or math.prod(tensor.dims) != stored:
        raise ValueError(f"the weights {tensor.name} are of another number than their shape says")
    values = [float(value) for value in numpy_helper.to_array(tensor).ravel()]
    if not all(map(math.isfinite, values)):
        raise ValueError(f"the weights {tensor.name} are not finite")
    return list(tensor.dims), values


def _layers(kind: str, values: list[Any], fields: dict[str, Any], width: int) -> list[Layer]:
    """Layers that one operator makes of so many components."""
    if kind in ACTIVATIONS:
        name, low = ACTIVATIONS[kind]
        slope = fields.get("alpha", low)
        if not slope >= 0:
            raise ValueError(f"{kind} with a slope of {slope}")
        return [Layer(name, low=slope)]
    if kind == "Clip":
        ends = [fields.get("min", -UNLIMITED), fields.get("max", UNLIMITED)]
        for i, value in enumerate(values[1:3]):
            (ends[i],) = [ends[i]] if value is None else value[1]
        if not ends[0] <= ends[1]:
            raise ValueError("Clip with its least limit above its largest")
        return [Layer("clip", low=ends[0], high=ends[1])]
    if kind in ("Gemm", "MatMul"):
        return _product(kind, values, fields, width)
    if kind == "BatchNormalization":
        gain, shift, mean, variance = (_spread(value[1], width) for value in values[1:5])
        eps = fields.get("epsilon", 1e-5)
        if values[0] is not None or fields.get("training_mode"):
            raise ValueError("BatchNormalization of training")
        sizes = [*(abs(g) for g in gain if g), *(v + eps for v in variance)]
        if min(*variance, eps) < 0 or not all(LEAST <= size <= 1 / LEAST for size in sizes):
            raise ValueError("BatchNormalization with a variance below 0, or with numbers out of range")
        scale = [g / math.sqrt(v + eps) for g, v in zip(gain, variance, strict=True)]
        return [_diagonal([1.0], [-x for x in mean], width), _diagonal(scale, shift, width)]
    first = values[0] is None
    value = values[1 if first else 0][1]
    if kind == "Add":
        return [_diagonal([1.0], value, width)]
    if kind == "Sub":
        scale, value = ([1.0], [-x for x in value]) if first else ([-1.0], value)
        return [_diagonal(scale, value, width)]
    if kind == "Mul" or first:
        return [_diagonal(value if kind == "Mul" else [1 / x for x in value], [0.0], width)]
    raise ValueError("Div by a computed value")


def _product(kind: str, values: list[Any], fields: dict[str, Any], width: int) -> list[Layer]:
    """Weights and biases; a factor of the product is a layer of its own."""
    (rows, columns), flat = values[1]
    alpha, beta = fields.get("alpha", 1.0), fields.get("beta", 1.0)
    if values[0] is not None or fields.get("transA"):
        raise ValueError(f"{kind} with the input on the other side")
    W = [flat[i * columns : (i + 1) * columns] for i in range(rows)]
    W = W if fields.get("transB") else [list(column) for column in zip(*W, strict=True)]
    if any(len(row) != width for row in W):
        raise ValueError(f"weights of another shape follow {width} values")
    b = values[2][1] if len(values) > 2 and values[2] is not None else [0.0]
    b = [beta * x for x in b]
    if alpha == 1:
        return [Layer("affine", W, _spread(b, len(W)))]
    return [Layer("affine", W, [0.0] * len(W)), _diagonal([alpha], b, len(W))]


def _diagonal(scale: Sequence[float], shift: Sequence[float], width: int) -> Layer:
    """``scale y + shift``, elementwise; numbers that are all equal are kept once."""
    parts = [list(values[:1] if len(set(values)) == 1 else values) for values in (scale, shift)]
    if any(len(values) not in (1, width) for values in (scale, shift)):
        raise ValueError(f"{len(scale)} and {len(shift)} constants for {width} values")
    return Layer("diagonal", scale=parts[0], b=parts[1])


def _spread(values: Sequence[float], width: int) -> list[float]:
    """Return one value for all components, or one each."""
    spread = list(values) * width if len(values) == 1 else list(values)
    if len(spread) != width:
        raise ValueError(f"{len(spread)} constants for {width} values")
    return spread
