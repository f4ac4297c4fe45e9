"""Networks from ONNX files: read as data, never executed (optional package ``onnx``)."""

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ..numerics.checks import Array
from ..numerics.errors import ReachError
from ..numerics.files import read_regular
from ..numerics.packages import unusable
from .layers import Activation, Affine, Diagonal
from .network import Network

LARGEST = 64 * 2**20  # bytes of a file beyond which it is refused: a controller is small
WIDEST = 4096  # most components of an input or a layer
DEEPEST = 1000  # most layers

REAL = {1: 4, 11: 8}  # bytes of a number of the types that are read: float and double
SAME = ("Identity", "Flatten", "Reshape", "Squeeze", "Unsqueeze", "Dropout", "Cast")  # they change no value
ACTIVATIONS = {"Relu": 0.0, "LeakyRelu": 0.01, "Tanh": 0.0, "Sigmoid": 0.0}  # ``alpha`` where it is left out
ELEMENTWISE = ("Add", "Sub", "Mul", "Div", "BatchNormalization")
OPERATORS = ("Gemm", "MatMul", *ELEMENTWISE, *ACTIVATIONS, "Clip", "Constant", *SAME)
LEAST = float(np.finfo(np.float32).tiny)  # below it single precision may take a number for 0
UNLIMITED = float(np.finfo(float).max)  # limit of a Clip that gives none, by ONNX itself

Layer = Affine | Diagonal | Activation


def read_onnx(path: str | Path, precision: str = "real") -> Network:
    """Read a feed-forward network.

    Understood are Gemm, MatMul, Add, Sub, Mul, Div (with constants), BatchNormalization, Relu, LeakyRelu,
    Tanh, Sigmoid, Clip, Constant, and operators that change no value (Identity, Flatten, Reshape, Squeeze,
    Unsqueeze, Cast, Dropout of inference). Memory and time are bounded by the size of the file.

    Parameters
    ----------
    path : str or Path
    precision : {"real", "float32", "float64"}
        Arithmetic in which the network is evaluated, see `Network`.

    Raises
    ------
    ReachError
        If the package is missing, the file is none, too large, keeps weights elsewhere, branches, has an
        operator that is not understood, computes with other numbers than float or double, or has a weight
        that is not finite.
    """
    if problem := unusable("onnx"):
        raise ReachError(f"an ONNX file cannot be read: {problem}")
    import onnx

    if not isinstance(path, str | Path):
        raise ReachError(f"the path of a file is needed, got {type(path).__name__}")
    path = Path(path)
    try:
        data = read_regular(path, LARGEST)
        model = onnx.load_model_from_string(data)
        _require_known(model)
        layers = _layers(onnx.shape_inference.infer_shapes(model).graph, len(data))
        onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True)
        return Network(tuple(layers), precision)
    except OSError as error:
        raise ReachError(f"{path} cannot be read: {error.strerror}") from error
    except ReachError as error:
        raise ReachError(f"{path}: {error}") from error
    except Exception as error:  # the package raises errors of its own where a file or a tensor is garbled
        raise ReachError(f"{path} is not an ONNX file: {str(error).splitlines()[0]}") from error


def _require_known(model: Any) -> None:
    """Refuse other operators before shapes are inferred: that is cheap for the known ones only."""
    if model.functions:
        raise ReachError("operators defined in the file are not supported")
    for node in model.graph.node:
        if node.op_type not in OPERATORS or node.domain not in ("", "ai.onnx"):
            name = f"{node.domain}.{node.op_type}".lstrip(".")
            raise ReachError(f"the operator {name} is not understood; understood are {', '.join(OPERATORS)}")


