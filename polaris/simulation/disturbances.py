"""Disturbances of simulated runs: random ones, and the worst case of a facet in closed form."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from reach.numerics.linear import discretize

from ..model.system import Array
from ..synthesis.controllers.black_box import BlackBox
from ..synthesis.controllers.controllers import AffineController
from ..synthesis.controllers.neural import NeuralController
from ..synthesis.schedule.schedule import Schedule
from .integration import Integrator
from .run_metrics import Runs

Disturbance = Literal["none", "random", "worst", "mixed", "failing"]


def disturbances(
    flight: Integrator, n: int, rng: np.random.Generator, kind: Disturbance
) -> tuple[Array, Array]:
    """Disturbances constant over each integration step, shape (steps, n, p), norm at most w_max.

    Errors of estimates and thrusters, and what is constant in a flight, have columns of their own, if any.
    Also the direction, at time 0, in which the initial error of each worst-case run counts, (worst, n).
    """
    system, steps = flight.system, flight.steps
    p, places = system.p, flight.columns
    w = np.zeros((steps, n, flight.constant.stop))
    adjoint = np.zeros((0, system.n))
    columns = places[-1].stop - places[-1].start
    if kind == "none" or (system.unbiased.w_max == 0 and system.ideal and not columns):
        return w, adjoint
    worst = n if kind == "worst" else (n // 2 if kind in ("mixed", "failing") else 0)
    if worst:
        w[:, :worst], adjoint = _worst_case(flight, worst, rng)
    count = n - worst
    if count:
        longest = flight.steps_per_cell * 4
        w[:, worst:, :p] = _piecewise(steps, count, p, longest, rng) * system.w_max
        for part, size in zip(places[1:], (flight.estimate_bounds, 1.0, 1.0), strict=True):
            if part.start < part.stop:
                drawn = _piecewise(steps, count, part.stop - part.start, longest, rng)
                far = np.max(np.abs(drawn), axis=2, keepdims=True)
                w[:, worst:, part] = drawn / np.maximum(far, 1e-300) * size
        if np.any(system.bias):
            w[:, worst:, flight.constant] = _constants(count, p, rng) * system.bias
        if flight.thrusters.constant:
            w[:, worst:, _shares(flight)] = _constants(count, system.m**2, rng)
    return w, adjoint


def _shares(flight: Integrator) -> slice:
    """Return the columns of constant shares of commands, which `Thrusters.matrices` reads."""
    errors = flight.columns[2]
    return slice(errors.start + flight.system.m, errors.stop)


def _constants(count: int, size: int, rng: np.random.Generator) -> Array:
    """Draw constants of flights, (count, size), half of them at a corner of the box about zero."""
    drawn = rng.uniform(-1, 1, (count, size))
    return np.asarray(np.where(rng.random((count, 1)) < 0.5, np.sign(drawn), drawn))


def _piecewise(steps: int, n: int, p: int, longest: int, rng: np.random.Generator) -> Array:
    """Random directions, each held for a number of steps that the run keeps; shape (steps, n, p).

    Half of the pieces have norm 1, the others less. Drawn run by run, worked out for all at once.
    """
    holds = rng.integers(1, max(2, longest), n)
    pieces = -(-steps // holds)
    drawn = [(rng.normal(size=(k, p)), rng.random((k, 1)), rng.random((k, 1))) for k in pieces]
    raw, chance, smaller = (np.concatenate(parts) for parts in zip(*drawn, strict=True))
    raw /= np.maximum(np.linalg.norm(raw, axis=1, keepdims=True), 1e-300)
    raw *= np.where(chance < 0.5, 1.0, smaller)
    first = np.concatenate([[0], np.cumsum(pieces)[:-1]])
    return np.asarray(raw[first + np.arange(steps)[:, None] // holds])


def limit_rows(schedule: Schedule) -> Array:
    """Directions of states in which the limits lie: every facet, then every input up and down."""
    safety = schedule.safety
    facets = [-u.rows(safety.tracking.system) for u in safety.clearance.unsafe]
    return np.vstack([*facets, safety.tracking.gain, -safety.tracking.gain])


def _worst_case(flight: Integrator, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Worst case of one facet (or input) and instant per run, both drawn at random."""
    rows = limit_rows(flight.schedule)
    targets = rng.integers(1, flight.steps + 1, n)
    w, _, adjoint = adjoint_worst_case(flight, rows[rng.integers(0, len(rows), n)], targets)
    return w, adjoint


