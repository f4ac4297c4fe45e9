"""Flights whose commands come early or late, held or as pulses, with impulse bits, by exact exponentials.

What flies is what thrusters do, not the input that stands for it. Measurements are of true states.
"""

import numpy as np
from scipy.linalg import expm

from polaris.model.errors import PolarisError
from polaris.scenario.scenario import load_scenario
from polaris.synthesis.schedule.synthesize import synthesize
from tests.polaris.closed_loops import Computer, Flown, Loop, _aims, by_chance, held
from tests.polaris.tiny import TINY


class OutOfTime(Loop):
    """A schedule flown with its jitter: at most so early that what a command rests on is known."""

    def __init__(self, schedule, parts=4):
        super().__init__(schedule, parts)
        self.h, self.errors = self.dt * self.parts, self.system.on_time
        self.ahead = 1 if self.system.timing.delay >= self.dt * (1 - 1e-9) else 0
        self.most = 0.0  # largest command of S, as a share of the limit

    def early(self, i):
        """Return True if what the command of a step rests on is known a step before."""
        return bool(self.ahead and i * self.dt >= self.system.timing.delay * (1 - 1e-9) > 0)

    def moved(self):
        """Nothing displaces what is measured but what flies."""
        return np.zeros(self.system.n)

    def gained(self, t):
        """Return ``int_0^t e^{A s} B ds`` for times (...), shape (..., n, m)."""
        (n, m), t = self.system.B.shape, np.maximum(t, 0.0)
        block = np.zeros((n + m, n + m))
        block[:n, :n], block[:n, n:] = self.system.A, self.system.B
        times, back = np.unique(np.round(t, 12), return_inverse=True)
        return expm(times[:, None, None] * block)[:, :n, n:][back.reshape(np.shape(t))]

    @property
    def ways(self):
        """Return what a unit of each thruster makes of every input, (N, m): one an input, or a layout's."""
        layout = self.system.nozzles
        return np.eye(self.system.m) if layout is None else layout.allocation.directions

    @property
    def pulses(self):
        """Return the thrust of the pulses of every thruster, (N,); infinite where inputs are held."""
        timing, layout = self.system.timing, self.system.nozzles
        if not timing.pulse_thrust:
            return np.full(len(self.ways), np.inf)
        return np.array(timing.pulse_thrust) if layout is None else layout.allocation.limits

    def begin(self, on):
        """Return when pulses that last for some times (R, N) begin after the start of their period [s]."""
        placed = self.system.timing.pulse_place
        if placed == "start":
            return 0 * on
        return np.cumsum(on, axis=1) - on if placed == "staggered" else (self.h - on) / 2

    def allocated(self, thrust):
        """Return the thrusts of a layout's fixed mixes for commands (R, m), shape (R, N)."""
        mixes = self.system.nozzles.allocation.mixes[0]
        sides = [np.maximum(sign * thrust, 0.0) @ mix for sign, mix in zip((1, -1), mixes, strict=True)]
        return sides[0] + sides[1]

    def made(self, thrust, remainder, error):
        """Return the impulses that thrusters make of commands (R, m), over h, and what they leave."""
        timing, layout, limits = self.system.timing, self.system.nozzles, self.system.u_max
        along = self.errors.along
        bit, carried, fine = self.bit, timing.carried_impulse, timing.fine
        if layout is not None:
            thrust, limits = self.allocated(thrust), layout.allocation.limits
            carried, bit = layout.bit * layout.carried, layout.bit / self.h * (not layout.carried)
            error, along = np.clip(error @ self.ways.T * 1e3, -1, 1), layout.along
        if carried:
            impulse = thrust * self.h + remainder
            full = limits * self.h
            size = np.floor(np.abs(impulse) / carried * (1 + 1e-12)) * carried
            size = np.minimum(np.where(size > 0, np.abs(impulse), 0.0) if fine else size, full)
            u = size * np.sign(impulse) / self.h
            return u, impulse - u * self.h, error * along * u
        u = np.round(thrust / bit) * bit if bit else thrust
        u = np.where(np.abs(thrust) >= bit, thrust, u) if fine else u
        u = np.clip(u, -limits, limits)
        return u, remainder, error * along * u

    @property
    def bit(self):
        """Multiple to which inputs are rounded [N]; 0 where none is dropped."""
        return 0.0 if self.system.timing.carried_impulse else self.errors.rounding(self.system.m)

    def fly(self, attack, rule):
        """Fly runs; what is made lasts from one instant to another, per input, whatever the step."""
        system, (R, n), m = self.system, attack.x0.shape, self.system.m
        states, clipped = np.zeros((self.N + 1, R, n)), np.zeros((self.N, R, m), dtype=bool)
        modes, wrong = np.zeros((self.N, R), dtype=np.int8), np.zeros((self.N, R, n))
        states[0] = x = attack.x0
        Ad, Dd = held(system.A, system.B, self.dt)[0], held(system.A, system.D, self.dt)[1]
        eta, error = (np.broadcast_to(each, (self.N, R, k)) for each, k in ((attack.eta, n), (attack.off, m)))
        sees = Computer(self, states, eta, attack.w) if self.remembers else None
        ways, count = self.ways, len(self.ways)
        rest, thrust, last = np.zeros((R, count)), np.zeros((R, m)), np.zeros((R, count))
        until = np.full((R, count), -np.inf)  # end of the last pulses
        bursts = []  # of forces (R, N), and when they begin and end (R, N)
        top, jitter = self.pulses, system.timing.jitter

        def command(i):
            nonlocal rest, thrust, last, until, bursts
            k, j = divmod(i, self.per)
            flying = rule(i, states[i])
            if sees is not None:
                sees.look(i)
                wrong[i] = sees.wrong
            else:
                wrong[i] = eta[i]
            raw = np.empty((R, m))
            for number in np.unique(flying).tolist():
                mask, free = flying == number, number and number not in self.laws
                measured = states[i, mask] + wrong[i, mask]
                raw[mask] = attack.free[i, mask] if free else self.command(number, k, j, measured)
            share = np.abs(raw[flying == 0]) / system.u_max
            self.most = max(self.most, float(share.max(initial=0.0)))
            clipped[i : i + self.parts] = np.abs(raw) > system.u_max
            modes[i : i + self.parts] = flying
            thrust = np.clip(raw, -system.u_max, system.u_max)
            u, rest, u_error = self.made(thrust, rest, error[i])
            effect = ((last - u - u_error) * (attack.way[i] @ system.B @ ways.T)).sum(axis=1, keepdims=True)
            late = jitter * np.sign(effect) if i else np.zeros((R, 1))
            late = late if self.early(i) else np.maximum(late, 0.0)
            begins, ends = i * self.dt + late, np.full((R, count), (i + 2 * self.parts) * self.dt)
            if np.all(np.isfinite(top)):
                on = np.abs(u) / top * self.h
                begins = np.maximum(i * self.dt + self.begin(on) + late, until)
                until = begins + on
                begins = begins + system.timing.edge * (effect > 0)  # all that comes up or goes down is late
                ends = begins + on
                gain = np.divide(u + u_error, u, out=np.ones_like(u), where=u != 0)
                bursts.append((np.sign(u) * top * gain, begins, ends))
            else:
                begins = np.broadcast_to(begins, (R, count))
                bursts = [(f, a, np.minimum(b, begins)) for f, a, b in bursts]
                bursts.append((u + u_error, begins, ends))
            last, bursts = u + u_error, bursts[-3:]

        for i in range(self.N):
            if sees is not None:
                sees.told[i] = thrust
            if i % self.parts == 0 and not self.early(i):
                command(i)
                if sees is not None:
                    sees.told[i] = thrust
            start, end = i * self.dt, (i + 1) * self.dt
            if i + 1 < self.N and (i + 1) % self.parts == 0 and self.early(i + 1):
                command(i + 1)
            x = x @ Ad.T + attack.w[i] @ Dd.T
            for force, begins, ends in bursts:
                since_on, since_off = (end - np.clip(each, start, end) for each in (begins, ends))
                acting = np.any(since_on > since_off)
                if acting:
                    added = self.gained(since_on) - self.gained(since_off)  # (R, N, n, m)
                    x = x + np.einsum("rj,rjnm,jm->rn", force, added, ways)
            states[i + 1] = x
        return Flown(states, clipped, modes, wrong)


