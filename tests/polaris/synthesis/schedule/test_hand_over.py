"""Needs of S after a hand-over, against a flight computer of its own: every unit of error is flown.

Another law flies before node `BEFORE`, S after it, and neither is told what disturbs. The loop is linear in
the errors, so the worst case is the sum of what a unit of each of them does, times the largest size that it
may have in its period: of commands within the thrusters' limits before the hand-over, within the profile
after it.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from flint import arb
from scipy.linalg import expm, solve_continuous_are

from polaris import Craft, Feedback, Tracking
from polaris.certificate.kernel.balls import column, magnitude, matrix, sums
from polaris.certificate.model.craft.feedforward import Feedforward as CheckedSchedule
from polaris.certificate.model.craft.settling import Settling
from polaris.certificate.model.craft.states import craft_of
from polaris.certificate.model.craft.tightening import Tightening
from polaris.certificate.model.plants import plant_of
from polaris.certificate.model.timing import carry_offset
from polaris.model.estimates.observer import design
from polaris.model.estimates.prediction import predicting
from polaris.model.thrusters import Thrusters
from polaris.model.timing import Timing
from polaris.synthesis.safety import feedforward
from polaris.synthesis.safety.carried_rows import CarriedRows
from polaris.synthesis.safety.feedforward import Feedforward
from reach import Zonotope, powers

BEFORE, AFTER = 9, 14  # periods before the hand-over, and after it
PARTS = 4  # of a period, in each of which errors are constant
H = 0.5  # control period [s]


def hold(A, B, t):
    """Return ``e^{A t}`` and ``int_0^t e^{A s} ds B``."""
    n, m = B.shape
    E = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * t)
    return E[:n, :n], E[:n, n:]


def tracking(delay=0.0, observer=False, proportional=False, carried=0.0, missed=0, jitter=0.0, fired=()):
    """S in the plane, in a frame that turns; `delay` is in periods."""
    eye = np.eye(2)
    A = np.block([[0 * eye, eye], [0.02 * eye, np.array([[0, 0.1], [-0.1, -0.1]])]])
    B = np.vstack([0 * eye, eye])
    P = solve_continuous_are(A, B, np.diag([1.0, 1, 2, 2]), 2 * eye)
    errors = Thrusters(0.1, 0.05, 0.004) if proportional else Thrusters()
    estimate_error = None if observer else np.array([0.01, 0.02, 0.004, 0.003])
    system = Craft(A, B, 0.7 * B, [1.0, 1.2], 0.03, estimate_error=estimate_error, thrusters=errors)
    if observer:
        system = replace(system, observer=design(system, np.eye(2, 4), np.array([0.01, 0.02]), H))
    timing = Timing(
        delay=delay * H, missed=missed, jitter=jitter, carried_impulse=carried, pulse_thrust=fired
    )
    system = predicting(system, timing, H)
    return Tracking(system, P[2:] / 2, Feedback(1), H, 0.5 if proportional or jitter else None)


class Flight:
    """Unit errors in one period each, flown side by side; the last axes are errors and states."""

    def __init__(self, s, k, nodes):
        self.s, self.k, self.nodes = s, k, nodes
        system = s.system
        self.A, self.B, self.D, timing = system.A, system.B, system.D, system.timing
        self.lag = 0 if timing.missed else round(timing.delay / H * PARTS)  # estimates are in a box, then
        self.part = hold(self.A, np.hstack([self.D, self.B, self.A @ self.B]), H / PARTS)
        self.seen = len(system.observer.noise) if system.observer else system.n
        self.count = PARTS * self.part[1].shape[1] + self.seen + system.m

    def fly(self):
        """States at all parts of periods from the hand-over on, and S's commands."""
        s, (n, m), p = self.s, self.B.shape, self.D.shape[1]
        Ad, Gd = self.part
        x, states, estimate, last, commands = np.zeros((self.count, n)), [], None, 0, []
        pushes, first = PARTS * (p + 2 * m), self.k * PARTS
        for i in range(self.nodes):
            now, c = i * PARTS, np.zeros((2, self.count, m))
            for late in (0, 1):  # the impulse left at node k, the last of all errors
                c[late, -m:] = np.eye(m) * (i + late == self.k)
            noise = np.zeros((self.count, self.seen))
            noise[pushes : pushes + self.seen] = np.eye(self.seen) * (i == self.k)
            states += [x] * (i == 0)
            predicted, measured_at, observer = x, max(now - self.lag, 0), s.system.observer
            if observer is None:
                predicted = states[measured_at] + noise
            else:
                estimate = 0 * x if estimate is None else estimate
                for j in range(last, measured_at):
                    estimate = estimate @ Ad.T + commands[j // PARTS] @ Gd[:, p : p + m].T
                y = states[measured_at] @ observer.measures.T + noise
                estimate = estimate + (y - estimate @ observer.measures.T) @ observer.gain.T
                predicted, last = estimate, measured_at
            for j in range(measured_at, now):
                predicted = predicted @ Ad.T + commands[j // PARTS] @ Gd[:, p : p + m].T
            u = -predicted @ s.gain.T if i >= BEFORE else np.zeros((self.count, m))
            commands.append(u)
            v = u + (c[0] - c[1]) / H
            for j in range(now, now + PARTS):
                x = x @ Ad.T + v @ Gd[:, p : p + m].T
                if 0 <= (place := j - first) < PARTS:
                    x = x.copy()
                    x[place * (p + 2 * m) : (place + 1) * (p + 2 * m)] += Gd.T
                states.append(x)
        return np.array(states)[BEFORE * PARTS :], np.array(commands)[BEFORE:]


def worst(s):
    """Largest ``e - M(t) e_0`` at all parts of periods after a hand-over, of commands alike."""
    system, p, m, n = s.system, s.system.p, s.system.m, s.system.n
    limits = np.minimum(s._since(s.feedback_bound), system.u_max)
    shift = hold(system.A, system.B, H)[1] / H  # sets of other laws leave carried impulses out
    states, commands = np.zeros((AFTER * PARTS + 1, n)), np.zeros((AFTER, m))
    for k in range(BEFORE + AFTER):
        flight = Flight(s, k, BEFORE + AFTER)
        x, u = flight.fly()
        e = x[0].copy()
        e[-m:] += shift.T * (k == BEFORE)
        nominal, maps = np.empty_like(x), hold(system.A, system.B, H)
        for i in range(AFTER + 1):
            for j in range(PARTS if i < AFTER else 1):
                free, forced = hold(system.A, system.B, j * H / PARTS)
                nominal[i * PARTS + j] = e @ (free - forced @ s.gain).T
            if i < AFTER:
                u[i] += e @ s.gain.T
            e = e @ (maps[0] - maps[1] @ s.gain).T
        before = system.u_max if k < BEFORE else limits[k - BEFORE]
        thrust = system.thrusters.error(before)
        if system.observer is not None:
            noise = system.observer.noise + np.abs(system.observer.measures) @ (
                system.state_offset - system.carry_offset
            )
        elif system.timing.missed:
            lag = k - BEFORE - system.timing.by_lag[0][0]
            noise = system.estimate_bound(system.u_max if lag < 0 else limits[lag])
        else:
            noise = np.array(system.timing.measured_error) + system.state_offset - system.carry_offset
        for responses, total in ((x - nominal, states), (u, commands)):
            pushes = responses[:, : PARTS * (p + 2 * m)].reshape(len(responses), PARTS, p + 2 * m, -1)
            total += system.w_max * np.linalg.norm(pushes[:, :, :p], axis=2).sum(axis=1)
            errors = np.concatenate([thrust, system.shifted])
            total += np.einsum("tjmi,m->ti", np.abs(pushes[:, :, p:]), errors)
            sampled = np.concatenate([noise, np.full(m, system.timing.carried_impulse)])
            total += np.einsum("tri,r->ti", np.abs(responses[:, PARTS * (p + 2 * m) :]), sampled)
    return states, commands


def stated(s):
    """Return what a certificate would state of the system, as the checker reads it."""
    system, timing, m = s.system, s.system.timing, s.system.m
    observer, estimate, on_time = system.observer, system.navigation.tolist(), timing.on_time
    claims = {name: getattr(system, name).tolist() for name in ("A", "B", "D", "u_max")}
    claims |= {"C": system.position.tolist(), "w_max": system.w_max, "bias": [], "delta": H, "q": 1}
    claims |= {
        "system_kind": "linear",
        "transients": [],
        "observer": None,
        "feedback_bound": [],
        "allocation": None,
    }
    claims |= {"estimate": estimate, "calmest": estimate, "measured_error": list(timing.measured_error)}
    claims |= {"shares": [on_time.along, on_time.across, 0.0], "same_shares": on_time.constant}
    claims |= {"bits": [system.thrusters.bit] * m, "prompt_bits": [on_time.bit] * m, "error_by_step": []}
    claims |= {
        "pulse_thrust": list(timing.pulse_thrust),
        "pulse_place": timing.pulse_place,
        "carried_impulse": timing.carried_impulse,
    }
    claims |= {"timing": {"delay": timing.delay, "missed": timing.missed, "jitter": timing.jitter}}
    claims |= {
        "late": timing.jitter > 0 and not timing.pulse_thrust,
        "intersample_offset": list(timing.intersample_offset) or [0.0] * system.n,
    }
    claims |= {"at_nodes": system.state_offset_at_nodes.tolist()}
    if observer is not None:
        claims["observer"] = {key: getattr(observer, key).tolist() for key in ("gain", "measures", "noise")}
    if s.feedback_bound is not None:
        claims["feedback_bound"] = s.feedback_bound.tolist()
    return SimpleNamespace(**claims)


def checker_tightenings(s, rows):
    """Build what the checker needs along rows of the error, of commands without rows."""
    document = stated(s)
    craft = craft_of(document, plant_of(document), matrix(s.gain.tolist()))
    feedback_bound = [[arb(x) for x in level] for level in document.feedback_bound]
    settling = Settling.for_craft(craft, column([arb(1)] * s.system.n), 1, feedback_bound)
    return Tightening(craft, settling, craft.commands if rows is None else matrix(rows.tolist()))


def checked(s, rows):
    """Return what the checker needs at nodes and between them, (., r) each, and the noise of commands."""
    tightenings = checker_tightenings(s, rows)
    noise = tightenings.craft.noise(tightenings.craft.lag_error(tightenings.craft.plant.u_max))
    box = column([*carry_offset(tightenings.craft.plant), *tightenings.craft.box])
    nodes = [(magnitude(rows) * box).entries() for rows in tightenings.carried[: AFTER + 1]]
    set_terms = [nodes, [tightenings.boxed(box, lag) for lag in range(AFTER + 1)]]
    parts = zip((tightenings.at_nodes, tightenings.disturbed), set_terms, strict=True)
    total = [[sums(*pair) for pair in zip(a[: AFTER + 1], b, strict=True)] for a, b in parts]
    each = (np.array([[float(x) for x in tightening] for tightening in some]) for some in total)
    return *each, np.array([float(x) for x in noise])


def handed(s, rows):
    """Return what the exact error and all else that may be remembered need along rows at nodes, (., r)."""
    z = s.loop_state(Zonotope.point(np.zeros(s.system.n)))
    return np.abs(s.pad(rows) @ s.loop_transitions @ z.G).sum(axis=-1)


def needed(s, rows, ages):
    """Return the same with all that disturbs, between nodes too."""
    return CarriedRows(s, rows).from_set(Zonotope.point(np.zeros(s.system.n)), ages)


CASES = [
    {},
    {"delay": 1.0},
    {"delay": 1.5, "proportional": True},
    {"delay": 2.75},
    {"observer": True, "proportional": True},
    {"observer": True, "delay": 0.5},
    {"observer": True, "delay": 2.0, "proportional": True},
    {"carried": 0.02},
    {"carried": 0.02, "delay": 1.25},
    {"carried": 0.02, "proportional": True},
    {"carried": 0.02, "delay": 1.0, "observer": True},
    {"jitter": 0.01, "delay": 1.0},
    {"jitter": 0.01, "observer": True, "delay": 0.5},
    {"missed": 1, "delay": 0.5, "proportional": True},
    {"fired": (1.5, 1.2), "delay": 1.5},
    {"fired": (1.5, 1.2), "delay": 1.5, "jitter": 0.05},
    {"carried": 0.02, "delay": 1.25, "jitter": 0.05},
    {"fired": (1.5, 1.2), "delay": 0.5, "observer": True},
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(case) or "estimate")
def test_no_flight_needs_more_after_a_hand_over_than_both_sides_say(case):
    s = tracking(**case)
    states, commands = worst(s)
    rows, ages = np.eye(s.system.n), np.arange(AFTER + 1)
    K = s.commands[: s.system.m]
    by_tracking = s.responses(rows, s.feedback_bound)[ages] + handed(s, rows)[ages], needed(s, rows, ages)
    by_checker = checked(s, rows)
    demand = (s.responses(K, s.feedback_bound)[:-1] + handed(s, K))[:AFTER] + s.noise
    command_bounds = demand, checked(s, None)[0][:AFTER] + by_checker[2]
    within = np.linspace(0, 1, PARTS, endpoint=False)[:, None]
    for nodes, disturbance in (by_tracking, by_checker[:2]):
        share = states[::PARTS] / np.maximum(nodes, 1e-12)
        assert share.max() <= 1 + 1e-6 and share[-2].min() > 0.85
        chords = [(1 - within) * a + within * b for a, b in zip(disturbance, disturbance[1:], strict=False)]
        assert np.all(states[:-1] <= np.concatenate(chords) * (1 + 1e-6))
    for tightening in command_bounds:
        share = commands / tightening
        assert share.max() <= 1 + 1e-6 and share[-1].min() > 0.9


@pytest.mark.parametrize("case", [case for case in CASES if "proportional" not in case], ids=str)
def test_what_is_older_than_the_horizon_counts(case):
    """Sums over four horizons are within what holds for ever, which one horizon alone does not reach."""
    s = tracking(**case)
    limits, closed = s.tightening, s.tightening.closed
    rows = s.pad(np.eye(s.system.n))
    carried = rows @ powers(closed.F, 4 * limits.horizon)
    total = sum(closed.gains(each, carried).sum(axis=0) @ each.size for each in closed.loop.channels)
    ever = limits.from_rest(rows)
    assert np.all(total <= ever[-1] * (1 + 1e-12)) and np.all(total > ever[limits.horizon])
    n = s.system.n
    assert np.all(np.abs(carried)[limits.horizon + 2 :, :, n:] <= s.per_state(rows)[-1])
    tightenings = checker_tightenings(s, np.eye(s.system.n))
    last, N, more = tightenings.carried[-1], tightenings.settling.periods, np.zeros(s.system.n)
    for _ in range(N):
        last = last * tightenings.craft.F
        more += [float(x.upper()) for x in tightenings.craft.supports(last)]
    beyond = [
        float((a - b).upper())
        for a, b in zip(tightenings.settled_tightening, tightenings.responses[-1], strict=True)
    ]
    assert np.all(more <= beyond)


def along(s, nu, planned, by_step=(), between=True):
    """Return needs along states at nodes, and commands that they are bounded for, on both sides."""
    cells, rows, document = len(nu), np.eye(s.system.n), stated(s)
    effect = Feedforward(s, SimpleNamespace(nu=nu, cells=cells), planned)
    tightenings, commanded = effect.response(rows, between), [effect.commanded]
    document.error_by_step, document.steps = [list(each) for each in by_step], len(by_step) - 1
    document.errors_in = lambda k: document.estimate
    if len(by_step):
        document.calmest = np.min(by_step, axis=0).tolist()
        document.errors_in = lambda k: document.error_by_step[min(k, document.steps)]
    craft = craft_of(document, plant_of(document), matrix(s.gain.tolist()))
    feedback_bound = [[arb(x) for x in level] for level in document.feedback_bound]
    settling = Settling.for_craft(craft, column([arb(1)] * s.system.n), 1, feedback_bound)
    arcs = [SimpleNamespace(u=column([arb(x) for x in u])) for u in nu.tolist()]
    path = SimpleNamespace(planned=planned, arcs=arcs)
    checks = CheckedSchedule(document, craft, settling, path)
    commanded.append(np.array([[float(x) for x in level] for level in checks.commanded]))
    checked_along = checks.response(Tightening(craft, settling, matrix(rows.tolist())), between)
    other = [[[float(x) for x in node] for node in cell] for cell in checked_along]
    nodes = [np.vstack([each[:, 0], each[-1:, 1]]) for each in (tightenings, np.array(other))]
    return list(zip(nodes, commanded, strict=True))


def units(s, periods):
    """States by age after a unit of thrust in all parts of a period, and of noise, (periods + 1, ., n)."""
    x, _ = Flight(s, BEFORE, BEFORE + periods).fly()
    p, m = s.system.p, s.system.m
    pushes = np.abs(x[::PARTS, : PARTS * (p + 2 * m)]).reshape(periods + 1, PARTS, p + 2 * m, -1)
    pushes, noise = pushes[:, :, p : p + m], np.abs(x[::PARTS, PARTS * (p + 2 * m) : -m])
    return pushes.sum(axis=1), noise


def test_scheduled_commands_count_until_they_are_measured():
    s, cells = tracking(delay=0.5, missed=2, proportional=True), 14
    nu = np.zeros((cells, 2))
    nu[2] = [0.5, -0.6]
    system = s.system
    ((hidden, unseen),) = system.timing.by_lag
    assert hidden == 3
    thrust, noise = units(s, cells)
    for tightenings, commanded in along(s, nu, cells):
        assert np.all(commanded >= np.abs(nu)) and np.all(commanded[3:] < commanded[2])
        part, late = system.thrusters.part(commanded), np.zeros((cells, 4))
        for k in range(1, cells):
            late[k] = np.array(unseen) @ part[max(k - 3, 0) : k].max(axis=0)
        exact = [sum(part[k] @ thrust[L - k] + late[k] @ noise[L - k] for k in range(L)) for L in (5, 6, 7)]
        assert np.all(tightenings[5:8] >= np.array(exact) * (1 - 1e-6))
        assert np.all(tightenings[5:8] <= np.array(exact) * 2)


def test_estimates_of_steps_count_from_their_step_on_and_in_the_tail_for_ever():
    base = np.array([0.01, 0.02, 0.004, 0.003])
    by_step = np.outer([3.0, 1, 2, 1, 1, 4], base)
    s = tracking()
    s = replace(s, system=replace(s.system, error_by_step=by_step))
    cells, planned = 9, 5
    more = np.vstack([by_step[:5], np.tile(by_step[5], (4, 1))]) - base
    noise = units(s, 60)[1]
    for tightenings, _ in along(s, np.zeros((cells, 2)), planned, by_step):
        for L in range(1, cells + 1):
            exact = sum(more[k] @ noise[L - k] for k in range(L))
            if planned <= L:  # as if the tail had always been flown
                exact = np.maximum(exact, np.einsum("tri,r->i", noise[1:], more[-1]))
            assert np.all(tightenings[L] >= exact * (1 - 1e-6)), L
            assert np.all(tightenings[L] <= exact * 1.2 + 1e-2), L


@pytest.mark.parametrize("rounds", [2, 300])
def test_errors_that_feed_on_themselves_are_bounded_or_exhaust_the_thrusters(rounds, monkeypatch):
    monkeypatch.setattr(feedforward, "ROUNDS", rounds)
    s, nu = tracking(proportional=True), np.full((30, 2), 0.2)
    for across in (0.05, 0.25, 0.75):
        system = replace(s.system, thrusters=replace(s.system.thrusters, across=across))
        effect = feedforward.Feedforward(replace(s, system=system), SimpleNamespace(nu=nu, cells=30), 30)
        caused = effect.response(effect.tracking.commands[:2], between=False).max(axis=1)
        bounded = np.all(effect.commanded >= nu + caused) and np.all(effect.commanded <= system.u_max)
        assert bounded or np.any(effect.commanded > system.u_max), across
        assert bounded == (rounds > 2 and across < 0.5), across


def test_later_turns_of_the_tail_are_bounded_by_the_first():
    s, planned, tail = tracking(proportional=True), 4, 40
    nu = np.zeros((planned + tail, 2))
    nu[planned:], nu[planned] = [0.2, -0.3], [0.5, -0.6]
    thrust, _ = units(s, planned + 4 * tail)
    for tightenings, commanded in along(s, nu, planned, between=False):
        assert np.all(commanded[planned + tail // 2 :] == commanded[-1]) and commanded[-1].max() > 0
        part = s.system.thrusters.part(np.vstack([commanded[:planned], *[commanded[planned:]] * 4]))
        exact = np.array([sum(part[k] @ thrust[L - k] for k in range(L)) for L in range(1, len(part) + 1)])
        turns = exact[planned:].reshape(4, tail, -1).max(axis=0)
        assert np.all(tightenings[planned + 1 :] >= turns * (1 - 1e-6))


def test_what_is_older_than_the_horizon_or_bends_is_booked_at_every_node_of_a_schedule(monkeypatch):
    by_step = np.outer([3.0, 1, 4], [0.01, 0.02, 0.004, 0.003])
    s, caused = tracking(), Tightening.response
    s = replace(s, system=replace(s.system, error_by_step=by_step))

    def more(*arguments):
        older, intersample = caused(*arguments)
        return [x + 1e-3 for x in older], [x + 2e-3 for x in intersample]

    monkeypatch.setattr(Tightening, "response", more)
    assert np.all(along(s, np.zeros((3, 2)), 2, by_step)[1][0] >= 3e-3)


def test_what_is_remembered_from_before_a_hand_over_is_as_large_as_the_thrusters_allow():
    limits = tracking(missed=1, delay=0.5, proportional=True).tightening
    bound = np.linspace(0.6, 0.2, limits.horizon + 2)[:, None] * limits.u_max
    (late,) = (channel for channel in limits.closed.loop.channels if channel.lag)
    sizes = limits.sizes(late, limits.remembered_bound(late, bound))
    assert np.all(sizes[0] > limits.sizes(late, bound[0]))
    assert np.all(limits.largest(late, bound) >= sizes)


def test_what_holds_ever_after_is_the_largest_of_all_later_nodes():
    s = tracking(delay=1.0)
    falling = np.linspace(2.0, 1.0, s.tightening.horizon + 3)[:, None]
    tightenings = s._by_age(falling)
    assert tightenings[-1, 0] == falling[s.settling + 2, 0] and np.all(
        tightenings[: s.settling + 2] == falling[: s.settling + 2]
    )
