"""Networks from ONNX files: read as data, never executed (optional package ``onnx``)."""

from pathlib import Path
from typing import Any

import numpy as np

from ..numerics.checks import Array
from ..numerics.errors import ReachError
from ..numerics.files import read_regular
from .network import Activation, Affine, Network

LARGEST = 64 * 2**20  # bytes of a file beyond which it is refused: a controller is small
WIDEST = 4096  # most components of an input or a layer

SAME = ("Identity", "Flatten", "Reshape", "Squeeze", "Unsqueeze", "Dropout")  # they change no value
ACTIVATIONS = {"Relu": 0.0, "LeakyRelu": 0.01, "Tanh": 0.0, "Sigmoid": 0.0}  # ``alpha`` where it is left out
OPERATORS = {*SAME, *ACTIVATIONS, "Gemm", "MatMul", "BatchNormalization", "Clip", "Cast"}
OPERATORS |= {"Add", "Sub", "Mul", "Div"}


def read_onnx(path: str | Path) -> Network:
    """Read a feed-forward network.

    Understood are Gemm, MatMul, Add, Sub, Mul, Div (with constants), BatchNormalization, Relu, LeakyRelu,
    Tanh, Sigmoid, Clip, and what changes no value (Identity, Flatten, Reshape, Squeeze, Unsqueeze, Cast,
    Dropout). The batch axis counts for nothing. Weights are as stored, arithmetic is in double precision.

    Raises
    ------
    ReachError
        If the package is missing, the file is none, too large, keeps weights elsewhere, branches, has an
        operator that is not understood, or a weight that is not finite.
    """
    try:
        import onnx
    except ImportError as error:
        rule = "reading ONNX files needs the package onnx (pip install 'polaris[networks]')"
        raise ReachError(rule) from error
    if not isinstance(path, str | Path):
        raise ReachError(f"the path of a file is needed, got {type(path).__name__}")
    path = Path(path)
    try:
        model = onnx.load_model_from_string(read_regular(path, LARGEST))
        found = Network(tuple(_layers(onnx.shape_inference.infer_shapes(model).graph)))
        onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True)
        return found
    except OSError as error:
        raise ReachError(f"{path} cannot be read: {error.strerror}") from error
    except ReachError as error:
        raise ReachError(f"{path}: {error}") from error
    except Exception as error:  # the package raises errors of its own where a file or a tensor is garbled
        raise ReachError(f"{path} is not an ONNX file: {str(error).splitlines()[0]}") from error


def _layers(graph: Any) -> list[Affine | Activation]:
    """One walk along the chain of operators, from the input to the output."""
    from onnx import helper

    constants = {tensor.name: _constant(tensor, tensor.name) for tensor in graph.initializer}
    given = [value for value in graph.input if value.name not in constants]
    if len(given) != 1 or len(graph.output) != 1:
        raise ReachError(f"needs one input and one output, has {len(given)} and {len(graph.output)}")
    known = [*graph.input, *graph.value_info, *graph.output]
    dims = {value.name: [axis.dim_value for axis in value.type.tensor_type.shape.dim] for value in known}
    at, shape, layers = given[0].name, dims[given[0].name], list[Affine | Activation]()
    width = shape[-1] if shape else 0
    if not 1 <= width <= WIDEST or any(size > 1 for size in shape[:-1]):
        raise ReachError(f"the input must be a vector of known size, has shape {shape}")
    for node in graph.node:
        kind = node.op_type
        more = {item.name: helper.get_attribute_value(item) for item in node.attribute}
        if kind == "Constant":
            if "value" not in more:
                raise ReachError("a constant that is not a tensor is not understood")
            constants[node.output[0]] = _constant(more["value"], node.output[0])
        else:
            if kind not in OPERATORS or node.domain not in ("", "ai.onnx"):
                raise ReachError(f"the operator {kind} is not understood")
            inputs = [None if name == at or not name else constants.get(name, name) for name in node.input]
            if list(node.input).count(at) != 1 or any(isinstance(value, str) for value in inputs):
                raise ReachError(f"{kind} takes more than constants and the output before it: no chain")
            layer = _layer(kind, inputs, more, width)
            layers += [layer] if layer else []
            width, at = len(layer.W) if isinstance(layer, Affine) else width, node.output[0]
        sizes = dims.get(at) or [0]  # as the package infers them
        if sizes[-1] != width or any(size > 1 for size in sizes[:-1]):
            raise ReachError(f"{kind} must leave {width} components along the last axis")
    if at != graph.output[0].name:
        raise ReachError("the output is not the end of the chain of operators")
    return layers


