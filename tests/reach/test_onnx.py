"""ONNX files: what is read computes what the file says; what is not understood is one clear error."""

import re
import tracemalloc

import numpy as np
import pytest

onnx = pytest.importorskip("onnx")

from onnx import TensorProto, helper, numpy_helper  # noqa: E402
from onnx.reference import ReferenceEvaluator  # noqa: E402

from polaris.scenario.tables.scene import Neural  # noqa: E402
from reach.networks import network  # noqa: E402
from reach.networks.onnx_file import OPERATORS, read_onnx  # noqa: E402
from reach.numerics.errors import ReachError  # noqa: E402
from reach.sets.zonotope import Zonotope  # noqa: E402


def constant(name, value):
    if isinstance(value, np.ndarray) and value.dtype != float:
        return numpy_helper.from_array(value, name)
    integral = isinstance(value, list) and all(isinstance(part, int) for part in value)
    return numpy_helper.from_array(np.asarray(value, dtype=np.int64 if integral else np.float32), name)


def model(nodes, weights, inputs=3, outputs=2, shape=None):
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, size)
        for name, size in (("x", [1, inputs] if shape is None else shape), ("y", [1, outputs]))
    ]
    stored = [constant(*pair) for pair in weights.items()]
    graph = helper.make_graph(nodes, "policy", ends[:1], ends[1:], stored)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def node(kind, inputs, out, **attributes):
    return helper.make_node(kind, inputs.split(), [out], **attributes)


def saved(tmp_path, *args, **options):
    path = tmp_path / "policy.onnx"
    path.write_bytes(model(*args, **options).SerializeToString())
    return path


RNG = np.random.default_rng(3)
W1, b1, W2, b2 = RNG.normal(size=(3, 5)), RNG.normal(size=5), RNG.normal(size=(2, 5)), RNG.normal(size=2)
LAST = node("Gemm", "h W2 b2", "y", transB=1, alpha=0.5, beta=2.0)
WEIGHTS = {"W1": W1, "b1": b1, "W2": W2, "b2": b2}
FIRST = node("Gemm", "x W1 b1", "a")
NORMAL = [node("Flatten", "x", "f"), node("Gemm", "f W1 b1", "a")]
NORMAL += [node("BatchNormalization", "a g s m v", "n"), node("Relu", "n", "h"), LAST]
SCALED = [node("Sub", "x mean", "c"), node("Div", "c spread", "d"), node("MatMul", "d W1", "a")]
SCALED += [node("Sub", "b1 a", "s"), node("Mul", "gain s", "g"), node("Relu", "g", "h"), LAST]
LOW, HIGH = {"low": np.float32(-0.5)}, {"high": np.float32(0.7)}
PLAIN = {"Relu": {}, "LeakyRelu": {"alpha": 0.3}, "Tanh": {}, "Sigmoid": {}}
CHAINS = {
    **{
        kind: (
            [node("MatMul", "x W1", "a"), node("Add", "a b1", "s"), node(kind, "s", "h", **more), LAST],
            {},
        )
        for kind, more in PLAIN.items()
    },
    "Clip": ([FIRST, node("Clip", "a low high", "h"), LAST], LOW | HIGH),
    "a clip from below": ([FIRST, node("Clip", "a low", "h"), LAST], LOW),
    "a clip from above": ([FIRST, helper.make_node("Clip", ["a", "", "high"], ["h"]), LAST], HIGH),
    "a steep relu": ([FIRST, node("LeakyRelu", "a", "h", alpha=1.5), LAST], {}),
    "dropout": ([FIRST, node("Dropout", "a share off", "h"), LAST], {"share": 0.5, "off": np.array(False)}),
    "scaled": (SCALED, {"mean": [1.0, 2.0, 3.0], "spread": [0.5, 2.0, 4.0], "gain": 1.5}),
    "normalised": (NORMAL, {"g": b1, "s": b1 + 1, "m": b1 - 1, "v": np.abs(b1) + 0.1}),
}


@pytest.mark.parametrize("name", CHAINS)
def test_it_computes_what_the_file_says(name, tmp_path):
    nodes, extra = CHAINS[name]
    path = saved(tmp_path, nodes, WEIGHTS | extra)
    net, truth = read_onnx(path), ReferenceEvaluator(str(path))
    for x in RNG.normal(size=(20, 1, 3)).astype(np.float32):
        assert net(x.astype(float))[0] == pytest.approx(truth.run(None, {"x": x})[0][0], rel=1e-5, abs=1e-5)