def _layers(graph: Any, budget: int) -> list[Layer]:
    """Read the chain of operators, from the input to the output; at most `budget` numbers in all layers."""
    from onnx import TensorProto, helper

    tensors = {tensor.name: tensor for tensor in graph.initializer}
    graph_inputs = [value for value in graph.input if value.name not in tensors]
    if len(graph_inputs) != 1 or len(graph.output) != 1:
        raise ReachError(f"needs one input and one output, has {len(graph_inputs)} and {len(graph.output)}")
    values = [*graph_inputs, *graph.value_info, *graph.output]
    for value in values:
        if value.type.tensor_type.elem_type not in REAL:
            kind = TensorProto.DataType.Name(value.type.tensor_type.elem_type)
            raise ReachError(
                f"{value.name} is of type {kind}: only networks of FLOAT or DOUBLE are understood"
            )
    dims = {value.name: [axis.dim_value for axis in value.type.tensor_type.shape.dim] for value in values}
    current, shape, layers = graph_inputs[0].name, dims[graph_inputs[0].name], list[Layer]()
    width, kind = shape[-1] if shape else 0, ""
    if not 1 <= width <= WIDEST or any(size > 1 for size in shape[:-1]):
        raise ReachError(f"the input must be a vector of known size, has shape {shape}")

    @cache
    def numbers(name: str) -> Array:
        return _numbers(tensors[name], name)

    for node in graph.node:
        kind = node.op_type
        attributes = {item.name: helper.get_attribute_value(item) for item in node.attribute}
        if kind == "Constant":
            if "value" not in attributes:
                raise ReachError("a constant that is not a tensor is not understood")
            tensors[node.output[0]] = attributes["value"]
            continue
        if list(node.input).count(current) != 1 or any(
            name not in (current, "") and name not in tensors for name in node.input
        ):
            raise ReachError(f"{kind} takes more than constants and the output before it: no chain")
        if kind in SAME:
            _require_same(kind, attributes, [tensors.get(name) for name in node.input])
        else:
            inputs = [None if name in (current, "") else numbers(name) for name in node.input]
            new_layers = _convert(kind, inputs, attributes, width)
            layers += new_layers
            width = new_layers[-1].shape[0] if not isinstance(new_layers[-1], Activation) else width
            budget -= sum(value.size for value in inputs if value is not None)
        if len(layers) > DEEPEST or budget < 0:
            detail = f"at most {DEEPEST} layers, with no more numbers than the file has bytes, are read"
            raise ReachError(f"the network is larger than its file: {detail}")
        current = node.output[0]
        sizes = dims.get(current) or [0]  # as the package infers them
        if sizes[-1] != width or any(size > 1 for size in sizes[:-1]):
            raise ReachError(f"{kind} must leave {width} components along the last axis")
    if current != graph.output[0].name:
        raise ReachError("the output is not the end of the chain of operators")
    return layers


def _numbers(tensor: Any, name: str) -> Array:
    """Stored numbers of a tensor, of the shape that it declares."""
    from onnx import TensorProto, numpy_helper

    if tensor.data_location == TensorProto.EXTERNAL:
        raise ReachError(f"the weights {name} lie in another file")
    if tensor.data_type not in REAL:
        kind = TensorProto.DataType.Name(tensor.data_type)
        raise ReachError(f"the weights {name} are of type {kind}: only FLOAT and DOUBLE are understood")
    typed = tensor.float_data if tensor.data_type == TensorProto.FLOAT else tensor.double_data
    stored = len(tensor.raw_data) / REAL[tensor.data_type] if tensor.raw_data else len(typed)
    if any(size < 1 for size in tensor.dims) or math.prod(tensor.dims) != stored:
        raise ReachError(f"the weights {name} declare shape {list(tensor.dims)} and store {stored:g} numbers")
    value = numpy_helper.to_array(tensor)
    if not np.all(np.isfinite(value)):
        raise ReachError(f"the weights {name} are not finite numbers")
    return np.asarray(value, dtype=float)


def _require_same(kind: str, attributes: dict[str, Any], tensors: list[Any]) -> None:
    """Refuse a Cast to other numbers, and a Dropout of training."""
    from onnx import numpy_helper

    if kind == "Cast" and attributes.get("to") not in REAL:
        raise ReachError("a Cast must be to float or double: others change values")
    training = len(tensors) > 2 and tensors[2] is not None and bool(np.any(numpy_helper.to_array(tensors[2])))
    if kind == "Dropout" and (training or not attributes.get("is_test", 1)):
        raise ReachError("Dropout must be that of inference: its training_mode must be false")