def _constant(tensor: Any, name: str) -> Array:
    from onnx import TensorProto, numpy_helper

    if tensor.data_location == TensorProto.EXTERNAL:
        raise ReachError(f"the weights {name} lie in another file")
    value = numpy_helper.to_array(tensor)
    if value.dtype.kind not in "fiu" or not np.all(np.isfinite(value)):
        raise ReachError(f"the weights {name} are not finite numbers")
    return np.asarray(value, dtype=float)


def _layer(kind: str, inputs: list[Any], more: dict[str, Any], width: int) -> Affine | Activation | None:
    """What one operator does to so many values; None if nothing."""
    if kind == "Cast" and more.get("to") not in (1, 11):
        raise ReachError("a Cast must be to float or double: others change values")
    if kind in (*SAME, "Cast"):
        return None
    if kind in ACTIVATIONS:
        return Activation(kind.lower().removeprefix("leaky"), more.get("alpha", ACTIVATIONS[kind]))
    if kind == "Clip":
        return _clip(inputs, more)
    if kind in ("Gemm", "MatMul"):
        W, b = _weights(kind, inputs, more)
    else:
        scale, b = _scaling(kind, inputs, more)
        W = np.diag(_spread(scale, width))
    if W.ndim != 2 or W.shape[1] != width or len(W) > WIDEST:
        raise ReachError(f"weights of shape {W.shape} follow {width} values, at most {WIDEST}")
    return Affine(W, _spread(b, len(W)))


def _weights(kind: str, inputs: list[Any], more: dict[str, Any]) -> tuple[Array, Array]:
    if len(inputs) < 2 or inputs[0] is not None or inputs[1] is None or inputs[1].ndim != 2:
        raise ReachError(f"{kind} must multiply by weights from the right")
    if more.get("transA", 0):
        raise ReachError("Gemm with a transposed input is not understood")
    W = inputs[1] if more.get("transB", 0) else inputs[1].T
    b = inputs[2] if len(inputs) > 2 and inputs[2] is not None else np.zeros(1)
    return more.get("alpha", 1.0) * W, more.get("beta", 1.0) * b


def _scaling(kind: str, inputs: list[Any], more: dict[str, Any]) -> tuple[Any, Any]:
    """``scale y + shift`` of an operator that takes every component for itself."""
    if kind == "BatchNormalization":
        if len(inputs) < 5 or more.get("training_mode", 0):
            raise ReachError("BatchNormalization must be that of inference")
        gain, shift, mean, variance = inputs[1:5]
        if np.any(variance + more.get("epsilon", 1e-5) <= 0):
            raise ReachError("BatchNormalization has a variance that is not positive")
        scale = gain / np.sqrt(variance + more.get("epsilon", 1e-5))
        return scale, shift - mean * scale
    first = inputs[0] is None
    value = inputs[1] if first else inputs[0]
    if kind == "Div" and (not first or np.any(value == 0)):
        raise ReachError("Div must divide by constants that are not zero")
    if kind in ("Mul", "Div"):
        return value if kind == "Mul" else 1 / value, 0.0
    if kind == "Add":
        return 1.0, value
    return (1.0, -value) if first else (-1.0, value)


def _clip(inputs: list[Any], more: dict[str, Any]) -> Activation:
    given: list[Any] = [more.get("min"), more.get("max")]
    for at, value in enumerate(inputs[1:3]):
        given[at] = given[at] if value is None else value
    if given[0] is None or given[1] is None:
        raise ReachError("Clip must have both limits")
    low, high = (np.reshape(np.asarray(limit, dtype=float), -1) for limit in given)
    if low.size != 1 or high.size != 1:
        raise ReachError("Clip must have one number for each limit")
    return Activation("clip", float(low[0]), float(high[0]))


def _spread(value: Any, width: int) -> Array:
    """One constant for all components, or one each along the last axis."""
    given = np.asarray(value, dtype=float)
    if given.size not in (1, width):
        raise ReachError(f"constants of shape {given.shape} follow {width} values")
    return np.broadcast_to(given.reshape(-1), (width,))
