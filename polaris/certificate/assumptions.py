"""Assumptions of a certificate that no checker can confirm, in words: one list for runs and certificates."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

SATELLITES = (
    "other satellites: each obeys x' = A x + D w with the same A, D and bound on w, and adds no more "
    "acceleration than is declared for it"
)
"""Assumed where there are any."""

STATES = (
    "limits on the whole state: they limit the states of the model, of the point that is navigated, at times "
    "of the schedule"
)
"""Assumed where there are any."""

ALLOCATED = (
    "faults: of the thrusters at most one fails, in a way that is declared and known at once, and what is "
    "commanded is allocated to the others"
)
"""Assumed where inputs are made by thrusters that may fail, or that are not aligned with them."""

PLACES = {
    "": "in the middle of it",
    "start": "from the start of it on",
    "staggered": "one after another from the start of it on, in their order and without a gap",
}
"""Places of the pulses of a period, by name."""

ALLOCATIONS = {
    "least_thrust_mixes": "the sum of a fixed mix for each input and sign",
    "pseudo_inverse": "twice the positive part of the pseudo-inverse, of whole pairs, times the inputs",
    "linear_program": "thrusts within their limits that make the inputs, of the least sum, each times the "
    "length of its direction",
    "nearest": "thrusts within their limits that come nearest to the inputs, of these the least in 2-norm",
}
"""Ways to allocate what is commanded to the thrusters of a layout, by kind."""

NOTHING_ELSE = (
    "the safety controller flies from then on (without measurements: from when they cease), and no second "
    "fault occurs; goal, velocity change, estimates, enclosures and drift are those of flights without such "
    "faults"
)
"""Assumed of faults that are isolated late, and what is told of them."""


_ROUNDED = (
    "inputs scaled and rounded to it, IEEE 754 rounding to nearest, sums in any order, with or without fused "
    "multiply-add; tanh and sigmoid are within {error:.2g} of their value"
)
ARITHMETIC = {
    "real": "it is evaluated in real arithmetic: how a flight computer rounds in it is not covered",
    "float32": f"it is evaluated in single precision (float32): {_ROUNDED.format(error=8 * 2.0**-24)}",
    "float64": f"it is evaluated in double precision (float64): {_ROUNDED.format(error=8 * 2.0**-53)}",
}
"""Assumption about the arithmetic of a network, by its precision."""


@dataclass(frozen=True)
class Premises:
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

    def told(self) -> list[str]:
        """Return all assumptions that apply, in words, in the order that the format prescribes."""
        size = f"within {self.chaser:g} m of the point that is navigated, which is added to every unsafe set"
        point = "a point, its own size being part of the unsafe sets"
        ever = " for ever" if self.horizon == "infinite" else ""
        limits = f"|u_i| <= u_max, norm(w, 2) <= {self.w_max:g} and otherwise arbitrary"
        if any(bias := list(self.bias)):
            limits += f", to which a constant within [{_listed(bias)}] adds, one in a whole flight"
        axes = ", ".join(map(_sum, self.position))
        return [
            f"model: x' = A x + B u + D w, {limits}",
            *([f"position: C x = ({axes}), states counted from 0; the unsafe sets lie there"] * bool(axes)),
            "initial state: inside the initial set",
            f"chaser: {size if self.chaser else point}",
            "perception: every unsafe set lies in its timed polytope",
            *([f"sets at rest: they stay at rest{ever}"] if self.resting else []),
            *([SATELLITES] if self.satellites else []),
            *([STATES] if self.of_state else []),
            *self._of_hardware(),
            "experimental controllers: each obeys its declared model, and what it is told of obstacles "
            "agrees with their declared motion",
            *(f"network {name}: {ARITHMETIC[precision]}" for name, precision in self.networks),
            *(_of_samples(**self.sampled) if self.sampled else []),
            self._of_fuel(),
        ]

    def _of_hardware(self) -> Iterator[str]:
        """Yield the errors and the delay of the state that is known, and the errors of commands."""
        errors, applied = list(self.estimate), list(self.thrusters)
        delay, jitter, missed, clock = list(self.timing) or (0.0, 0.0, 0, 0.0)
        predicted = delay > 0 or missed > 0
        seen = "an estimate of the state" if any(errors) else "the exact state"
        seen = "a prediction of the state" if predicted else seen
        yield f"sampling: commands are renewed every {self.period:g} s and held, in time and with {seen}"
        if measured := list(self.observer):
            of = " in each period that is not missed" if missed else " in each period"
            known = f"what is measured{of} is within [{_listed(measured)}] of what it should be"
            if constant := list(self.constant):
                known += f", of which [{_listed(constant)}] is a constant of the flight"
            first = list(self.initial)
            made = f"its first estimate is within [{_listed(first)}]" if first else "has long been at work"
            yield f"observer: {known}, the filter has the gain that is stated, and {made}"
        elif any(errors):
            near = f"no state is further from its estimate than [{_listed(errors)}], one by one"
            apart = ", nor in any step than is stated for it" if self.by_step else ""
            yield f"navigation: at all times {near}{apart}"
        if any(applied):
            if self.carried:
                applied[3] = 0.0
            if self.layout:
                units = "of it along it", "of it to its side", "of the mass", "N of an input by rounding"
                asked = "the impulse that it makes" if self.carried else "what it is asked for"
                off = ", ".join(f"{x:g} {of}" for x, of in zip(applied, units, strict=True) if x)
                yield f"thrusters: each is off {asked} by at most {off}"
            else:
                units = "|u_i|", "norm(u_other, 2)", "", "N"
                off = " + ".join(f"{x:g} {of}" for x, of in zip(applied, units, strict=True) if x)
                asked = "what is made of its command, u_i" if self.carried else "its command u_i"
                same = ", each command counting by the same share all flight" * self.same_shares
                yield f"thrusters: what is applied to an input is within {off} of {asked}{same}"
        if self.carried and self.layout:
            left = f"at first nothing, of an input at most {self.carried:g} N s in all"
            yield f"impulses: what thrusters leave of what they are asked for, {left}, is carried to the next"
        elif self.carried:
            made = "what it is asked for unless that is below" if self.fine else "a multiple of"
            made = f"a period makes {made} {self.carried:g} N s, or all that its limit allows"
            yield f"impulses: of each input {made}; what is left, at first nothing, is carried to the next"
        if fired := ", ".join(f"{x:g}" for x in self.pulses):
            made = f"one pulse per period, {PLACES[self.placed]}, of the thrusts [{fired}]"
            if self.layout:
                made = f"one pulse of each thruster per period, {PLACES[self.placed]}, of which those at "
                made += f"once make at most [{fired}] N"
            made += f", up and down within {self.edge:g} s with its impulse kept" * (self.edge > 0)
            made += ", of its impulse whenever it begins, never over another of its thruster" * (jitter > 0)
            yield f"pulses: inputs are made by {made}, errors of the thrusters being constant in a period"
        late = ", ".join(f"{name} after {lasts:g} s" for name, lasts in self.late)
        if self.allocated:
            yield (
                ALLOCATED.replace("known at once", "known at once or when it is isolated")
                if late
                else ALLOCATED
            )
        if self.layout:
            yield f"allocation: thrusters are asked for {ALLOCATIONS[self.layout]}"
        if late:
            yield f"isolation: {late} at the latest; {NOTHING_ELSE}"
        if predicted or jitter > 0:
            late = f"timing: commands take effect {delay:g} s after the measurement they rest on"
            late += f", {jitter:g} s earlier or later from the second on" if jitter else ""
            late += f", at most {missed} periods in a row without a new one" if missed else ""
            yield (
                late + "; what is commanded meanwhile is known, and the model holds before the start as well"
            )
        if clock > 0:
            own = "schedule and reference count from the same instant"
            yield f"clocks: {own}, unsafe sets from within {clock:g} s of it"
        else:
            yield "clocks: exact; schedule, reference and unsafe sets count from the same instant"

    def _of_fuel(self) -> str:
        ever = self.horizon == "infinite"
        if self.horizon == "none" or not (ever or self.until):
            return "fuel: enough for every command up to T"
        end = "for ever" if ever else f"until {self.until:g} s"
        return f"after T: the safety controller flies on {end}, and there is fuel for every command"


def _sum(row: Iterable[float]) -> str:
    """Return a combination of states in words."""
    terms = (f"{x:g} x{i}".removeprefix("1 ") for i, x in enumerate(row) if x)
    return " + ".join(terms)


def _listed(bounds: Iterable[float]) -> str:
    return ", ".join(f"{x:g}" for x in bounds)


def _of_samples(
    probability: float, confidence: float, flights: int, outside: int, seed: int, attempts: int
) -> list[str]:
    """Return the conditions of a statement about black boxes."""
    bound = f"{math.ceil(probability * 1e6) / 1e6:g}"
    doubt = f"{float(f'{1 - confidence:.12g}'):g}"
    return [
        "black boxes: a flight drawn at random leaves the bands of their commands with a probability of at"
        f" most {bound}; that is wrong with a probability of {doubt} over the samples ({flights} flights,"
        f" {outside} outside, seed {seed}, attempt {attempts}); of flights that leave them nothing is known",
        "distribution: a flight's initial state is uniform in the generators of the initial set, its"
        " disturbance and the errors of estimates and thrusters piecewise constant as simulated at random;"
        " flights are independent, and nobody looked what other seeds say",
        "no drift: the boxes answer in flight as they answered the samples: begun afresh with every flight"
        " and asked once in every control period of it, whoever flies, in no matter what other flights",
    ]


def hand_over(moving: bool, faulty: bool) -> tuple[str, ...]:
    """Return what a mission rests on besides its legs: `moving` sets, and thrusters that may fail."""
    known = "every leg's scenario is declared of the flight from its start on, whatever was flown before"
    start = "at a node at which it is given, known on board before the leg's first command is made"
    moves = "sets that move: they are where they are by the mission's clock, which starts with the first leg"
    fails = "faults: at most one thruster fails in all legs together"
    return f"GO: {start}", f"legs: {known}", *[moves] * moving, *[fails] * faulty
