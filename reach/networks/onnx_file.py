"""Networks from ONNX files: read as data, never executed (optional package ``onnx``)."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..numerics.checks import Array
from ..numerics.errors import ReachError
from .network import Activation, Affine, Network

LARGEST = 64 * 2**20  # bytes of a file beyond which it is refused: a controller is small
WIDEST = 4096  # most components of an input or a layer


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
        if path.stat().st_size > LARGEST:
            raise ReachError(f"has more than {LARGEST} bytes: not a controller")
        model = onnx.load_model_from_string(path.read_bytes())
        found = _Reader(onnx.shape_inference.infer_shapes(model).graph).network()
        onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True)
        return found
    except OSError as error:
        raise ReachError(f"{path} cannot be read: {error.strerror}") from error
    except ReachError as error:
        raise ReachError(f"{path}: {error}") from error
    except Exception as error:  # the package raises errors of its own where a file or a tensor is garbled
        raise ReachError(f"{path} is not an ONNX file: {str(error).splitlines()[0]}") from error


@dataclass
class _Reader:
    """One walk along the chain of operators, from the input to the output."""

    graph: Any
    layers: list[Affine | Activation] = field(default_factory=list)
    width: int = 0

    def network(self) -> Network:
        from onnx import TensorProto, numpy_helper

        self.constants: dict[str, Array] = {}
        for tensor in self.graph.initializer:
            if tensor.data_location == TensorProto.EXTERNAL:
                raise ReachError(f"the weights {tensor.name} lie in another file")
            self._keep(tensor.name, numpy_helper.to_array(tensor))
        given = [value for value in self.graph.input if value.name not in self.constants]
        if len(given) != 1 or len(self.graph.output) != 1:
            raise ReachError(f"needs one input and one output, has {len(given)} and {len(self.graph.output)}")
        known = [*self.graph.input, *self.graph.value_info, *self.graph.output]
        dims = {value.name: [axis.dim_value for axis in value.type.tensor_type.shape.dim] for value in known}
        shape = dims[given[0].name]
        self.width = shape[-1] if shape else 0
        if not 1 <= self.width <= WIDEST or any(size > 1 for size in shape[:-1]):
            raise ReachError(f"the input must be a vector of known size, has shape {shape}")
        at = given[0].name
        for node in self.graph.node:
            at = self._apply(node, at)
            sizes = dims.get(at) or [0]  # as the package infers them
            if sizes[-1] != self.width or any(size > 1 for size in sizes[:-1]):
                raise ReachError(f"{node.op_type} must leave {self.width} components along the last axis")
        if at != self.graph.output[0].name:
            raise ReachError("the output is not the end of the chain of operators")
        return Network(tuple(self.layers))

    def _apply(self, node: Any, at: str) -> str:
        from onnx import helper, numpy_helper

        more = {item.name: helper.get_attribute_value(item) for item in node.attribute}
        if node.op_type == "Constant":
            if "value" not in more:
                raise ReachError("a constant that is not a tensor is not understood")
            self._keep(node.output[0], numpy_helper.to_array(more["value"]))
            return at
        if node.op_type not in _OPERATORS or node.domain not in ("", "ai.onnx"):
            raise ReachError(f"the operator {node.op_type} is not understood")
        inputs = [None if name == at or not name else self.constants.get(name, name) for name in node.input]
        if list(node.input).count(at) != 1 or any(isinstance(value, str) for value in inputs):
            raise ReachError(f"{node.op_type} takes more than constants and the output before it: no chain")
        _OPERATORS[node.op_type](self, inputs, more)
        return str(node.output[0])

    def _keep(self, name: str, value: Any) -> None:
        if value.dtype.kind not in "fiu" or not np.all(np.isfinite(value)):
            raise ReachError(f"the weights {name} are not finite numbers")
        self.constants[name] = np.asarray(value, dtype=float)

    def _affine(self, W: Array, b: Array) -> None:
        if W.ndim != 2 or W.shape[1] != self.width or len(W) > WIDEST:
            raise ReachError(f"weights of shape {W.shape} follow {self.width} values, at most {WIDEST}")
        self.layers.append(Affine(W, _spread(b, len(W))))
        self.width = len(W)

    def _gemm(self, inputs: list[Any], more: dict[str, Any]) -> None:
        W = self._weights(inputs, "Gemm")
        if more.get("transA", 0):
            raise ReachError("Gemm with a transposed input is not understood")
        W = W if more.get("transB", 0) else W.T
        b = inputs[2] if len(inputs) > 2 and inputs[2] is not None else np.zeros(1)
        self._affine(more.get("alpha", 1.0) * W, more.get("beta", 1.0) * b)

    def _matmul(self, inputs: list[Any], _: dict[str, Any]) -> None:
        self._affine(self._weights(inputs, "MatMul").T, np.zeros(1))

    @staticmethod
    def _weights(inputs: list[Any], name: str) -> Array:
        if len(inputs) < 2 or inputs[0] is not None or inputs[1] is None or inputs[1].ndim != 2:
            raise ReachError(f"{name} must multiply by weights from the right")
        return np.asarray(inputs[1])

    def _diagonal(self, scale: Any, shift: Any) -> None:
        self._affine(np.diag(_spread(scale, self.width)), np.asarray(shift, dtype=float))

    def _cast(self, _: list[Any], more: dict[str, Any]) -> None:
        if more.get("to") not in (1, 11):
            raise ReachError("a Cast must be to float or double: others change values")

    def _combine(self, inputs: list[Any], _: dict[str, Any], kind: str) -> None:
        first = inputs[0] is None
        value = inputs[1] if first else inputs[0]
        if kind == "Div" and (not first or np.any(value == 0)):
            raise ReachError("Div must divide by constants that are not zero")
        sign = -1.0 if kind == "Sub" else 1.0
        scale = {"Mul": value, "Div": 1 / value if kind == "Div" else 1.0}.get(kind, 1.0 if first else sign)
        shift = {"Add": value, "Sub": -value if first else value}.get(kind, 0.0)
        self._diagonal(scale, shift)

    def _normalize(self, inputs: list[Any], more: dict[str, Any]) -> None:
        if len(inputs) < 5 or more.get("training_mode", 0):
            raise ReachError("BatchNormalization must be that of inference")
        gain, shift, mean, variance = inputs[1:5]
        if np.any(variance + more.get("epsilon", 1e-5) <= 0):
            raise ReachError("BatchNormalization has a variance that is not positive")
        scale = gain / np.sqrt(variance + more.get("epsilon", 1e-5))
        self._diagonal(scale, shift - mean * scale)

    def _clip(self, inputs: list[Any], more: dict[str, Any]) -> None:
        given: list[Any] = [more.get("min"), more.get("max")]
        for at, value in enumerate(inputs[1:3]):
            given[at] = given[at] if value is None else value
        if given[0] is None or given[1] is None:
            raise ReachError("Clip must have both limits")
        low, high = (np.reshape(np.asarray(limit, dtype=float), -1) for limit in given)
        if low.size != 1 or high.size != 1:
            raise ReachError("Clip must have one number for each limit")
        self.layers.append(Activation("clip", float(low[0]), float(high[0])))


def _spread(value: Any, width: int) -> Array:
    """One constant for all components, or one each along the last axis."""
    given = np.asarray(value, dtype=float)
    if given.size not in (1, width):
        raise ReachError(f"constants of shape {given.shape} follow {width} values")
    return np.broadcast_to(given.reshape(-1), (width,))


def _activation(kind: str, default: float = 0.0) -> Callable[[_Reader, list[Any], dict[str, Any]], None]:
    return lambda reader, _, more: reader.layers.append(Activation(kind, more.get("alpha", default)))


_OPERATORS: dict[str, Callable[[_Reader, list[Any], dict[str, Any]], None]] = {
    "Gemm": _Reader._gemm,
    "MatMul": _Reader._matmul,
    "BatchNormalization": _Reader._normalize,
    "Clip": _Reader._clip,
    "Cast": _Reader._cast,
    "Relu": _activation("relu"),
    "LeakyRelu": _activation("relu", 0.01),
    "Tanh": _activation("tanh"),
    "Sigmoid": _activation("sigmoid"),
    **{kind: partial(_Reader._combine, kind=kind) for kind in ("Add", "Sub", "Mul", "Div")},
    **dict.fromkeys(("Identity", "Flatten", "Reshape", "Squeeze", "Unsqueeze", "Dropout"), lambda *_: None),
}