def _convert(kind: str, inputs: list[Any], attributes: dict[str, Any], width: int) -> list[Layer]:
    """Layers that one operator makes of so many values."""
    if kind in ACTIVATIONS:
        return [Activation(kind.lower().removeprefix("leaky"), attributes.get("alpha", ACTIVATIONS[kind]))]
    if kind == "Clip":
        return [_clip(inputs, attributes)]
    if kind == "BatchNormalization":
        return _normalised(inputs, attributes, width)
    if kind in ELEMENTWISE:
        scale, b = _scaling(kind, inputs)
        return [Diagonal(_spread(scale, width), _spread(b, width))]
    W, b = _weights(kind, inputs, attributes)
    if W.shape[1] != width or len(W) > WIDEST:
        raise ReachError(f"weights of shape {W.shape} follow {width} values, at most {WIDEST}")
    alpha, b = attributes.get("alpha", 1.0), _spread(b, len(W))
    if alpha == 1:
        return [Affine(W, b)]
    return [Affine(W, _spread(0.0, len(W))), Diagonal(_spread(alpha, len(W)), b)]


def _weights(kind: str, inputs: list[Any], attributes: dict[str, Any]) -> tuple[Array, Array]:
    """Weights and biases of a product."""
    if len(inputs) < 2 or inputs[0] is not None or inputs[1] is None or inputs[1].ndim != 2:
        raise ReachError(f"{kind} must multiply by weights from the right")
    if attributes.get("transA", 0):
        raise ReachError("Gemm with a transposed input is not supported")
    b = inputs[2] if len(inputs) > 2 and inputs[2] is not None else np.zeros(1)
    return inputs[1] if attributes.get("transB", 0) else inputs[1].T, attributes.get("beta", 1.0) * b


def _normalised(inputs: list[Any], attributes: dict[str, Any], width: int) -> list[Layer]:
    """Less the mean, then scaled and shifted: each step's rounding is relative to its own terms."""
    if len(inputs) < 5 or inputs[0] is not None or attributes.get("training_mode", 0):
        raise ReachError("BatchNormalization must be that of inference")
    gain, shift, mean, variance = (_spread(value, width) for value in inputs[1:5])
    small = attributes.get("epsilon", 1e-5)
    if np.any(variance < 0) or small < 0:
        raise ReachError("BatchNormalization has a variance or an epsilon below 0")
    sizes = np.abs(np.concatenate([gain[gain != 0], variance + small]))
    if np.any((sizes < LEAST) | (sizes > 1 / LEAST)):
        rule = f"from {LEAST:.3g} to {1 / LEAST:.3g} in size, a gain may be 0"
        raise ReachError(f"BatchNormalization needs gains, and variances with epsilon, {rule}")
    scale = gain / np.sqrt(variance + small)
    return [Diagonal(_spread(1.0, width), -mean), Diagonal(scale, shift)]


def _scaling(kind: str, inputs: list[Any]) -> tuple[Any, Any]:
    """``scale y + b`` of an operator that takes every component for itself."""
    first = inputs[0] is None
    value = inputs[1] if first else inputs[0]
    if kind == "Div" and (not first or np.any(value == 0)):
        raise ReachError("Div must divide by constants that are not zero")
    if kind in ("Mul", "Div"):
        return value if kind == "Mul" else 1 / value, 0.0
    if kind == "Add":
        return 1.0, value
    return (1.0, -value) if first else (-1.0, value)


def _clip(inputs: list[Any], attributes: dict[str, Any]) -> Activation:
    """Limits of a Clip; one that is not given is the largest number."""
    limits: list[Any] = [attributes.get("min", -UNLIMITED), attributes.get("max", UNLIMITED)]
    for index, value in enumerate(inputs[1:3]):
        limits[index] = limits[index] if value is None else value
    low, high = (np.reshape(np.asarray(limit, dtype=float), -1) for limit in limits)
    if low.size != 1 or high.size != 1:
        raise ReachError("Clip must have one number for each limit")
    return Activation("clip", float(low[0]), float(high[0]))


def _spread(value: Any, width: int) -> Array:
    """Spread constants, one for all components or one each, over `width` components."""
    constants = np.asarray(value, dtype=float)
    if constants.size not in (1, width):
        raise ReachError(f"constants of shape {constants.shape} follow {width} values")
    return np.broadcast_to(constants.reshape(-1), (width,))