def adjoint_worst_case(
    flight: Integrator,
    rows: Array,
    targets: NDArray[np.int_],
    about: Runs | None = None,
    spends: Array | None = None,
) -> tuple[Array, Array | None, Array]:
    """Disturbance, held over each step, that takes the state furthest along a row at one instant per run.

    ``w(s) = w_max G' lambda(s) / norm``, with lambda the adjoint of the closed loop and G what a disturbance
    held over a step adds; a constant has the sign of the sum of ``G' lambda``, a constant share of a
    command u that of the sum of ``G' lambda u'``. For a linear loop no other held disturbance goes further;
    about a loop whose thrusters clip it is the worst case to first order.
    Errors of estimates, if there are any, follow the disturbance in columns of their own, each at its bound,
    with the sign of ``G' lambda(s)``, or those of an observer's noise (`worst_errors`);
    so does what networks are told of bodies. Where a loop is not linear it is the worst case about flights
    `about`, by default the undisturbed one from the middle of the initial set, which clips nothing: a network
    answers with its gradient at their states, errors of thrusters grow and shrink with their inputs, and
    those that the thrusters clip do not answer to the state.

    Rows (R, n) are directions in the space of states, targets (R,) instants as numbers of steps. What is
    applied counts in every step with weights `spends` (steps, R, m), if there are any. Returned are the
    disturbances (steps, R, p), full thrust in the worst direction (steps, R, m) for controllers that may do
    anything (None if none flies), and the direction (R, n), at time 0, in which the initial state counts.
    """
    system, steps = flight.system, flight.steps
    numbers = np.repeat(flight.modes, flight.steps_per_cell)
    choices = {number: _loops(flight, number) for number in np.unique(numbers).tolist()}
    adjoint, (forces, eta, errors, bodies) = np.zeros((len(rows), system.n)), flight.columns
    w, total = np.zeros((steps, len(rows), flight.constant.stop)), np.zeros((len(rows), system.p))
    products = np.zeros((len(rows), system.m, system.m))
    free = np.zeros((steps, len(rows), system.m)) if flight.may_do_anything else None
    bits, filtering = 2 ** np.arange(system.m), np.zeros_like(adjoint)
    clipped, grows = None, flight.thrusters.proportional
    if about is not None:
        full = np.abs(about.inputs) >= system.u_max * (1 - 1e-12)
        clipped = np.repeat(full.swapaxes(0, 1), flight.substeps, axis=0)
    for step in range(steps - 1, -1, -1):
        starting = targets == step + 1
        adjoint[starting] = rows[starting]
        number = int(numbers[step])
        back, push, thrust, gain = choices[number]
        if clipped is None or not clipped[step].any():
            direction, kick, carried = adjoint @ push[0], adjoint @ thrust[0], adjoint @ back[0]
        else:
            case = clipped[step] @ bits
            column = adjoint[:, None, :]
            direction, kick, carried = ((column @ part[case])[:, 0] for part in (push, thrust, back))
        curvatures = isinstance(flight.schedule.controllers[number], (NeuralController, BlackBox))
        about = _undisturbed(flight) if about is None and (curvatures or grows) else about
        effect = kick if spends is None else kick + spends[step]  # how much what is applied counts
        demand = effect  # and what is commanded
        if about is not None and flight.thrusters.constant:
            products += effect[:, :, None] * about.inputs[:, step // flight.substeps, None, :]
        elif about is not None and grows:
            demand = effect + flight.thrusters.slope(about.inputs[:, step // flight.substeps], np.abs(effect))
        if demand is not kick:
            answer = (kick - demand if clipped is None else (kick - demand) * ~clipped[step]) @ gain
            carried, direction[:, forces.stop :] = carried + answer, direction[:, forces.stop :] + answer
        if about is not None and curvatures:
            x = about.states[:, step // flight.substeps]
            answer, body_gain = _answered(flight, number, step, x, demand)
            w[step, :, bodies.start : bodies.start + body_gain.shape[1]] = np.sign(body_gain)
            carried = carried + answer
            direction[:, forces.stop :] += answer
        if eta.start < eta.stop:
            w[step, :, eta], filtering = worst_errors(flight, step, direction, filtering)
        along = direction[:, forces]
        total += along
        size = np.sqrt(np.einsum("ij,ij->i", along, along))[:, None]
        w[step, :, forces] = along * (system.w_max / np.maximum(size, 1e-300))
        if errors.start < errors.stop:
            w[step, :, errors.start : errors.start + system.m] = np.sign(effect)
        if free is not None:
            free[step] = np.sign(effect) * system.u_max
        adjoint = carried
    if np.any(system.bias):
        w[..., flight.constant] = np.sign(total) * system.bias
    if flight.thrusters.constant:
        ways = np.where(np.eye(system.m) > 0, np.sign(products), products)
        w[..., _shares(flight)] = ways.reshape(len(rows), -1)
    return w, free, adjoint


def worst_errors(flight: Integrator, step: int, direction: Array, later: Array) -> tuple[Array, Array]:
    """Worst errors of estimates in a step along `direction` (R, p + n), in which disturbances and they count.

    Of an observer its noise, as `Predicting` reads it: `later` (R, n) is how much its error counts at the end
    of the step, returned with how much it does before, and counted in `direction`.
    """
    observer, bounds, (Ad, _, Dd), p = (
        flight.system.observer,
        flight.estimate_bounds[step],
        flight.discrete,
        flight.system.p,
    )
    weights = direction[:, p:]
    if observer is None:
        return np.sign(weights) * bounds, later
    direction[:, :p] -= later @ Dd
    before = later @ Ad + weights
    if step % flight.substeps:
        return 0 * before, before
    way = np.sign(before @ observer.gain) @ np.linalg.pinv(observer.measures).T if step else before
    size = np.maximum(np.abs(way).max(axis=1, keepdims=True), 1e-300)
    return way / size * bounds.min(), before @ observer.rest


def _answered(flight: Integrator, number: int, step: int, x: Array, kick: Array) -> tuple[Array, Array]:
    """Return the addition to the adjoint (R, n) by a network that held its command at states x (R or 1, n).

    And the weight of its input from bodies, (R, 2d per body), per half-width of that input. A black box is
    taken for the affine function that it was fitted with, where it was.
    """
    law, (k, place) = flight.schedule.controllers[number], divmod(step, flight.steps_per_cell)
    if isinstance(law, BlackBox):
        fit = getattr(flight.schedule.steps[k].tube, "fit", None)
        return np.asarray(0 * x if fit is None else kick @ fit[place // flight.substeps, :, :-2]), x[:, :0]
    assert isinstance(law, NeuralController)
    reference = flight.paths.get(number, flight.safe)[k, place - place % flight.substeps]
    passed = place // flight.substeps * law.tracking.flow.h
    free = np.abs(law.command(k, reference, reference, x, passed)) < flight.system.u_max
    back = law.pullback(k, reference, np.broadcast_to(x, (len(kick), x.shape[1])), kick * free, passed)
    return back @ law.loop.C, back @ law.sight * law.obstacle_motion[1][k, law.node(passed)]


def _undisturbed(flight: Integrator) -> Runs:
    """Return the flight from the middle of the initial set, one run."""
    centre = flight.schedule.safety.problem.initial_set.c[None]
    # What is predicted, or filtered, is exact then.
    plain = Integrator(flight.schedule, flight.modes, flight.substeps)
    return plain.run(centre, np.zeros((plain.steps, 1, plain.constant.stop)))


def _loops(flight: Integrator, number: int) -> tuple[Array, Array, Array, Array]:
    """Return a controller's transitions over a step per set of clipped inputs, effects of held inputs; gain.

    For disturbance with errors of estimates and thrust, shapes (2^m, n, n), (2^m, n, p + n), (2^m, n, m).
    """
    system, dt = flight.system, flight.dt
    law = flight.schedule.controllers[number]
    gain = law.gain if isinstance(law, AffineController) else np.zeros((system.m, system.n))
    back, push, thrust = [], [], []
    for case in range(2**system.m):
        free = np.array([not case >> axis & 1 for axis in range(system.m)], dtype=float)
        held = flight.substeps == 1
        loop = system.A if held else system.A - system.B @ (free[:, None] * gain)
        carried, forced = discretize(loop, system.D, dt)
        kicked = discretize(loop, system.B, dt)[1]
        back.append(carried - kicked @ (free[:, None] * gain) if held else carried)
        push.append(np.hstack([forced, -kicked @ (free[:, None] * gain)]))
        thrust.append(kicked)
    return np.array(back), np.array(push), np.array(thrust), gain
