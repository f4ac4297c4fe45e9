"""Layers of a network as a certificate has them."""

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Layer:
    """One layer of a network: weights and biases of an affine one, or limits of an activation."""

    kind: str  # affine, relu, tanh, sigmoid or clip
    W: list[list[float]] = field(default_factory=list)
    b: list[float] = field(default_factory=list)
    low: float = 0.0
    high: float = 0.0


def network_of(law: dict[str, Any]) -> dict[str, Any]:
    """Fields of a law that is a network, its layers of sizes that fit."""
    if law["kind"] != "neural":
        return {}
    layers, width = [Layer(**layer) for layer in law["layers"]], len(law["input_scale"])
    for layer in layers:
        if layer.kind == "affine":
            if not layer.W or len(layer.W) != len(layer.b) or any(len(row) != width for row in layer.W):
                raise ValueError(f"layers of {law['name']} do not fit one another")
            width = len(layer.W)
        elif (layer.kind == "relu" and not 0 <= layer.low <= 1) or not (
            layer.kind != "clip" or layer.low <= layer.high
        ):
            raise ValueError(f"{law['name']} has a {layer.kind} that decreases")
    if width != len(law["output_scale"]) or len(set(law["inputs"])) < len(law["inputs"]):
        raise ValueError(f"inputs or outputs of {law['name']} do not fit")
    scales = {name: law[name] for name in ("input_scale", "output_scale")}
    return {"reads": law["inputs"], "layers": layers, "bodies": law.get("bodies", []), **scales}
