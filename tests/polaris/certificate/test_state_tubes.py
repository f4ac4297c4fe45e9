"""Tubes of both programs against a flight computer of its own, flown with every uncertain input by hand.

The computer keeps states, commands and estimates as they are, and no loop state: that is put together
afterwards from what was flown, and must lie in the tubes at every node of every step.
"""

from dataclasses import dataclass, replace
from math import ceil

import numpy as np
import pytest
from flint import arb_mat

from polaris.certificate.claims.flights import ControllerModel, enclose_step
from polaris.certificate.files.entries import Law
from polaris.certificate.kernel.arcs import Path
from polaris.certificate.kernel.balls import column, matrix
from polaris.certificate.kernel.zonotopes import Merging, Zonotope
from polaris.certificate.model.craft.states import craft_of
from polaris.certificate.model.plants import plant_of
from polaris.planning.reference import Reference
from polaris.synthesis.controllers.controllers import AffineController, AnyThrust, propagate_states
from polaris.synthesis.tracker.feedback import Feedback
from reach.sets.zonotope import Zonotope as Box
from tests.polaris.synthesis.schedule.test_hand_over import PARTS, H, hold, stated, tracking

Q, K, RUNS = 5, 3, 60  # periods in a step, steps, flights
INITIAL = np.array([[0.05, 0.0, 0.01, 0.0], [0.01, 0.04, 0.0, 0.02]]).T  # generators


