"""Thrust that thrusters make of commands, and its effect on a flight by pulses and jitter."""

from functools import cached_property

import numpy as np

from ..model.craft import Array, Craft
from ..model.thrusters import Thrusters
from .allocating import thrusts_of
from .fault_times import FaultTimes

STAIRS = 4  # steps in which the thrust of a pulse comes up and goes down


def begins(on: Array, placed: str) -> Array:
    """Return the instants at which pulses begin that last for `on` (..., N), shares of their period.

    They are centred unless `placed` says that all begin at the start, or each where the one before it ends.
    """
    if placed == "staggered":
        return np.asarray(np.cumsum(on, axis=-1) - on)
    return 0.0 * on if placed else (1 - on) / 2


class Firing:
    """Thrusters over steps of an integration, R runs at once.

    Errors, as shares of the largest that what is commanded allows, are `thrust` (steps, R, m). Where shares
    of commands are constant in a flight those of the first step follow (`Thrusters.matrices`). Of N thrusters
    that push along the rows of `ways` (N, m), those of a layout or else one both ways along every input,
    pulses have the thrust `fired` (N,); without any, what is commanded is held. From `begin` on, the rest of
    an impulse is `rest` (R, N) [N s] if it is carried. Faults are `faults`.

    With jitter and pulses `parts` are (forces (R, .), inputs that a unit of each makes (., m), begin and end
    as shares of the period (R, .)). Forces that are held add to the inputs, pulses are all that is made. A
    pulse keeps its impulse, and one that is not over when the next of its thruster is due delays that.
    """

    system: Craft
    thrusters: Thrusters
    forces: Array  # of each thruster without errors, (R, N)
    dt: float
    substeps: int
    thrust: Array | None = None
    faults: FaultTimes | None = None
    rest: Array | None = None
    inputs: Array  # inputs, what fails apart, (R, m)
    before: Array  # those of the last period
    parts: list[tuple[Array, Array, Array, Array]]

    @cached_property
    def ways(self) -> Array:
        """Return the share of every input in a unit of thrust of each thruster, (N, m)."""
        layout = self.system.nozzles
        return np.eye(self.system.m) if layout is None else layout.allocation.directions

    @cached_property
    def fired(self) -> Array:
        """Return the thrust of pulses, (N,); empty where commands are held."""
        layout, timing = self.system.nozzles, self.system.timing
        return (
            np.array(timing.pulse_thrust) if layout is None or not layout.pulsed else layout.allocation.limits
        )

    def begin(self, runs: int) -> None:
        """Leave nothing of impulses."""
        self.rest = np.zeros((runs, len(self.ways))) if self.system.timing.carried_impulse else None
        self.parts, self.before = [], np.zeros((runs, self.system.m))

    def applied(self, raw: Array, step: int) -> Array:
        """Return the inputs that the thrusters make of commands in a step."""
        commanded = np.clip(raw, -self.system.u_max, self.system.u_max)
        layout, timing, full = self.system.nozzles, self.system.timing, self.system.u_max
        f = commanded if layout is None else thrusts_of(layout.allocation, commanded)
        if self.rest is not None:
            bit, full = (
                (timing.carried_impulse, full) if layout is None else (layout.bit, layout.allocation.limits)
            )
            h = self.dt * self.substeps
            due = f * h + self.rest
            impulse = bit * np.floor(np.abs(due) / bit * (1 + 1e-12))  # of impulses; not less by rounding
            impulse = np.where(impulse > 0, np.abs(due), 0.0) if timing.fine else impulse
            f = np.sign(due) * np.minimum(impulse / h, full)
            self.rest = due - f * h
        self.forces, base = f, f @ self.ways
        self.inputs = base if self.thrust is None else base + self._wrong(self.thrust, step, commanded, base)
        return self.inputs if self.faults is None else self.inputs + self.faults.added(base, step)

    def _wrong(self, thrust: Array, step: int, commanded: Array, inputs: Array) -> Array:
        """Return the errors of thrust in a step, by the commanded and the made thrust, (R, m)."""
        m, errors = self.system.m, self.thrusters
        if not errors.constant:
            return np.asarray(thrust[step][:, :m] * errors.error(commanded))
        shares = errors.matrices(thrust[0, :, m:].reshape(-1, m, m))
        fixed = thrust[step, :, :m] * errors.error(0 * commanded)
        return np.asarray(np.einsum("rab,rb->ra", shares, inputs) + fixed)

    def size(self, u: Array) -> Array:
        """Return the thrust that counts as velocity change while inputs u (R, m) are applied, (R,) [N].

        For a layout, the thrust of every thruster and the inputs applied beside it.
        """
        if (layout := self.system.nozzles) is None:
            return np.asarray(np.abs(u).sum(axis=1))
        return np.asarray(
            np.abs(self.forces) @ layout.allocation.lengths + np.abs(u - self.forces @ self.ways).sum(axis=1)
        )

    def start(self, step: int) -> None:
        """Note when thrust made in the period that begins with a step, and before, is in force."""
        late, last = np.zeros((len(self.inputs), 1)), self.parts
        if self.jitter > 0:
            late, previous, self.before = self.lateness(step), self.before, self.inputs
            self.parts = [(previous - self.inputs, np.eye(self.system.m), 0 * late, late)]
        if not len(self.fired):
            return
        duration, overlap = np.abs(self.forces) / self.fired, int(self.jitter + self.edges[-1] > 0)
        begin = begins(duration, self.system.timing.pulse_place) + late
        last = [(f, ways, other - 1, over - 1) for f, ways, other, over in last[:overlap]]
        for *_, over in last:  # what is not over yet
            begin = np.maximum(begin, over)
        self.parts = [(np.sign(self.forces) * self.fired, self.ways, begin, begin + duration), *last]

    @cached_property
    def edges(self) -> Array:
        """Shares of a period after which equal parts of the thrust of a pulse come up and go down."""
        edge = self.system.timing.edge / (self.dt * self.substeps)
        return edge * (np.arange(STAIRS) + 0.5) / STAIRS if edge else np.zeros(1)

    @cached_property
    def jitter(self) -> float:
        """Share of a period by which commands may come late."""
        return self.system.timing.jitter / (self.dt * self.substeps)

    def lateness(self, step: int) -> Array:
        """Return the share of the period by which made thrust takes effect late, (R, 1): all or nothing.

        Late is what the last inputs do more for along `thrust`, and nothing in the first period.
        """
        increase = self.before - self.inputs
        increase = increase * (0.0 if self.thrust is None else self.thrust[step][:, : increase.shape[1]])
        return np.where(increase.sum(axis=1, keepdims=True) > 0, self.jitter * (step > 0), 0.0)

    def _beyond(self, power: int, start: Array | float, end: Array | float) -> Array:
        """Moment of inputs about the end of a part of a period beyond those that are held, (R, m).

        Of each instant counts the time until then to a power, integrated; start, end and time are shares.
        """
        power += 1
        moment = -self.forces @ self.ways * (end - start) ** power if len(self.fired) else 0.0
        for force, ways, begin, over in self.parts:
            for edge in self.edges if len(self.fired) else (0.0,):
                rise, fall = (end - np.clip(each + edge, start, end) for each in (begin, over))
                moment = moment + force * (rise**power - fall**power) @ ways / len(self.edges)
        return np.asarray(moment)

    def excess(self, start: Array | float, end: Array | float) -> Array:
        """Mean of inputs from one share of a period to another, less those that are held, (R, m)."""
        return self._beyond(0, start, end) / np.maximum(end - start, 1e-300)

    def intersample(self, sub: int) -> Array | float:
        """Return the state offset by pulses and jitter at the end of a step of a period, (R, n)."""
        if not self.parts:
            return 0.0
        start, end = sub / self.substeps, (sub + 1) / self.substeps
        each = (self._beyond(power, start, end) @ term for power, term in enumerate(self._series))
        return np.asarray(sum(each, np.zeros(self.system.n)))

    @cached_property
    def _series(self) -> list[Array]:
        """State offset per unit of each moment of the inputs, (m, n) each."""
        h = self.dt * self.substeps
        terms, least = [self.system.B.T * h], 1e-15 * np.abs(self.system.B).max()
        while np.abs(terms[-1]).max() > least * h:
            terms.append(terms[-1] @ self.system.A.T * (h / (len(terms) + 1)))
        return terms
