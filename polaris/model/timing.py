"""Chain from a measurement to the thrust that answers it: observers, delays, jitter, pulses, faults.

Faults until they are isolated: thrust that is not as commanded, or no measurement, for a while.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field

from .keys import Key, NonNegative, Real, Whole
from .system import Array
from .thrusters import Thrusters

WHOLE = 1e-9  # share by which a delay may exceed a whole number of periods and count as one


@dataclass(frozen=True)
class Lead:
    """Bounds on the mean impulses of a period by which pulses are ahead of held inputs, or behind [N s]."""

    shares: tuple[tuple[float, ...], ...]  # of each input, rows, by a unit of each command, (m, m)
    fixed: tuple[float, ...]  # whatever is commanded, (m,)
    cap: tuple[float, ...]  # besides, however much is commanded, (m,)

    @property
    def least(self) -> "Lead":
        """Return the leads under no command."""
        return replace(self, cap=(0.0,) * len(self.cap))

    def part(self, u: Array) -> Array:
        """Return the part that is proportional to commands up to u at most, (..., m); subadditive."""
        return np.asarray(np.minimum(u @ np.array(self.shares).T, np.array(self.cap)))


@dataclass(frozen=True)
class Timing:
    """Time between a measurement and the thrust that answers it.

    Controllers act on the predicted state at which their command takes effect. Commands in force until then
    are known, also those before the start.

    Parameters
    ----------
    delay : float [s]
        Time from a measurement until its command takes effect.
    jitter : float [s]
        Largest deviation of that time, or of the calls of an inspection's filter.
    missed : int
        Most consecutive periods without a new measurement or command; commands are sent that many periods
        ahead.
    clock : float [s]
        Largest difference of the clocks of schedule and obstacles.

    Notes
    -----
    See Proposition 7 (a) and Lemma 6 of the theory. All other fields follow from these and the system.
    """

    delay: Annotated[float, Key("delay_s", "s", Annotated[Real, Field(ge=0, le=1e4)])] = 0.0
    jitter: Annotated[float, Key("jitter_s", "s", NonNegative)] = 0.0
    missed: Annotated[int, Key("missed_periods", "-", Annotated[Whole, Field(ge=0, le=1000)])] = 0
    clock: Annotated[float, Key("clock_error_s", "s", NonNegative)] = 0.0
    on_time: Thrusters = Thrusters()  # errors of thrusters without what stands for jitter and pulses
    measured_error: tuple[float, ...] = ()  # bounds on the errors of the measured states, (n,)
    state_offset: tuple[float, ...] = ()  # of the true state: jitter, pulses, remainders, (n,)
    pulse_thrust: tuple[float, ...] = ()  # thrust of the pulses of every input, one a period [N]
    pulse_place: str = ""  # place of pulses in a period, "start" or "staggered"; empty: centred, or none
    lead: Lead | None = None  # of pulses that are not centred
    intersample_offset: tuple[float, ...] = ()  # part of `state_offset` within periods, zero at nodes, (n,)
    edge: float = 0.0  # time in which the thrust of a pulse comes up or goes down, at most [s]
    carried_impulse: float = 0.0  # impulse of an input, at most, that is left to the next period [N s]
    fine: bool = False  # impulses above the bit may be of any size
    period: float = 0.0  # if any is [s]
    by_lag: tuple[tuple[int, tuple[tuple[float, ...], ...]], ...] = ()
    """Bounds on the unmeasured error of the estimate that a command rests on, per unit thruster error of up
    to so many periods before: periods and numbers (n, k)."""

    @property
    def instant(self) -> bool:
        """True if commands take effect at once, and on time."""
        return not (self.delay > 0 or self.jitter > 0 or self.missed > 0)


@dataclass(frozen=True, eq=False)
class Observer:
    """``x+ = x- + gain (y - measures x-)`` at every node, ``x-`` predicted under the commands in force.

    After missed periods the gain is another one.
    """

    measures: Array  # what is measured of a state, (r, n)
    noise: Array  # bounds on the errors of what is measured, (r,)
    gain: Array  # (n, r)
    after: tuple[Array, ...] = ()  # gains after 1, 2, ... periods without a measurement, (n, r) each
    initial: Array | None = None  # bounds on the errors of the first estimate, (n,), unless long in use
    horizon: tuple[int, int] = (0, 0)  # steps of the flight, and periods in each
    settled: Array | None = None  # of one that has long been made, (n,)
    fading: Array | None = None  # what the first errors still add in each step and ever after, (K + 1, n)
    followed: int = 0  # periods for which what is left of errors is followed, if periods may be missed
    constant: Array | None = None  # part of `noise` that is one value for the whole flight, (r,)
    ages: tuple[int, ...] = ()  # in periods, from 0 on, if periods may be missed
    by_age: Array | None = None
    """Errors by a unit of errors of thrusters of so many periods before an update, and more, (., n, m)."""

    def errors(self, signs: Array, first: Array) -> Array:
        """Return measurement errors at their bounds: by `signs`, the constant part by `first`."""
        constant = 0 * self.noise if self.constant is None else self.constant
        return (self.noise - constant) * signs + constant * first

    @property
    def fallen(self) -> Array:
        """Return by how much `by_age` falls from one age to the next, shape (. - 1, n, m)."""
        assert self.by_age is not None
        return -np.diff(self.by_age, axis=0)

    def by_command(self, error: Array) -> Array | float:
        """Return the estimate error (n,) by thruster errors (m,) not older than the last of the ages."""
        return 0.0 if self.by_age is None else np.asarray((self.by_age[0] - self.by_age[-1]) @ error)

    @property
    def rest(self) -> Array:
        """Map of an error over an update, shape (n, n)."""
        return self.rests[0]

    @property
    def rests(self) -> list[Array]:
        """Maps of an error over an update after 0, 1, ... missed periods, shape (n, n) each."""
        return [np.eye(len(gain)) - gain @ self.measures for gain in (self.gain, *self.after)]


@dataclass(frozen=True, eq=False)
class Transient:
    """Of one fault, once in a flight, the time until S flies on for good (docs/theory.md, Proposition 8)."""

    name: str  # kind of the fault
    lasts: float  # for how long at most [s]
    thrust: Array
    """Inputs that each thruster alone makes at its limit, of which one may fail [N], (N, m); none of them
    where it is navigation that is lost, and S flies on at once."""
    share: float  # of its thrust that is lost, or pushes without being asked to
    gains: Array  # largest sizes of the entries of all experimental controllers' gains, (m, n)
    boxes: bool = False  # True if black boxes fly, whose answers may be any
    networks: Array | None = None  # the same of networks: how steep they are in the state
    after: float = 0.0  # so much longer [s] decisions on predictions go on that did not know of it
    missed: int = 1  # periods since the last estimate after which S flies at the latest, where they are lost

    @property
    def pushes(self) -> Array:
        """Largest differences of inputs from commands meanwhile: a row for each kind, shape (J, m) [N]."""
        return np.asarray(np.unique(np.abs(self.thrust) * self.share, axis=0))

    def wrong(self, thrusters: Thrusters) -> Array:
        """Return the fault thrust plus the proportional thruster error that it causes, shape (J, m) [N]."""
        return np.asarray(self.pushes + thrusters.part(self.pushes))