@dataclass(frozen=True, eq=False)
class Scene:
    """One law on one craft, with the tubes of its steps."""

    s: object
    gain: np.ndarray
    clips: bool

    @property
    def system(self):
        return self.s.system

    def held(self, t):
        """Transition over a time, and what disturbance and input, each held over it, add."""
        system = self.system
        Ad, G = hold(system.A, np.hstack([system.D, system.B]), t)
        return Ad, G[:, : system.p], G[:, system.p :]

    @property
    def own(self):
        """States at the start of each step, and inputs, of the law's reference; of the safe one, too."""
        rng = np.random.default_rng(5)
        inputs = 0.3 * rng.uniform(-1, 1, (2, K, self.system.m)) * self.system.u_max
        if self.clips:
            inputs[1] = 0.97 * np.sign(inputs[1]) * self.system.u_max
        start, references = np.array([1.0, -0.5, 0.02, 0.03]), []
        for nu in inputs:
            states = [start]
            for u in nu:
                Ad, _, G = self.held(H * Q)
                states.append(Ad @ states[-1] + G @ u)
            references.append((np.array(states), nu))
        offset = np.array([0.02, 0.03, 0.0, 0.01])
        return references[0], (references[1][0] + offset, references[1][1])

    @property
    def document(self):
        document = stated(self.s)
        slopes = np.random.default_rng(2).uniform(0.3, 1, (K, Q, self.system.m)).tolist()
        document.q, document.delta, document.fits, document.steps = Q, H * Q, [None] * K, K
        document.slopes = [None if k != 1 or not self.clips else slopes[k] for k in range(K)]
        return document

    @property
    def craft(self):
        document = self.document
        return craft_of(document, plant_of(document), matrix(self.s.gain.tolist()))

    def tubes(self):
        """Loop states at the nodes of all steps, one after another."""
        (safe, nu), (states, inputs) = self.own
        kind = "saturated_affine" if self.clips else "affine"
        law = Law("own", kind, self.gain.tolist(), states[:-1].tolist(), inputs.tolist())
        model = ControllerModel.for_law(law, self.craft, self.document)
        path = Path.propagate(
            model.plant, column(safe[0].tolist()), nu.tolist(), K, column(safe[-1].tolist())
        )
        reached, sets = model.craft.start(Zonotope(arb_mat(4, 1), matrix(INITIAL.tolist()))), []
        for k in range(K):
            tube = enclose_step(model, reached, k, path, None, Merging(1000, 4))
            sets += [reached, *tube.nodes]
            reached = tube.end
        return [*sets, reached]

    @property
    def law(self):
        """The law as the synthesis has it."""
        paths = (Reference(self.system, H * Q, *path) for path in self.own)
        s = replace(self.s, feedback=Feedback(Q), delta=H * Q)
        return AffineController("own", self.system, self.gain, *paths, s, self.clips)

    def synthesised(self):
        """Loop states at the nodes of all steps, as the controllers of the synthesis make them."""
        law = self.law
        reached, sets = self.s.loop_state(Box(np.zeros(4), INITIAL), self.s.at_start), []
        for k in range(K):
            tube = law.propagate(reached, k)
            sets += [tube.states[i] for i in range(Q)]
            reached = tube.end
        return [*sets, reached]

    def sizes(self):
        """Bounds on disturbances, noise, impulses that are left, and the first error of the estimate."""
        system, craft = self.system, self.craft
        observer = system.observer
        noise = np.array(system.timing.measured_error) if observer is None else np.array(observer.noise)
        first = np.zeros(4) if observer is None else np.array([float(x) for x in craft.box[-4:]])
        return system.w_max, noise, system.timing.carried_impulse, first

    def fly(self, x0, w, noise, rest, err, first):
        """Fly runs from errors x0; returns loop states at all nodes, and the commands of all periods.

        w (N, PARTS, R, p), noise (N, R, k), rest (N + 1, R, m), err (N, PARTS, R, m) in [-1, 1].
        """
        system, h = self.system, H / PARTS
        lag, (Ad, Gw, Gu) = round(system.timing.delay / H * PARTS), self.held(h)
        (safe, nu), (states, inputs) = self.own
        age, N = ceil(lag / PARTS), Q * K
        x = safe[0] + x0
        back = np.linalg.inv(Ad)
        past = [x]
        for _ in range(age * PARTS):  # free motion before the start, which the computer knows exactly
            past.append(past[-1] @ back.T)
        track, estimate, z = past[::-1], None, []
        sent, added = [0 * x0[:, :2]] * age, [np.zeros((PARTS, *x0.shape))] * age
        xi, at = safe[0], safe[0]
        whole = self.held(H)
        for i in range(N + 1):
            k, j = divmod(i, Q)
            now = (age + i) * PARTS
            late = track[now - lag]
            commands = [u for u in sent for _ in range(PARTS)]  # command of every part of a period so far
            if system.observer is None:
                guess = late + (noise[i] if i < N else 0)
            elif estimate is None:
                guess = estimate = late + first
            else:
                for part in range(now - lag - PARTS, now - lag):
                    estimate = estimate @ Ad.T + commands[part] @ Gu.T
                innovation = (
                    late @ system.observer.measures.T + (noise[i - 1]) - estimate @ system.observer.measures.T
                )
                guess = estimate = estimate + innovation @ system.observer.gain.T
            z.append(self._state(x - xi, added, rest[i], guess - late, lag))
            if i == N:
                return z, np.array(sent[age:])
            for part in range(now - lag, now):
                guess = guess @ Ad.T + commands[part] @ Gu.T
            if j == 0:
                xi, at = safe[k], states[k]
            u = inputs[k] - (guess - at) @ self.gain.T
            u = np.clip(u, -system.u_max, system.u_max) if self.clips else u
            v = u + (rest[i] - rest[i + 1]) / H
            sent = [*sent, u]
            more = np.empty((PARTS, *x.shape))
            wrong = system.thrusters.error(u)
            for part in range(PARTS):
                push = w[i, part] @ Gw.T + (v - u + err[i, part] * wrong) @ Gu.T
                more[part] = push @ np.linalg.matrix_power(Ad, PARTS - 1 - part).T
                x = x @ Ad.T + u @ Gu.T + push
                track.append(x)
            added = [*added, more]
            xi = xi @ whole[0].T + nu[k] @ whole[2].T
            at = at @ whole[0].T + inputs[k] @ whole[2].T

    def _state(self, e, added, rest, misjudged, lag):
        """Loop state: error, additions under way, impulses that are left, error of the estimate."""
        age, parts, whole = ceil(lag / PARTS), [e], self.held(H)[0]
        first = (PARTS - lag) % PARTS  # parts of a period that are measured before its end
        lines = [(first, PARTS, age)] + ([(0, first, age - 1)] if first else [])
        for begin, end, ages in lines:
            for back in range(ages):
                line = added[-1 - back][begin:end].sum(axis=0)
                parts.append(line @ np.linalg.matrix_power(whole, back).T)
        if self.system.timing.carried_impulse:
            parts.append(rest)
        if self.system.observer is not None:
            parts.append(misjudged)
        return np.hstack([np.broadcast_to(part, (len(e), part.shape[-1])) for part in parts])

    def by_chance(self, rng):
        """Values of all uncertain inputs, mostly at their bounds and kept for some periods."""
        N, (m, p) = Q * K, (self.system.m, self.system.p)
        w_max, noise, carried, first = self.sizes()

        def drawn(*shape):
            repeats = int(rng.integers(1, 4))
            signs = rng.choice([-1.0, 1.0], (-(-shape[0] // repeats), *shape[1:]))
            return np.repeat(signs, repeats, axis=0)[: shape[0]] * rng.choice([1.0, 0.7])

        w = drawn(N, PARTS, RUNS, p)
        w *= w_max / np.linalg.norm(w, axis=-1, keepdims=True)
        x0 = rng.choice([-1.0, 1.0], (RUNS, 2)) @ INITIAL.T
        return (
            x0,
            w,
            drawn(N, RUNS, len(noise)) * noise,
            drawn(N + 1, RUNS, m) * carried,
            drawn(N, PARTS, RUNS, m),
            drawn(RUNS, 4) * first,
        )


def scene(clips, w_max=0.03, **case):
    s = tracking(**case)
    s = replace(s, system=replace(s.system, w_max=w_max))
    return Scene(s, s.gain * (1.6 if clips else 0.7), clips)


CASES = [
    {},
    {"delay": 1.25},
    {"delay": 2.0, "carried": 0.02},
    {"observer": True},
    {"observer": True, "delay": 1.75, "carried": 0.02},
    {"delay": 1.5, "proportional": True},
    {"observer": True, "delay": 0.5, "proportional": True},
]


NUMBERS = pytest.mark.parametrize(
    "number", range(len(CASES)), ids=lambda i: "-".join(map(str, CASES[i])) or "estimate"
)


@NUMBERS
@pytest.mark.parametrize("clips", [False, True])
def test_every_state_that_is_flown_lies_in_the_tubes(clips, number):
    case = scene(clips, **CASES[number])
    tubes, others = case.tubes(), case.synthesised()
    rng, shares, clipped = np.random.default_rng(number), [], False
    size = np.array([float(x) for x in tubes[Q].size().entries()])
    N = len(size)
    rows = np.vstack([np.eye(N), -np.eye(N), rng.normal(size=(60, N)) / np.maximum(size, 1e-9)])
    bounds = [np.array([float(x) for x in z.support(matrix(rows.tolist()))]) for z in tubes]
    more = [z.support(rows) for z in others]
    for _ in range(12):
        states, commands = case.fly(*case.by_chance(rng))
        clipped |= bool(np.any(np.abs(commands) >= case.system.u_max))
        for i, (z, bound, other) in enumerate(zip(states, bounds, more, strict=True)):
            assert np.all(z @ rows.T <= np.minimum(bound, other) + 1e-9), i
            shares.append(((z @ rows.T) / np.maximum(np.abs(bound), 1e-9)).max())
    assert max(shares) > 0.6
    assert clipped == clips
    for z, other in zip(tubes, others, strict=True) if not clips and number < 5 else ():
        # both programs find the same sets of a linear law, but for generators that are merged
        widths = np.array([float(x) for x in z.widths])[:4]
        assert np.all(other.half_widths[:4] >= 0.99 * widths)
        allowed = (1.1 if other.dim > 4 else 1.4) * widths + 2 * case.s.state_offset
        assert np.all(other.half_widths[:4] <= allowed)


def test_noise_that_takes_one_input_beyond_its_limit_is_cut_there_alone():
    """The errors of a command are then those of an estimate no more, input by input."""
    case = scene(True, **CASES[0])
    law = case.law
    noise, input_map = law.noise, law.closed.loop.held
    cut = np.diag([1.0, 0.0])  # of the first input alone
    channel = next(c for c in law.closed.loop.channels if c.noise is not None)
    effect = -input_map @ cut @ case.gain @ channel.noise * channel.size  # what an estimate's error adds then
    rows = np.random.default_rng(0).normal(size=(200, 4))
    linear = np.abs(rows @ law.closed.sampled(channel) * channel.size).sum(axis=1)
    boxed = np.abs(rows @ (input_map * noise)).sum(axis=1)
    assert np.any(np.abs(rows @ effect).sum(axis=1) > linear)
    assert np.all(np.abs(rows @ effect).sum(axis=1) <= boxed * (1 + 1e-12))
    once, free = law.disturbance_if_cut[1].support(rows), law.disturbance[1].support(rows)
    assert np.all(once >= boxed) and np.any(once > free * 1.01)


@NUMBERS
def test_flights_lie_in_the_tubes_of_any_thrust_and_of_a_law_after_it(number):
    """Any commands within the limits, first as errors with the rest beside them, then in the loop again."""
    case, rng = scene(True, **CASES[number]), np.random.default_rng(number)
    law, bounds, reach = case.law, [], []
    s, path = law.tracking, law.reference
    safe = AffineController("safety", s.system, s.gain, path, path, s)
    z = s.loop_state(Box(np.zeros(4), INITIAL), s.at_start)
    N = z.dim
    rows = np.vstack([np.eye(N), -np.eye(N), rng.normal(size=(60, N)) / np.maximum(z.half_widths, 1e-3)])
    anything = AnyThrust("any", s.system, path, s)
    for k, flying in enumerate([anything, law, anything]):
        tube = propagate_states(flying, z, k, safe)
        bounds += [tube.states[i].support(rows) for i in range(Q)]
        z = tube.end
    bounds.append(z.support(rows))
    for _ in range(12):
        states, _ = case.fly(*case.by_chance(rng))
        for i, (state, bound) in enumerate(zip(states, bounds, strict=True)):
            assert np.all(state @ rows.T <= bound + 1e-9), i
            reach.append(((state @ rows.T) / np.maximum(np.abs(bound), 1e-9)).max())
    assert max(reach) > 0.4