def clear_of(loop, flight):
    """Return the least margin of runs to the unsafe sets, and the largest command of S as a share."""
    least = np.inf
    for k in range(loop.cells):
        p = flight.states[k * loop.per : (k + 1) * loop.per + 1] @ loop.system.position.T
        s = np.linspace(0, 1, loop.per + 1)[:, None, None]
        for unsafe in loop.unsafe:
            cell = min(k, unsafe.cells - 1)
            b = unsafe.offsets[cell, 0] * (1 - s) + unsafe.offsets[cell, 1] * s
            least = min(least, float((p @ unsafe.normals.T - b).max(axis=2).min()))
    return least, loop.most


def attacked(schedule, runs, seed, rounds=2):
    """Return the least margin and the largest command of S in flights at their worst and at random."""
    loop, rng = OutOfTime(schedule), np.random.default_rng(seed)
    over, _, rows, targets = _aims(loop, runs, rng)
    rule, least = loop.scheduled(over), np.inf
    modes, clipped = np.array([rule(i, rows) for i in range(loop.N)]), None
    for number in range(rounds + 1):
        worst_case = loop.worst(rows, targets, modes, clipped)
        if number == rounds:
            worst_case = by_chance(loop, worst_case, rng)
        flight = loop.fly(worst_case, rule)
        clipped = flight.clipped
        least = min(least, clear_of(loop, flight)[0])
    return least, loop.most