FIRST = node("Gemm", "x W1 b1", "h")
CLIPPED = node("Clip", "h low high", "t")
SECOND = node("Gemm", "t W2 b2", "y", transB=1)
WRONG = {
    "an operator": ([node("Softmax", "x", "h"), LAST], {}, "Softmax is not understood"),
    "a branch": ([FIRST, node("Add", "h h", "t"), SECOND], {}, "no chain"),
    "a step back": ([FIRST, node("Relu", "x", "t"), LAST], {}, "no chain"),
    "shapes": ([node("MatMul", "x W2", "y")], {}, "follow 3 values"),
    "nan": ([FIRST, LAST], {"W1": np.full((3, 5), np.nan)}, "not finite"),
    "an end elsewhere": ([FIRST], {}, "not the end"),
    "infinity": ([FIRST, LAST], {"b1": np.full(5, np.inf)}, "not finite"),
    "a bias of another size": ([node("Gemm", "x W1 b2", "h"), LAST], {}, "follow 5 values"),
    "nothing": ([node("Identity", "x", "y")], {}, "along the last axis"),
    "zero": ([node("Div", "x zero", "c"), node("Gemm", "c W1 b1", "h"), LAST], {"zero": 0.0}, "not zero"),
}

ON = {"share": 0.5, "on": np.array(True)}
BATCH, EDGE = node("BatchNormalization", "h W W W W", "t"), np.full(5, -9.99e-6)
UNEVEN = node("BatchNormalization", "h one one one v", "t")
SMALL = node("BatchNormalization", "h small one one one", "t")
BETWEEN = {
    "a column": (node("Add", "h column", "t"), {"column": np.ones((5, 1))}, "last axis"),
    "an integer": (node("Cast", "h", "t", to=6), {}, "t is of type INT32: only networks of FLOAT or DOUBLE"),
    "half precision": (node("Cast", "h", "t", to=10), {}, "type FLOAT16"),
    "whole weights": (node("Mul", "h whole", "t"), {"whole": np.arange(5)}, "type INT64"),
    "dropout of training": (node("Dropout", "h share on", "t"), ON, "training_mode"),
    "a foreign operator": (node("Relu", "h", "t", domain="some.where"), {}, "some.where"),
    "a column by a reshape": (node("Reshape", "h shape", "t"), {"shape": [5, 1]}, "last axis"),
    "a column by flattening": (node("Flatten", "h", "t", axis=2), {}, "last axis"),
    "a column by an axis": (node("Unsqueeze", "h axes", "t"), {"axes": [-1]}, "last axis"),
    "squeezed": (node("Squeeze", "h axes", "t"), {"axes": [1]}, "last axis"),
    "a falling relu": (node("LeakyRelu", "h", "t", alpha=-0.5), {}, "leaky"),
    "a clip upside down": (CLIPPED, {"low": 1.0, "high": 0.0}, "low <= high"),
    "a clip by vectors": (CLIPPED, {"low": [0.0] * 5, "high": [1.0] * 5}, "one number"),
    "a norm of another size": (BATCH, {"W": np.ones(4)}, "follow 5"),
    "a variance below 0": (BATCH, {"W": -np.ones(5)}, "variance"),
    "a variance that epsilon cancels": (UNEVEN, {"one": np.ones(5), "v": EDGE}, "below 0"),
    "a tiny gain": (SMALL, {"small": np.full(5, 1e-40), "one": np.ones(5)}, "a gain may be 0"),
    "too many": (node("Gemm", "h wide", "t"), {"wide": np.zeros((5, 4097))}, "at most 4096"),
}
WRONG |= {name: ([FIRST, kept, SECOND], more, words) for name, (kept, more, words) in BETWEEN.items()}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_not_understood_is_one_error(name, tmp_path):
    nodes, extra, words = WRONG[name]
    with pytest.raises(ReachError, match=words) as raised:
        read_onnx(saved(tmp_path, nodes, WEIGHTS | extra))
    assert "policy.onnx" in str(raised.value) and "\n" not in str(raised.value)


def test_operators_are_named_where_one_is_missing_and_where_networks_are_described(tmp_path):
    """The operators of the chains that are read, in the message, in the docstring and in the reference."""
    with pytest.raises(ReachError, match="the operator Elu is not understood") as raised:
        read_onnx(saved(tmp_path, [node("Elu", "x", "h"), LAST], WEIGHTS))
    field = Neural.model_fields["path"].description
    assert {one.op_type for nodes, _ in CHAINS.values() for one in nodes} <= set(OPERATORS)
    for text in (str(raised.value), read_onnx.__doc__, field):
        assert set(OPERATORS) <= set(re.findall(r"\w+", text))


KEPT = {
    "reshaped": [node("Reshape", "h shape", "t")],
    "cast": [node("Cast", "h", "t", to=1)],
    "an axis more, and less": [node("Unsqueeze", "h front", "u"), node("Squeeze", "u front", "t")],
}


@pytest.mark.parametrize("name", KEPT)
def test_shapes_may_change_where_no_value_moves(name, tmp_path):
    path = saved(tmp_path, [FIRST, *KEPT[name], SECOND], WEIGHTS | {"shape": [-1, 5], "front": [0]})
    x = RNG.normal(size=3)
    assert read_onnx(path)(x) == pytest.approx((x @ W1 + b1) @ W2.T + b2, rel=1e-6)


