"""Inputs and commands of a network: the part of it that knows nothing of sets."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from reach.networks.network import Network
from reach.networks.precision import MORE
from reach.short_repr import short_repr

from ...model.craft import Array, Craft
from ...model.errors import ScenarioError
from ...model.scene.obstacle import RigidObstacle
from ...model.scene.satellite import SatelliteObstacle
from ...model.tolerances import ROUNDING

OF_BODY = ("position", "velocity", "relative_position", "relative_velocity")
"""Readable values of an obstacle, absolute or less the chaser's own; its name follows after a colon."""


@dataclass(frozen=True, eq=False)
class Senses:
    """Everything that a policy may read, from the state and the obstacle data."""

    system: Craft
    bodies: tuple[RigidObstacle | SatelliteObstacle, ...]  # of each, position [m] and velocity [m/s]

    @classmethod
    def from_inputs(
        cls, system: Craft, inputs: tuple[str, ...], unsafe: Iterable[object], field: str
    ) -> "Senses":
        """Return the senses that inputs require in a scene; names the field if an input is none of them."""
        bodies = {item.name: item for item in unsafe if isinstance(item, RigidObstacle | SatelliteObstacle)}
        names = dict.fromkeys(name.partition(":")[2] for name in inputs)
        senses = cls(system, tuple(bodies[name] for name in names if name in bodies))
        if not inputs or len(set(inputs)) < len(inputs) or not set(inputs) <= senses.sizes.keys():
            plain = ", ".join(name for name in senses.sizes if ":" not in name)
            rule = f"must name each once, of {plain}, or {', '.join(OF_BODY)} with a colon and an obstacle"
            raise ScenarioError(field, list(inputs), f"{rule} (here {', '.join(bodies) or 'there is none'})")
        return senses

    @property
    def sizes(self) -> dict[str, int]:
        """Return the size of each input."""
        n, d = self.system.n, self.system.d
        plain = {"error": n, "state": n, "time": 1, "reference_input": self.system.m}
        return plain | {f"{kind}:{body.name}": d for body in self.bodies for kind in OF_BODY}

    def parts(self, reference: Array, x: Array, time: Array, nu: Array, bodies: Array) -> dict[str, Array]:
        """Inputs by name: a reference's state and input, a time, and obstacle data (..., 2d per body)."""
        inputs, d = {"error": reference - x, "state": x, "time": time, "reference_input": nu}, self.system.d
        for j, body in enumerate(self.bodies):
            for i, rows in enumerate((self.system.position, self.system.velocity)):
                values = bodies[..., (2 * j + i) * d : (2 * j + i + 1) * d]
                inputs[f"{OF_BODY[i]}:{body.name}"] = values
                inputs[f"{OF_BODY[i + 2]}:{body.name}"] = values - x @ rows.T
        return inputs

    def state_boxes(self, h: float, count: int) -> tuple[Array, Array]:
        """Box of obstacle data at times h [s] apart: middle and half-widths, (count, 2d per body)."""
        boxes = [body.state_boxes(self.system, h, count) for body in self.bodies]
        empty = np.zeros((count, 0))
        return np.hstack([empty, *(c for c, _ in boxes)]), np.hstack([empty, *(half for _, half in boxes)])

    def body_motion(self, t: float, states: Mapping[str, Array], runs: int) -> Array:
        """Return the motion of bodies; states (R, n) of satellites are given by name; (R, 2d per body)."""
        parts = [part for b in self.bodies for part in b.motion(t, self.system, states.get(b.name))]
        return np.hstack([np.broadcast_to(part, (runs, self.system.d)) for part in parts])


def stacked(inputs: tuple[str, ...], parts: dict[str, Array]) -> Array:
    """Arrays by name side by side, of broadcastable leading shapes."""
    chosen = [parts[name] for name in inputs]
    lead = np.broadcast_shapes(*(part.shape[:-1] for part in chosen))
    return np.concatenate([np.broadcast_to(part, (*lead, part.shape[-1])) for part in chosen], axis=-1)


@short_repr
@dataclass(frozen=True, eq=False)
class Policy:
    """``u = output_scale * network(input_scale * z)``, before the thrusters clip it.

    Parameters
    ----------
    network : reach.networks.network.Network
        Its precision is that in which it is evaluated on board.
    inputs : tuple of str
        Entries of z, in order: "error" (own reference - x), "state", "time" (start of the step [s]),
        "reference_input" (of the own reference); of an obstacle b "position:b" [m], "velocity:b" [m/s],
        and "relative_position:b", "relative_velocity:b", the same less the chaser's own.
    input_scale : ndarray, shape (r,)
    output_scale : ndarray, shape (m,)
        Positive, in units of the input.
    """

    network: Network
    inputs: tuple[str, ...]
    input_scale: Array
    output_scale: Array

    def check(self, senses: Senses, field: str, file: str = "a network") -> None:
        """Refuse a policy that does not fit a system; messages name the scenario's table and the file."""
        read, outputs = sum(senses.sizes[name] for name in self.inputs), senses.system.m
        if self.network.inputs != read:
            rule = f"must give the {self.network.inputs} inputs of the network, but give {read}"
            raise ScenarioError(f"{field}.inputs", list(self.inputs), rule)
        if self.network.outputs != outputs:
            rule = f"must have {outputs} outputs, one per input of the system, but has {self.network.outputs}"
            raise ScenarioError(f"{field}.path", file, rule)
        for name, scale, size in (
            ("input_scale", self.input_scale, read),
            ("output_scale_N", self.output_scale, outputs),
        ):
            if np.shape(scale) != (size,):
                raise ScenarioError(f"{field}.{name}", np.ravel(scale).tolist(), f"must have {size} numbers")

    def steepest(self, system: Craft, unsafe: Iterable[object]) -> Array:
        """Largest size of every entry of its derivative by the state, shape (m, n), in a scene."""
        senses, n = Senses.from_inputs(system, self.inputs, unsafe, "inputs"), system.n
        others = (np.zeros((n, size)) for size in (1, system.m, 2 * system.d * len(senses.bodies)))
        read = senses.parts(np.zeros(n), np.eye(n), *others)
        M, rounding = self.network.steepest(self.stack(read).T), self.network.rounding
        M = M if rounding is None else M * (1 + rounding.relative(1 + MORE)) * (1 + rounding.relative(2))
        return np.asarray(self.output_scale[:, None] * M * (1 + ROUNDING))

    def stack(self, parts: dict[str, Array]) -> Array:
        """Scaled inputs, shape (..., r), from arrays by name, of broadcastable leading shapes."""
        return stacked(self.inputs, parts) * self.input_scale