def mixed(seed):
    """Return a small random scene with jitter, and pulses, bits, delays, observers or none."""
    rng = np.random.default_rng(seed)
    period = float(rng.choice([0.25, 1 / 3, 0.5]))
    turn, weight = rng.choice([0.0, 0.1, 0.3]), rng.choice([20, 60, 150])
    changes = [
        f"system.A=[[0, 0, 1, 0], [0, 0, 0, 1], [0, 0, 0, {turn}], [0, 0, {-turn}, 0]]",
        f"feedback.period_s={period}",
        f"tracking.R=[{weight},{weight}]",
        f"system.disturbance_max={rng.choice([0.0, 0.002, 0.01])}",
        f"timing.jitter_s={period * rng.choice([0.005, 0.02, 0.06])}",
        "recoverable.recourse=none",
    ]
    if rng.random() < 0.6:
        edges = rng.choice([0.0, 0.01, 0.05], 2) * period
        changes += ["thrusters.pulse=centred", f"thrusters.rise_s={edges[0]}", f"thrusters.fall_s={edges[1]}"]
    if rng.random() < 0.5:
        changes += ["thrusters.impulse_bit_N_s=0.004"]
        changes += ["thrusters.remainder=carried"] * int(rng.random() < 0.6)
    changes += ["thrusters.magnitude_error=0.02"] * int(rng.random() < 0.5)
    changes += [f"timing.delay_s={period * rng.choice([0.5, 1.0, 2.0])}"] * int(rng.random() < 0.6)
    errors = [0.002, 0.002, 0.0004, 0.0004]
    if (kind := rng.random()) < 0.35:
        changes += [f"navigation.measurement.matrix={np.eye(4).tolist()}"]
        changes += [f"navigation.measurement.error={errors}"]
    elif kind < 0.6:
        changes += [f"navigation.state_error={errors}"]
    if any("impulse_bit" in each for each in changes):
        changes += ["thrusters.resolution=continuous"] * int(rng.random() < 0.5)
    if "thrusters.pulse=centred" in changes:
        changes += [f"thrusters.pulse={rng.choice(['centred', 'start', 'staggered'])}"]
        changes += canted(rng) if rng.random() < 0.4 else []
    return load_scenario(TINY).with_assignments(changes), changes[4:]


def canted(rng):
    """Draw six to sixteen thrusters in the plane, weak or strong, of which a layout of pulses is made."""
    count = int(rng.integers(6, 17))
    at = 2 * np.pi * (np.arange(count) + rng.uniform(-0.2, 0.2, count)) / count
    ways = np.stack([np.cos(at), np.sin(at)], axis=1)[rng.permutation(count)]
    limits = rng.uniform(4, 8, count)
    return [f"thrusters.directions={ways.tolist()}", f"thrusters.thrust_max_N={limits.tolist()}"]


def judge_scene(seed, runs=12):
    """Return what a scene declares and its outcome: None where it is refused or nothing is proven."""
    try:
        scenario, changes = mixed(seed)
        schedule = synthesize(scenario)
    except PolarisError as error:
        return str(error)[:60], None
    return changes, (schedule, *attacked(schedule, runs, seed))
