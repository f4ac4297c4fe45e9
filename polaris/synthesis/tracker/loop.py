"""State of a sampled tracking loop and the channels through which uncertainty enters it.

The loop state ``z`` holds the tracking error ``e = x - xi`` in its first n entries, then all else that the
flight computer remembers: additions that no measurement has shown yet, the observer's error, carried
impulses.
From node to node, under a command ``u`` that is held for a period h,

    z+ = free z + held u + sum over channels of their additions in the period.

A law with gain Lambda commands ``u = -Lambda (sensed z + noise)`` beside the input of its reference.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from reach.numerics.linear import discretize, growth

from .channel import Channel, norms, row_integral

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Loop:
    """Loop of a plant ``x' = A x + B u + ...`` under a law that is renewed every h.

    Attributes
    ----------
    A, B : ndarray, shapes (n, n), (n, m)
    h : float
        Control period [s].
    free : ndarray, shape (N, N)
        Transition without commands.
    held : ndarray, shape (N, m)
        Map from a command, held for a period, to the next loop state.
    applied : ndarray, shape (m, N)
        Map from the loop state to the thrust beside the command. The flight computer does not know
        of it.
    sensed : ndarray, shape (n, N)
        The error that the law sees.
    enter : tuple of (float, float, ndarray)
        Parts of a period (start and end [s]) and how additions to the plant in them, carried to the end
        of the period, enter the loop state, shape (N, n). The parts cover the period.
    carry : ndarray, shape (n, n)
        Carries an error of the last measurement to the instant at which the command takes effect.
    shown : ndarray, shape (n, N)
        Additions to the plant, out of the loop state, that the next measurement shows for the first time,
        carried to the instant of that measurement.
    shown_now : tuple of ndarray, shape (n, n) each
        The same for additions in the parts of the period itself.
    channels : tuple of Channel
    offset, offset_at_nodes, navigated : ndarray, shape (n,)
        Largest distance of the true state from the modelled one: ever, at nodes, counted by navigation.
    settled : ndarray, shape (n,), optional
        Bounds on the last n states, errors of an observer, after any law.
    """

    A: Array
    B: Array
    h: float
    free: Array
    held: Array
    applied: Array
    sensed: Array
    enter: tuple[tuple[float, float, Array], ...]
    carry: Array
    shown: Array
    shown_now: tuple[Array, ...]
    channels: tuple[Channel, ...]
    offset: Array
    offset_at_nodes: Array
    navigated: Array | None = None
    settled: Array | None = None

    @classmethod
    def from_plant(cls, A: Array, B: Array, h: float) -> "Loop":
        """Build the loop of a law that sees the exact state at once, without any channel."""
        (n, m), unit = B.shape, np.eye(len(A))
        free, held = discretize(A, B, h)
        return cls(
            A=A,
            B=B,
            h=h,
            free=free,
            held=held,
            applied=np.zeros((m, n)),
            sensed=unit,
            enter=((0.0, h, unit),),
            carry=unit,
            shown=0 * unit,
            shown_now=(unit,),
            channels=(),
            offset=np.zeros(n),
            offset_at_nodes=np.zeros(n),
        )

    @property
    def n(self) -> int:
        """Number of states of the plant."""
        return len(self.A)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return int(self.B.shape[1])

    @property
    def N(self) -> int:
        """Number of states of the loop."""
        return len(self.free)

    @cached_property
    def error_map(self) -> Array:
        """Map into the next loop state of inputs that the flight computer does not know of, shape (N, m)."""
        each = (
            E @ expm(self.A * (self.h - b)) @ discretize(self.A, self.B, b - a)[1] for a, b, E in self.enter
        )
        return np.asarray(sum(each, np.zeros((self.N, self.m))))

    @cached_property
    def part_maps(self) -> tuple[tuple[Array, Array, Array], ...]:
        """Return for each part of the period how its additions enter (N, n), means of rates, and the rest.

        A rate of mean v over the part, at most s, adds ``mean v`` up to ``deviation s``, (n, n).
        """
        maps = []
        for a, b, E in self.enter:
            mean, last = discretize(self.A, np.eye(self.n), b - a)[1], expm(self.A * (self.h - b))
            maps.append((E @ last, mean, (b - a) ** 2 / 3 * np.abs(self.A) @ growth(self.A, b - a)))
        return tuple(maps)

    @cached_property
    def uneven(self) -> Array:
        """Bound on the effect of errors of inputs about their means, per unit of their rms, shape (N, m).

        The plant is moved by at most ``(h^2/2) |A| E |B|``; the addition in a period's first part enters in
        another way than the rest.
        """
        size, (*first, last) = growth(self.A, self.h) @ np.abs(self.B), [E for _, _, E in self.enter]
        bound = self.h**2 / 2 * np.abs(last) @ np.abs(self.A) @ size
        return np.asarray(sum((self.h * np.abs(E - last) @ size for E in first), bound))

    @property
    def offset_measured(self) -> Array:
        """Offset at the instants of measurements, shape (n,)."""
        return self.offset_at_nodes if len(self.enter) == 1 else self.offset

    def with_channels(self, *channels: Channel) -> "Loop":
        """Return the loop with further channels."""
        return replace(self, channels=(*self.channels, *channels))

    def with_states(self, F_q: Array, *, sensed: Array | None = None, applied: Array | None = None) -> "Loop":
        """Return the loop with further states q.

        Parameters
        ----------
        F_q : ndarray, shape (s, N + s)
            Transition of q from the loop state and q.
        sensed : ndarray, shape (n, s), optional
            Map from q to the error that the law sees.
        applied : ndarray, shape (m, s), optional
            Map from q to the thrust.
        """
        s = len(F_q)
        free = np.vstack([np.pad(self.free, ((0, 0), (0, s))), F_q])
        extra = np.zeros((self.m, s)) if applied is None else applied
        perceived = np.zeros((self.n, s)) if sensed is None else sensed

        def padded(rows: Array) -> Array:
            return np.vstack([rows, np.zeros((s, rows.shape[1]))])

        return replace(
            self,
            free=free,
            held=padded(self.held),
            applied=np.hstack([self.applied, extra]),
            sensed=np.hstack([self.sensed, perceived]),
            shown=np.hstack([self.shown, 0 * perceived]),
            enter=tuple((a, b, padded(E)) for a, b, E in self.enter),
            channels=tuple(
                c if c.sample is None else replace(c, sample=padded(c.sample)) for c in self.channels
            ),
        )

    def entering(self, rows: slice, change: Callable[[float, float], Array]) -> "Loop":
        """Return the loop with other rows of the maps of additions, by start and end of a part."""
        enter = []
        for a, b, E in self.enter:
            E = E.copy()
            E[rows] = change(a, b)
            enter.append((a, b, E))
        return replace(self, enter=tuple(enter))

    def split(self, instant: float) -> "Loop":
        """Return the loop with a part of the period ending at an instant [s], within the period."""
        enter: list[tuple[float, float, Array]] = []
        shown_now: list[Array] = []
        for (a, b, E), shown in zip(self.enter, self.shown_now, strict=True):
            cuts = [a, instant, b] if a < instant < b else [a, b]
            enter += [(p, q, E) for p, q in pairwise(cuts)]
            shown_now += [shown] * (len(cuts) - 1)
        return replace(self, enter=tuple(enter), shown_now=tuple(shown_now))

    def close(self, gain: Array) -> "ClosedLoop":
        """Close the loop by a law with a gain, shape (m, n); without navigation it sees the true state."""
        offset = self.offset_measured
        if self.navigated is None and np.any(offset):
            return ClosedLoop(self.with_channels(Channel("state offset", offset, noise=self.carry)), gain)
        if self.navigated is not None and np.any(offset > self.navigated):
            raise ValueError("navigation must be added after the sources that displace the state")
        return ClosedLoop(self, gain)


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """Loop under ``u = -gain (sensed z + noise)``: ``z+ = F z + ...``, command rows K, ``u = -K z - ...``."""

    loop: Loop
    gain: Array

    @cached_property
    def K(self) -> Array:
        """Rows of the commands, shape (m, N); a command is ``-K z`` less the noise."""
        return np.asarray(self.gain @ self.loop.sensed)

    @cached_property
    def open_transition(self) -> Array:
        """Transition without commands but with the thrust beside them, shape (N, N)."""
        return np.asarray(self.loop.free + self.loop.error_map @ self.loop.applied)

    @cached_property
    def F(self) -> Array:
        """Transition from node to node, shape (N, N)."""
        return np.asarray(self.open_transition - self.loop.held @ self.K)

    @cached_property
    def rates(self) -> Array:
        """Rows of the plant's rate at a node, ``A e + B (thrust)``, shape (n, N)."""
        plant = np.zeros((self.loop.n, self.loop.N))
        plant[:, : self.loop.n] = self.loop.A
        return np.asarray(plant + self.loop.B @ (self.loop.applied - self.K))

    def input_map(self, channel: Channel) -> Array | None:
        """Return the map from a channel's value to the input of its period, shape (m, k)."""
        if channel.noise is None:
            return channel.push
        answer = -self.gain @ channel.noise
        return np.asarray(answer if channel.push is None else answer + channel.push)

    def sampled(self, channel: Channel) -> Array:
        """Return the map from a channel's value, without its rate, to the next loop state, shape (N, k)."""
        effect = np.zeros((self.loop.N, len(channel.size))) if channel.sample is None else channel.sample
        if channel.noise is not None:
            effect = effect - self.loop.held @ self.gain @ channel.noise
        if channel.push is not None:
            effect = effect + self.loop.error_map @ channel.push
        return np.asarray(effect)

    def gains(self, channel: Channel, rows: Array) -> Array:
        """Return the largest growth of rows in a period per unit of a channel's sizes.

        Parameters
        ----------
        rows : ndarray, shape (..., N)

        Returns
        -------
        ndarray, shape (..., k), or (..., 1) for a ball
            ``gains @ sizes`` is the support of the channel's effect along each row.
        """
        total: Array | float = 0.0
        if channel.sample is not None or channel.noise is not None or channel.push is not None:
            total = norms(rows @ self.sampled(channel), channel.ball)
        if channel.rate is not None:
            for a, b, E in self.loop.enter:
                total = total + row_integral(
                    rows @ E, self.loop.A, channel.rate, self.loop.h, (a, b), channel.ball
                )
        return np.asarray(total)

    def held_map(self, channel: Channel) -> Array:
        """Return the map from a channel's value, constant in a period, to the next loop state, (N, k)."""
        effect = self.sampled(channel)
        if channel.rate is not None:
            effect = effect + sum(carried @ mean for carried, mean, _ in self.loop.part_maps) @ channel.rate
        return np.asarray(effect)

    def noise(self, channel: Channel) -> Array:
        """Size of a command's change per unit of a channel's value in its period, shape (m, k)."""
        if channel.noise is None:
            return np.zeros((self.loop.m, len(channel.size)))
        return norms(self.gain @ channel.noise, channel.ball)
