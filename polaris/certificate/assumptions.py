"""Assumptions of a certificate that no checker can confirm, in words: one list for runs and certificates."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

UNSAFE = "unsafe sets (keep-out zones, outsides of keep-in zones)"
SATELLITES = (
    "other satellites: each obeys x' = A x + D w with the same A, D and bound on w, plus at most the "
    "acceleration declared for it"
)
"""Assumed where there are any."""

STATES = (
    "limits on the whole state: they apply to the state of the model, that of the navigated point, at times "
    "of the schedule"
)
"""Assumed where there are any."""

ALLOCATED = (
    "faults: at most one thruster fails, in a declared way that is known at once, and commands are "
    "allocated to the other thrusters"
)
"""Assumed where inputs are made by thrusters that may fail, or that are not aligned with them."""

PLACES = {
    "": "in its middle",
    "start": "from its start",
    "staggered": "one after another from its start, in their order and without a gap",
}
"""Places of the pulses of a period, by name."""

ALLOCATIONS = {
    "least_thrust_mixes": "the sum of a fixed mix of thrusters for each input and sign",
    "pseudo_inverse": "twice the positive part of the pseudo-inverse of all intact pairs times the inputs",
    "linear_program": "thrusts within their limits that produce the inputs, with the least sum weighted by "
    "the lengths of their directions",
    "nearest": "thrusts within their limits that produce the nearest inputs, of these the least in 2-norm",
}
"""Ways to allocate commands to the thrusters of a layout, by kind."""

NOTHING_ELSE = (
    "the safety controller flies from then on (in an outage of navigation: from its start), and no second "
    "fault occurs; goal, delta-v, estimates, enclosures and drift are claimed of flights without such faults"
)
"""Assumed of faults that are isolated late, and the claims that hold without them only."""


_ROUNDED = (
    "inputs are scaled and rounded to it, IEEE 754 rounds to nearest, sums are in any order, with or without "
    "fused multiply-add, and tanh and sigmoid are within {error:.2g} of their values"
)
ARITHMETIC = {
    "real": "evaluated in real arithmetic; rounding on the flight computer is not covered",
    "float32": f"evaluated in single precision (float32): {_ROUNDED.format(error=8 * 2.0**-24)}",
    "float64": f"evaluated in double precision (float64): {_ROUNDED.format(error=8 * 2.0**-53)}",
}
"""Assumption about the arithmetic of a network, by its precision."""


@dataclass(frozen=True)
class Assumptions:
    """Assumptions of a certificate that no checker can confirm: one account, for runs and certificates.

    Bounds are empty where there is nothing to bound.
    """

    w_max: float  # bound on the disturbance
    period: float  # in which commands are renewed once [s]
    bias: Iterable[float] = ()  # bounds on a constant that adds to w, by column of D
    resting: bool = True  # whether any unsafe set is at rest
    satellites: bool = False  # whether any is another satellite
    of_state: bool = False  # whether any limits the whole state
    horizon: str = "none"  # how long safety is claimed
    until: float | None = None  # last instant of a claim of one further period [s]
    estimate: Iterable[float] = ()  # bounds on the errors of the states' estimates, before any prediction
    by_step: bool = False  # whether there are bounds for every step besides
    observer: Iterable[float] = ()  # bounds on the errors of what an observer measures
    initial: Iterable[float] = ()  # bounds on the errors of its first estimate, if it has one
    constant: Iterable[float] = ()  # part of the errors of what it measures that is one for the whole flight
    timing: Iterable[float] = ()  # delay [s], jitter [s], periods that may be missed, clocks apart by [s]
    thrusters: Iterable[float] = ()  # shares of the command, of the 2-norm of others, of the mass; at all [N]
    same_shares: bool = False  # whether the first two are those of one matrix in a whole flight
    pulses: Iterable[float] = ()  # thrust of the pulses of every input, unless inputs are held
    placed: str = ""  # where these are in a period, unless in the middle
    fine: bool = False  # whether impulses above that are of any size instead
    edge: float = 0.0  # in which their thrust comes up or goes down [s]
    carried: float = 0.0  # impulse [N s] of which multiples are made, the rest being carried on; 0 without
    chaser: float = 0.0  # its radius [m]; 0 for a point
    allocated: bool = False  # whether inputs are made by thrusters of which one may have failed
    layout: str = ""  # kind of the allocation to thrusters that push along directions of their own
    late: Iterable[tuple[str, float]] = ()  # kinds of faults that are isolated late; how long that takes [s]
    sampled: Mapping[str, Any] | None = None  # of black boxes: probability, confidence, flights, outside, ...
    position: Iterable[Iterable[float]] = ()  # the rows of C
    networks: Iterable[tuple[str, str]] = ()  # names of networks, and the arithmetic of each

    def sentences(self) -> list[str]:
        """Return all assumptions that apply, in words, in the order that the format prescribes."""
        size = f"within {self.chaser:g} m of the navigated point, a radius added to every unsafe set"
        point = "a point; its size is part of the unsafe sets"
        ever = " for ever" if self.horizon == "infinite" else ""
        limits = f"with |u_i| <= u_max and any w of norm(w, 2) <= {self.w_max:g}"
        if any(bias := list(self.bias)):
            limits += f", plus a constant of the flight of at most [{_listed(bias)}]"
        axes = ", ".join(map(_sum, self.position))
        return [
            f"model: x' = A x + B u + D w {limits}",
            *([f"position: C x = ({axes}), states counted from 0; {UNSAFE} are sets of it"] * bool(axes)),
            "initial state: inside the initial set",
            f"chaser: {size if self.chaser else point}",
            "perception: every unsafe set lies in its timed polytope",
            *([f"sets at rest: they stay at rest{ever}"] if self.resting else []),
            *([SATELLITES] if self.satellites else []),
            *([STATES] if self.of_state else []),
            *self._of_hardware(),
            "experimental controllers: each obeys its declared model, and the obstacle states it receives "
            "agree with the declared motion",
            *(f"network {name}: {ARITHMETIC[precision]}" for name, precision in self.networks),
            *(_of_samples(**self.sampled) if self.sampled else []),
            self._of_fuel(),
        ]

    def _of_hardware(self) -> Iterator[str]:
        """Yield the errors and the delay of the state that is known, and the errors of commands."""
        errors, applied = list(self.estimate), list(self.thrusters)
        delay, jitter, missed, clock = list(self.timing) or (0.0, 0.0, 0, 0.0)
        predicted = delay > 0 or missed > 0
        source = "an estimate of the state" if any(errors) else "the exact state"
        source = "a prediction of the state" if predicted else source
        yield f"sampling: commands are renewed on time every {self.period:g} s from {source}, and held"
        if measured := list(self.observer):
            of = " in each period that is not missed" if missed else " in each period"
            accuracy = f"errors of measurements{of} are at most [{_listed(measured)}]"
            if constant := list(self.constant):
                accuracy += f", of which [{_listed(constant)}] is constant in a flight"
            first = f"errors of the first estimate are at most [{_listed(self.initial)}]"
            text = first if list(self.initial) else "the filter has run long before the start"
            yield f"observer: {accuracy}, the filter has the stated gain, and {text}"
        elif any(errors):
            bounds = ", and in each step at most the bounds stated for it" if self.by_step else ""
            yield f"navigation: at all times estimate errors by state are at most [{_listed(errors)}]{bounds}"
        if any(applied):
            if self.carried:
                applied[3] = 0.0
            if self.layout:
                units = "of it lengthwise", "of it sideways", "of it by the mass", "N of an input by rounding"
                command = "rounded impulse" if self.carried else "command"
                bound = ", ".join(f"{x:g} {of}" for x, of in zip(applied, units, strict=True) if x)
                yield f"thrusters: each is off its {command} by at most {bound}"
            else:
                units = "|u_i|", "norm(u_other, 2)", "", "N"
                bound = " + ".join(f"{x:g} {of}" for x, of in zip(applied, units, strict=True) if x)
                command = "u_i, the thrust made of its command" if self.carried else "its command u_i"
                same = ", by one constant matrix in a flight" * self.same_shares
                yield f"thrusters: the thrust applied to an input is within {bound} of {command}{same}"
        if self.carried and self.layout:
            remainder = f"zero at first and at most {self.carried:g} N s of an input in all"
            yield f"impulses: the remainder of each thruster, {remainder}, is carried to the next period"
        elif self.carried:
            text = "its command unless that is below" if self.fine else "a multiple of"
            text = f"each input makes in a period {text} {self.carried:g} N s, or all that its limit allows"
            yield f"impulses: {text}; the remainder, zero at first, is carried to the next period"
        if fired := ", ".join(f"{x:g}" for x in self.pulses):
            text = f"each input is one pulse per period, {PLACES[self.placed]}, of the thrusts [{fired}]"
            if self.layout:
                text = f"each thruster fires one pulse per period, {PLACES[self.placed]}; simultaneous ones "
                text += f"make at most [{fired}] N"
            text += f"; thrust rises and falls within {self.edge:g} s, impulses are kept" * (self.edge > 0)
            steady = "a pulse keeps its impulse whenever it begins, and overlaps no other of its thruster"
            text += f"; {steady}" * (jitter > 0)
            yield f"pulses: {text}; thruster errors are constant in a period"
        late = ", ".join(f"{name} within {lasts:g} s" for name, lasts in self.late)
        if self.allocated:
            isolated = "known at once or when it is isolated" if late else "known at once"
            yield ALLOCATED.replace("known at once", isolated)
        if self.layout:
            yield f"allocation: the thrusters' commands are {ALLOCATIONS[self.layout]}"
        if late:
            yield f"isolation: {late}; {NOTHING_ELSE}"
        if predicted or jitter > 0:
            late = f"timing: commands take effect {delay:g} s after their measurement"
            late += f", up to {jitter:g} s earlier or later from the second on" if jitter else ""
            late += f", with at most {missed} missed periods in a row" if missed else ""
            yield f"{late}; commands in force meanwhile are known, and the model holds before the start, too"
        if clock > 0:
            common = "schedule and reference count from the same instant"
            yield f"clocks: {common}, unsafe sets from an instant within {clock:g} s of it"
        else:
            yield "clocks: exact; schedule, reference and unsafe sets count from the same instant"

    def _of_fuel(self) -> str:
        ever = self.horizon == "infinite"
        if self.horizon == "none" or not (ever or self.until):
            return "fuel: enough for every command up to T"
        end = "for ever" if ever else f"until {self.until:g} s"
        return f"after T: the safety controller flies on {end}, with fuel for every command"


def claim_time(horizon: str, until: float | None) -> str:
    """Return until when safety is claimed, in words."""
    end = "end of the schedule" + ", then one period under S" * (horizon == "one_period")
    return "for all time" if horizon == "infinite" else f"until {until or 0:.6g} s ({end})"


def _sum(row: Iterable[float]) -> str:
    """Return a combination of states in words."""
    return " + ".join(f"{x:g} x{i}".removeprefix("1 ") for i, x in enumerate(row) if x)


def _listed(bounds: Iterable[float]) -> str:
    return ", ".join(f"{x:g}" for x in bounds)


def _of_samples(
    probability: float, confidence: float, flights: int, outside: int, seed: int, attempts: int
) -> list[str]:
    """Return the conditions of a statement about black boxes."""
    bound = f"{math.ceil(probability * 1e6) / 1e6:g}"
    risk = f"{float(f'{1 - confidence:.12g}'):g}"
    return [
        "black boxes: a random flight leaves the bands of their commands with a probability of at most"
        f" {bound}; this statement is wrong with a probability of {risk} over samples ({flights} flights,"
        f" {outside} outside, seed {seed}, attempt {attempts}); flights that leave the bands are not covered",
        "distribution: the initial state of a flight is uniform in the generators of the initial set, its"
        " disturbance and the errors of estimates and thrusters piecewise constant as simulated at random;"
        " flights are independent, and no results of other seeds were looked at",
        "no drift: the boxes answer in flight as they answered the samples; they are reset before each flight"
        " and asked once in every control period of it, whichever controller flies, beside any other flights",
    ]


def hand_over(moving: bool, faulty: bool) -> tuple[str, ...]:
    """Return the assumptions of a mission beyond those of its legs: `moving` sets, thrusters that fail."""
    scenarios = "the scenario of every leg holds from the start of the leg on, whatever was flown before"
    start = "a leg starts at a node at which GO is given, known on board before its first command is made"
    moves = "sets that move: their motion counts from the start of the first leg"
    fails = "faults: at most one thruster fails in all legs together"
    return f"GO: {start}", f"legs: {scenarios}", *[moves] * moving, *[fails] * faulty
