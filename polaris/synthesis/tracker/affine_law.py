"""An affine feedback law: its data, and a period of its loop as a set, clipped or not."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from reach.numerics.linear import powers
from reach.numerics.relaxation import clip_relaxation
from reach.sets.zonotope import Zonotope
from reach.tubes.flow import LinearFlow, merged

from ...model.craft import Array, Craft
from ...model.errors import ScenarioError
from ...planning.reference import Reference
from .channel import Channel
from .feedback import Feedback
from .loop import ClosedLoop
from .period_sets import held_rates, rates_added, sampled_added, within_period
from .tracking import Tracking

LEVELS = np.array([1.03**-i for i in range(200, -1, -1)])
"""Shares of the thrust limits by which the commands of a step, and so errors of thrusters, are bounded."""
LOOP_ALONE = {
    *("closed", "flow", "error", "powers", "answers", "noise", "disturbance", "disturbance_if_cut"),
    *("held_rates", "within_period", "added_clipped"),
}
"""Properties of an affine law that rest on its loop, not on its references."""
LESS = 0.9  # foreseen share of the levels that channels make; more: levels of commands above those needed
TOGETHER = 5  # periods whose errors are merged in a tube at most; where a step has few, half of them
ORDER, CLIPPED = 30.0, 6.0
"""Generators per dimension of the set that channels add by a node of a step; of sets where commands may
be clipped, twice as many with errors."""


@dataclass(frozen=True, eq=False)
class AffineLaw:
    """``u = mu_U(t) + Lambda_U (xi_U(t) - x)``, clipped by the thrusters; fields as in `AffineController`.

    Its loop state is S's: the error and all other states of the flight computer. `level` (m,) bounds its
    commands, `step_error` (n,) the estimate errors beside the loop's own.
    """

    name: str
    system: Craft
    gain: Array
    reference: Reference
    own: Reference
    tracking: Tracking
    clips: bool = False
    level: Array | None = None
    step_error: Array | None = None
    _levels: dict[tuple[bytes, ...], "AffineLaw"] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "system", Craft.from_system(self.system))
        shape = (self.system.m, self.system.n)
        if np.shape(self.gain) != shape or not np.all(np.isfinite(self.gain)):
            raise ScenarioError(f"{self.name}.gain", np.shape(self.gain), f"must be finite, of shape {shape}")
        if self.own.delta != self.reference.delta:
            rule = f"must have steps of {self.reference.delta:g} s, as the safe reference has"
            raise ScenarioError(f"{self.name}.own", self.own.delta, rule)

    @property
    def feedback(self) -> Feedback:
        """Return the feedback of the safety controller."""
        return self.tracking.feedback

    @cached_property
    def closed(self) -> ClosedLoop:
        """Loop of the craft under the law, unsaturated, about the law's own reference."""
        loop = self.tracking.loop
        if self.step_error is not None and np.any(self.tracking.step_errors):
            loop = loop.with_channels(Channel("steps", self.step_error, noise=np.eye(self.system.n)))
        return loop.close(self.gain)

    @cached_property
    def flow(self) -> LinearFlow:
        """Error dynamics about the law's own reference, unsaturated, on exact states."""
        return self.feedback.flow(self.system, self.gain, self.reference.delta)

    @cached_property
    def error(self) -> Array:
        """Bounds on the errors of thrust, shape (m,), as long as commands are within `level`."""
        return self.system.input_error(self.gain, self.system.u_max if self.level is None else self.level)

    @cached_property
    def powers(self) -> Array:
        """Transitions of the loop state from the start of a cell to its nodes, shape (q+1, N, N)."""
        return powers(self.closed.F, self.feedback.nodes_per_cell)

    def sizes(self, channel: Channel, most: Array | None) -> Array:
        """Bounds on the values of a channel under commands within a bound, or within the limits."""
        return self.tracking.tightening.sizes(channel, self.system.u_max if most is None else most)

    def channels(self, before: Sequence[Array] | Array = ()) -> list[tuple[Channel, Array]]:
        """Return the loop's channels with bounds on their values in any period of a cell.

        Those that remember commands count bounds of the periods `before`, (m,) each and the last one last, or
        the limits of the thrusters where they remember older ones.
        """

        def most(lag: int) -> Array | None:
            return self.level if lag == 0 else np.max(before[-lag:], axis=0) if lag <= len(before) else None

        return [(c, self.sizes(c, most(c.lag))) for c in self.closed.loop.channels]

    @cached_property
    def noise(self) -> Array:
        """Bound on the part of a command due to estimate errors in a cell, shape (m,)."""
        return self.noise_after(())

    def noise_after(self, before: Sequence[Array] | Array) -> Array:
        """Return `noise` under bounds on commands of the periods before, shape (m,), see `channels`."""
        each = (self.closed.noise(channel) @ size for channel, size in self.channels(before))
        return np.asarray(sum(each, np.zeros(self.system.m)))

    @cached_property
    def disturbance(self) -> Zonotope:
        """Loop states that the channels cause by every node of a cell, from rest, if no command is cut.

        A channel that remembers commands counts those before the cell with the limits of the thrusters.
        """
        channels = [(c, self.sizes(c, self.level)) for c in self.closed.loop.channels]
        once = np.hstack([rates_added(self.closed.loop, channels), sampled_added(self.closed, channels)])
        return self._summed(once, self._early)

    @cached_property
    def disturbance_if_cut(self) -> Zonotope:
        """Return `disturbance` where errors of estimates may take commands of some inputs beyond limits."""
        return self._summed(self.added_clipped, lambda i: [])

    def _summed(self, once: Array, early: Callable[[int], list[Array]]) -> Zonotope:
        """Sum the additions of all periods, `once` (N, g) each, and `early` at every node of a cell.

        Additions to the error alone hardly turn from one period to the next, so some periods are merged.
        Additions to a whole loop state turn, and are not.
        """
        q, (N, n) = self.feedback.nodes_per_cell, (len(self.closed.F), self.system.n)
        sets, order = [Zonotope(np.zeros(N), np.zeros((N, 0)))], ORDER * n / N
        blocks, together = self.powers[:q] @ once, 1 if self.system.ideal else min(TOGETHER, max(q // 2, 1))
        for i in range(1, q + 1):
            if n < N:
                z = Zonotope(np.zeros(N), np.hstack([self.closed.F @ sets[-1].G, once]))
                sets.append(z if z.order_count <= 2 * order * N else z.reduce(order, "parallel"))
            else:
                z = Zonotope(np.zeros(N), np.hstack([merged(blocks[:i], together), *early(i)]))
                sets.append(z.reduce(order, "parallel"))
        return Zonotope.stack(sets)

    @cached_property
    def held_rates(self) -> Array:
        """Bound on the rate of the plant's states by values that hold for a period of a cell, shape (n,)."""
        return held_rates(self.closed, self.channels())

    @cached_property
    def within_period(self) -> Array:
        """Bound on the effect of measurable values on the plant within a period of a cell, shape (n,)."""
        return within_period(self.closed.loop, self.channels())

    @cached_property
    def added_clipped(self) -> Array:
        """Generators of the channels' addition in a period whose commands may be clipped, shape (N, g).

        Errors of estimates change a clipped command, input by input, by no more than an unclipped one.
        """
        channels, loop = self.channels(), self.closed.loop
        quiet = [(replace(c, noise=None), size) for c, size in channels]
        noise = loop.held * self.noise
        added = rates_added(loop, channels), sampled_added(self.closed, quiet), noise[:, self.noise > 0]
        return np.hstack(added)

    def _early(self, i: int) -> list[Array]:
        """Generators, at node i, of the effect of commands before the cell on channels with a lag."""
        generators = []
        for c in self.closed.loop.channels if self.level is not None else ():
            more = self.sizes(c, None) - self.sizes(c, self.level)
            for j in range(min(c.lag, i)) if np.any(more > 0) else ():
                generators.append(self.powers[i - 1 - j] @ self.closed.sampled(c) * more)
        return generators

    @cached_property
    def offset(self) -> Array:
        """``xi_U - xi`` at the nodes of every cell, shape (K, q+1, n)."""
        q, cells = self.feedback.nodes_per_cell, min(self.own.cells, self.reference.cells)
        return self.own.fine(q)[:cells] - self.reference.fine(q)[:cells]

    @cached_property
    def _loop_offsets(self) -> Array:
        return np.pad(self.offset, ((0, 0), (0, 0), (0, self.tracking.loop.N - self.system.n)))

    def loop_offset(self, k: int) -> Array:
        """Return `offset` as loop states at the nodes of one cell, shape (q+1, N)."""
        return np.asarray(self._loop_offsets[k])

    @cached_property
    def answers(self) -> tuple[Array, list[tuple[Channel, Array]]]:
        """Rows of the commands by node of a cell, (q+1, m, N), and their growth by each channel by then."""
        rows, growths = self.closed.K @ self.powers, []
        for channel in self.closed.loop.channels:
            growth = np.cumsum(self.closed.gains(channel, rows[:-1]), axis=0)
            growth = LESS * np.concatenate([0 * growth[:1], growth])
            growths.append((channel, growth + self.closed.noise(channel)))
        return rows, growths

    def foreseen(self, d: Zonotope, k: int) -> Array:
        """Foresee the least level of commands for a cell's tube, shape (m,).

        `d` are loop states about the law's own reference. The least level where a command may be clipped.
        """
        (rows, growths), u_max = self.answers, self.system.u_max
        size = np.abs(self.own.nu[k] - rows @ d.c) + np.abs(rows @ d.G).sum(axis=-1)
        level = LEVELS[0] * u_max
        while True:
            demand = size + sum(growth @ self.sizes(channel, level) for channel, growth in growths)
            if self.clips and np.any(demand > u_max):
                return np.asarray(LEVELS[0] * u_max)
            higher = raised(level, demand.max(axis=0), u_max)
            if np.all(higher <= level):
                return np.asarray(level)
            level = higher

    def command(self, k: int, xi: Array, own: Array, x: Array) -> Array:
        """Thrust command before clipping, shape (..., m)."""
        return np.asarray(self.own.nu[k] + (own - x) @ self.gain.T)


def raised(most: Array, commanded: Array, u_max: Array) -> Array:
    """Return the least levels of commands, no less than those given, that hold all commands, (m,)."""
    above = np.searchsorted(LEVELS, np.minimum(commanded / u_max, 1.0))
    return np.asarray(np.maximum(most, LEVELS[above] * u_max))


def clipped_step(law: AffineLaw, d: Zonotope, mu: Array) -> tuple[Zonotope, Array]:
    """Enclose the next loop state from states d about the law's own reference, whose input is mu (m,).

    Returned with the set are the slopes of the band, shape (m,): the set rests on them, and a certificate
    repeats.
    """
    phi, constant, push, slope = clipped_map(law, d, mu)
    out = Zonotope(phi @ d.c + constant, np.hstack([phi @ d.G, law.added_clipped, push]))
    return out.reduce(CLIPPED if law.system.ideal else 2 * CLIPPED), slope


def clipped_map(law: AffineLaw, d: Zonotope, mu: Array) -> tuple[Array, Array, Array, Array]:
    """Return the map of `clipped_step` without channels, ``phi d + constant + push b``, and the slopes."""
    loop, K = law.closed.loop, law.closed.K
    slope, offset, radius = clip_band(law, d, mu)
    constant = loop.held @ (slope * mu + offset - mu)
    phi = law.closed.open_transition - loop.held @ (slope[:, None] * K)
    push = loop.held * radius
    return phi, constant, push[:, radius > 0], slope


def clip_band(law: AffineLaw, d: Zonotope, mu: Array) -> tuple[Array, Array, Array]:
    """Return slopes, offsets and half-widths of the band of clipped commands from states d, (m,) each.

    The range is that of the command at the node, which is then held.
    """
    middle, width = mu - law.closed.K @ d.c, np.abs(law.closed.K @ d.G).sum(axis=1)
    return clip_relaxation(middle - width, middle + width, law.system.u_max)