def test_garbled_files_are_one_error_or_a_network(tmp_path):
    nodes, extra = CHAINS["normalised"]
    stored, path, refused = saved(tmp_path, nodes, WEIGHTS | extra).read_bytes(), tmp_path / "garbled.onnx", 0
    for _ in range(400):
        data = bytearray(stored)
        for at in RNG.integers(0, len(data), int(RNG.integers(1, 6))):
            data[at] = int(RNG.integers(256))
        path.write_bytes(data[: len(data) if RNG.random() < 0.7 else int(RNG.integers(len(data)))])
        try:
            net = read_onnx(path)
        except ReachError as error:
            refused += "garbled.onnx" in str(error)
        else:
            assert np.all(np.isfinite(net.layers[0].W)) and net.inputs > 0
    assert 100 < refused < 400


def test_files_that_are_none(tmp_path):
    with pytest.raises(ReachError, match="cannot be read"):
        read_onnx(tmp_path / "missing.onnx")
    (tmp_path / "text.onnx").write_text("no network", encoding="utf-8")
    with pytest.raises(ReachError, match="not an ONNX file"):
        read_onnx(tmp_path / "text.onnx")
    with (tmp_path / "huge.onnx").open("wb") as file:
        file.truncate(65 * 2**20)
    with pytest.raises(ReachError, match="must have at most"):
        read_onnx(tmp_path / "huge.onnx")
    with pytest.raises(ReachError, match="vector of known size"):
        read_onnx(saved(tmp_path, [FIRST, LAST], WEIGHTS, shape=[4, 3]))


def cut_short(net):
    net.graph.initializer[0].raw_data = net.graph.initializer[0].raw_data[:-4]


def too_large(net):
    net.graph.initializer[0].dims[:] = [2**31, 2**31]


def elsewhere(net):
    net.graph.initializer[0].data_location = TensorProto.EXTERNAL


def defining(net):
    call = [helper.make_node("Relu", ["a"], ["b"])]
    net.functions.append(helper.make_function("", "Gemm", ["a"], ["b"], call, [helper.make_opsetid("", 17)]))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (cut_short, r"declare shape \[3, 5\] and store 14 numbers"),
        (too_large, "policy.onnx"),
        (elsewhere, "another file"),
        (defining, "operators defined in the file"),
    ],
)
def test_files_that_are_no_plain_model_are_one_error(change, words, tmp_path):
    net, path = model([FIRST, LAST], WEIGHTS), tmp_path / "policy.onnx"
    change(net)
    path.write_bytes(net.SerializeToString())
    with pytest.raises(ReachError, match=words):
        read_onnx(path)


def chain(kinds, width=4096):
    """A file of a few weights, then operators that each take a scalar."""
    names = ["h", *(f"v{i}" for i in range(len(kinds) - 1)), "y"]
    nodes = [node("Gemm", "x W b", "h", transB=1)]
    for i, kind in enumerate(kinds):
        scalar = " k" if kind in ("Add", "Sub", "Mul", "Div") else ""
        nodes.append(node(kind, names[i] + scalar, names[i + 1]))
    return model(nodes, {"W": np.zeros((width, 4)), "b": np.zeros(width), "k": 1.5}, inputs=4, outputs=width)


def test_elementwise_operators_cost_what_they_store(tmp_path):
    path = tmp_path / "policy.onnx"
    path.write_bytes(chain(["Add", "Mul", "Sub", "Div"] * 75).SerializeToString())
    tracemalloc.start()
    net = read_onnx(path)
    assert np.all(np.isfinite(net(np.ones(4)))) and len(net.layers) == 301
    assert tracemalloc.get_traced_memory()[1] < 20e6  # a dense matrix of this width is 134 MB
    tracemalloc.stop()


def test_networks_larger_than_their_files_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "policy.onnx"
    path.write_bytes(chain(["Relu"] * 1001, 4).SerializeToString())
    with pytest.raises(ReachError, match="at most 1000 layers"):
        read_onnx(path)
    square = np.zeros((200, 200))
    steps = [node("MatMul", f"v{i} S", f"v{i + 1}") for i in range(20)]
    tied = [node("Gemm", "x W b", "v0", transB=1), *steps, node("Identity", "v20", "y")]
    weights = {"W": np.zeros((200, 4)), "b": np.zeros(200), "S": square}
    path.write_bytes(model(tied, weights, inputs=4, outputs=200).SerializeToString())
    with pytest.raises(ReachError, match="no more numbers than the file has bytes"):
        read_onnx(path)
    monkeypatch.setattr(network, "MOST_ENTRIES", 10**6)
    path.write_bytes(chain(["Tanh"] * 20, 256).SerializeToString())
    with pytest.raises(ReachError, match="too wide or too deep"):
        read_onnx(path).enclose(Zonotope.box(np.zeros(4), np.ones(4)))
