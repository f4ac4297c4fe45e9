"""Random scenarios of switching schedules, as the text of scenario files; the same seed gives the same text.

They cover every kind of plant, set, goal, controller and rule, and are skewed towards scenes that are proved
and in which U flies a part of the time. Scenes are made in units near 1 and then stated in other units of
length, time and thrust: what happens in them is the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polaris.scenario.reading import write_toml

Table = dict[str, Any]
Random = np.random.Generator


@dataclass(frozen=True)
class Plant:
    """Controlled craft, in units near 1."""

    name: str
    A: np.ndarray
    B: np.ndarray
    D: np.ndarray
    C: np.ndarray | None  # None if the position is the first d states
    still: np.ndarray  # state at rest per position, (n, d)
    d: int  # coordinates of the position
    order: int  # derivatives of the position among the states: 1, 2 or 3
    rests: bool  # True if every position, at rest, keeps itself
    weights: np.ndarray  # diagonal of S's state weight, (n,)
    limit: np.ndarray  # (m,)

    def at(self, position: np.ndarray) -> np.ndarray:
        """The state at rest at a position."""
        return self.still @ position


def random_scenario(seed: int) -> str:
    """Text of a random scenario file."""
    rng = np.random.default_rng(seed)
    make = _spacecraft if rng.random() < 0.25 else _plane
    return write_toml(make(rng, f"random-{seed}"))


def _plane(rng: Random, name: str) -> Table:
    """A scene of a general linear plant."""
    plant = _plant(rng)
    d, n, m = plant.d, len(plant.A), plant.B.shape[1]
    rests = plant.rests and rng.random() < 0.6
    start = rng.uniform(5, 9) * _direction(rng, d)
    aim = rng.uniform(-0.4, 0.4, d) if plant.rests else np.zeros(d)
    path = aim - start
    slow = 1.4 if plant.order == 3 else 1.0
    step = float(rng.choice([0.4, 0.5, 0.625, 0.8])) * slow
    steps = int(np.ceil(rng.uniform(11, 16) * slow / step))
    sampled = bool(rng.random() < 0.5)
    document = _head(name)
    system = {"kind": "linear", "A": plant.A, "B": plant.B, "D": plant.D}
    system["input_max"] = plant.limit if m > 1 or rng.random() < 0.5 else float(plant.limit[0])
    system["disturbance_max"] = float(rng.choice([0.0, 0.005, 0.01, 0.02, 0.04]))
    document["system"] = system
    if plant.C is not None:
        document["system"]["C"] = plant.C
    elif plant.order != 2 or rng.random() < 0.5:
        document["system"]["position_states"] = list(range(d))
    size = np.full(n, 0.01)
    size[:d] = rng.uniform(0.02, 0.08)
    document["initial_set"] = _initial_set(rng, plant.at(start), size, d, plant.C is None)
    document["horizon"] = {"duration_s": steps * step, "step_s": step}
    if sampled:
        document["feedback"] = {"period_s": step / int(rng.integers(1, 6))}
    soft = rng.uniform(1, 6) if rng.random() < 0.9 else rng.uniform(20, 60)  # slow to forget
    document["tracking"] = {"Q": plant.weights, "R": np.full(m, soft), **_norm(rng, n)}
    if rests or rng.random() < 0.4:
        document["goal"] = {"kind": "stationary", "state": plant.at(aim if plant.rests else 0 * aim)}
    else:
        half = np.full(n, np.inf if plant.order < 3 else 2.0)
        half[:d] = rng.uniform(0.2, 0.6)
        half[d : 2 * d] = rng.uniform(0.05, 0.3)
        document["goal"] = {"kind": "box", "center": plant.at(aim), "half_widths": half}
        if plant.C is not None:
            document["goal"]["half_widths"] = np.full(n, 0.4)
    _scene(rng, document, plant, start, path)
    document["experimental"] = _controllers(rng, plant, document, aim)
    _rules(rng, document, 0.3 + rng.random())
    document["planner"]["thrust_reserve"] = float(rng.uniform(0.2, 0.6))
    return _plain(_restated(rng, document, plant))


def _plant(rng: Random) -> Plant:
    """A plant with one to three coordinates of position."""
    d = int(rng.choice([1, 2, 2, 2, 3]))
    kind = rng.choice(["second", "second", "first", "lag", "oblique"])
    eye, zero = np.eye(d), np.zeros((d, d))
    limit = rng.uniform(0.8, 1.4, d)
    if kind == "first":  # C B is not zero: the input is a velocity
        A = rng.uniform(-0.1, 0.15) * eye + rng.uniform(-0.05, 0.05, (d, d)) if rng.random() < 0.7 else zero
        B = eye + 0.2 * rng.uniform(-1, 1, (d, d))
        D = eye if rng.random() < 0.5 else rng.uniform(-1, 1, (d, 1))
        weights = np.full(d, rng.uniform(0.5, 2))
        return Plant(kind, A, B, D, None, eye, d, 1, not A.any(), weights, 1.3 * limit)
    stiff = float(rng.choice([0.0, 0.0, 0.02, -0.03, -0.06])) * eye  # negative: unstable
    drag = float(rng.choice([0.0, 0.0, 0.1, -0.05])) * eye
    if rng.random() < 0.2 and d > 1:
        drag = drag + 0.1 * (np.eye(d, k=1) - np.eye(d, k=-1))  # a rotating frame
    A = np.block([[zero, eye], [-stiff, -drag]])
    B, D = np.vstack([zero, eye]), np.vstack([zero, eye])
    weights = np.r_[np.ones(d), np.full(d, rng.uniform(1, 3))]
    rests = not stiff.any()
    if rng.random() < 0.2:
        D = np.vstack([0.3 * eye, eye])
    if rng.random() < 0.2:  # more thrusters than axes
        B = np.hstack([B, 0.5 * B[:, :1]])
        limit = np.append(limit, 0.5)
    if kind == "lag":  # the thrust follows its command late
        tau, m = rng.uniform(0.2, 0.6), B.shape[1]
        n = 2 * d + m
        A_lag = np.zeros((n, n))
        A_lag[: 2 * d, : 2 * d], A_lag[: 2 * d, 2 * d :] = A, B
        A_lag[2 * d :, 2 * d :] = -np.eye(m) / tau
        late = np.vstack([np.zeros((2 * d, m)), np.eye(m) / tau])
        D = np.vstack([D, np.zeros((m, D.shape[1]))])
        rest_state = np.eye(n)[:, :d]
        weights = np.r_[weights, np.full(m, 0.1)]
        return Plant(kind, A_lag, late, D, None, rest_state, d, 3, rests, weights, 1.5 * limit)
    if kind == "oblique":  # states that are no positions: C is a matrix
        T = np.eye(2 * d) + 0.2 * rng.uniform(-1, 1, (2 * d, 2 * d))
        inverse = np.linalg.inv(T)
        C = np.hstack([eye, zero]) @ inverse
        Q = inverse.T @ np.diag(weights) @ inverse
        loop = T @ A @ inverse
        return Plant(kind, loop, T @ B, T @ D, C, T[:, :d], d, 2, rests, (Q + Q.T) / 2, limit)
    return Plant(kind, A, B, D, None, np.eye(2 * d)[:, :d], d, 2, rests, weights, limit)


def _controllers(rng: Random, plant: Plant, document: Table, aim: np.ndarray) -> list[Table]:
    """One or two experimental controllers."""
    n, m = plant.B.shape
    entries = []
    for i in range(1 + int(rng.random() < 0.35)):
        kind = str(rng.choice(["saturated_affine", "saturated_affine", "affine", "any_thrust"]))
        entry: Table = {"kind": kind, "name": f"u{i}", "weight": float(rng.choice([1.0, 1.0, 2.5]))}
        entries.append(entry)
        if kind == "any_thrust":
            continue
        ref_kind = rng.choice(["unaware", "unaware", "shared", "setpoint"])
        if kind == "affine":
            ref_kind = rng.choice(["shared", "unaware"])
        if rng.random() < 0.8:
            entry["Q"] = plant.weights * rng.uniform(0.3, 2)
            entry["R"] = np.full(m, rng.uniform(1, 8))
        else:
            from polaris.model.system import LinearSystem
            from polaris.synthesis.tracker.lqr import lqr_gain

            system = LinearSystem(plant.A, plant.B, plant.D, plant.limit, C=np.eye(n)[:1])
            entry["gain"] = lqr_gain(system, plant.weights, np.full(m, 5.0)) * rng.uniform(0.9, 1.1)
        if ref_kind != "shared" or rng.random() < 0.5:
            entry["reference"] = {"kind": str(ref_kind)}
        if ref_kind == "setpoint":
            entry["reference"]["state"] = plant.at(aim + rng.uniform(-0.5, 0.5, plant.d))
    return entries


def _scene(rng: Random, document: Table, plant: Plant, start: np.ndarray, path: np.ndarray) -> None:
    """Obstacles beside and on the way, keep-in sets around it."""
    d, length = plant.d, float(np.linalg.norm(path))
    ahead = path / length
    obstacles: list[Table] = []
    kinds = ["box", "ball", "polytope", "wall"]
    if plant.name == "second" and plant.limit.shape == (d,):
        kinds.append("satellite")
    for i in range(int(rng.choice([1, 1, 2, 3]))):
        kind = str(rng.choice(kinds))
        aside = _aside(rng, ahead)
        reach = rng.uniform(0.3, 0.9)
        if d == 1:  # nothing can be passed: it lies behind the start or beyond the goal
            ends = ((start, -ahead), (start + path, ahead))[i % 2]
            center = ends[0] + ends[1] * (reach + rng.uniform(1.0, 1.6))
        else:
            distance = reach * rng.uniform(0.2, 1.5) + (0.3 if rng.random() < 0.7 else 0.0)
            center = start + path * rng.uniform(0.35, 0.7) + aside * distance
        entry: Table = {"kind": kind, "name": f"o{i}"}
        if kind == "box":
            entry |= {"center_m": center, "half_widths_m": reach * rng.uniform(0.5, 1, d)}
        elif kind == "ball":
            entry |= {"center_m": center, "radius_m": reach}
            if rng.random() < 0.5 and d > 1:
                entry["facets"] = int(rng.choice([6, 14])) if d == 3 else int(rng.integers(5, 13))
            elif d == 3:
                entry["facets"] = 6
        elif kind == "polytope":
            turn = np.linalg.qr(rng.normal(size=(d, d)))[0]
            normals = np.vstack([turn, -turn]) * rng.uniform(0.5, 3)
            offsets = normals @ center + np.linalg.norm(normals, axis=1) * reach * 0.7
            entry |= {"normals": normals, "offsets_m": offsets}
        elif kind == "wall":
            side = ahead if d == 1 else aside
            side = -side if (start + path / 2 - center) @ side > 0 and d == 1 else side
            back = start + path / 2 + side * (length / 2 + 0.8 if d == 1 else rng.uniform(0.6, 1.5))
            entry |= {"kind": "polytope", "normals": [-side], "offsets_m": [float(-side @ back)]}
            entry["unbounded"] = True
        else:
            half = np.r_[np.full(d, 0.05), np.full(d, 0.003)]
            far = center + (1.5 if d > 1 else 2.0) * (aside if d > 1 else np.sign(center - start - path / 2))
            state = np.r_[far, rng.uniform(-0.02, 0.02, d)]
            entry |= {"state": state, "state_half_widths": half, "radius_m": 0.3}
            entry["thrust_accel_max_m_s2"] = float(rng.choice([0.0, 0.002]))
            entry["facets"] = 6 if d == 3 else 8
        if kind in ("box", "ball", "polytope", "wall") and rng.random() < 0.35:
            off_way = aside if d > 1 else np.sign(center - start - path / 2)
            entry["velocity_m_s"] = off_way * rng.uniform(0.01, 0.06)
        obstacles.append(entry)
    keep_in: list[Table] = []
    if rng.random() < 0.35:
        middle = start + path / 2
        if d > 1 and rng.random() < 0.5:
            entry = {"kind": "cone", "name": "beam", "apex_m": start - 4 * ahead}
            entry |= {"axis": ahead * rng.uniform(0.5, 3), "half_angle_deg": float(rng.uniform(25, 40))}
            if d == 3:
                entry["facets"] = int(rng.integers(4, 9))
            if rng.random() < 0.5:
                entry["length_m"] = 2 * length + 6
        else:
            turn = np.linalg.qr(rng.normal(size=(d, d)))[0] if rng.random() < 0.5 else np.eye(d)
            normals = np.vstack([turn, -turn]) * rng.uniform(0.5, 2)
            clearance = np.abs(turn @ path) / 2 + rng.uniform(1.5, 3)
            offsets = normals @ middle + np.linalg.norm(normals, axis=1) * np.r_[clearance, clearance]
            entry = {"kind": "polytope", "name": "hall", "normals": normals, "offsets_m": offsets}
        keep_in.append(entry)
        if rng.random() < 0.4:
            obstacles = []
    document["obstacles"], document["keep_in"] = obstacles, keep_in


def _spacecraft(rng: Random, name: str) -> Table:
    """A scene in Hill's frame: towards the target, past something."""
    eta, mass = float(rng.uniform(0.0009, 0.0014)), float(rng.choice([1.0, 10.0, 350.0]))
    size = float(rng.uniform(80, 250))
    pace = float(rng.uniform(900, 1800))
    push = float(rng.uniform(12, 25)) * size / pace**2
    document = _head(name)
    system: Table = {"kind": "clohessy_wiltshire", "mean_motion_rad_s": eta, "mass_kg": mass}
    system["thrust_max_N"] = push * mass if rng.random() < 0.6 else push * mass * rng.uniform(0.8, 1.2, 3)
    system["disturbance_max_m_s2"] = push * float(rng.choice([0.0, 0.002, 0.005]))
    document["system"] = system
    start = np.array([0.0, size, 0.0, eta * size / 2 * float(rng.integers(2)), 0.0, 0.0])
    extent = np.r_[np.full(3, 0.006 * size), np.full(3, 0.02 * size / pace)]
    document["initial_set"] = _initial_set(rng, start, extent, 3, True)
    steps = int(rng.integers(20, 36))
    step = round(pace / steps, 1)
    document["horizon"] = {"duration_s": steps * step, "step_s": step}
    if rng.random() < 0.5:
        document["feedback"] = {"period_s": step / int(rng.integers(2, 5))}
    rate = rng.uniform(12, 20) / pace
    soft = 1 / (push * mass) ** 2 * (rng.uniform(0.3, 2) if rng.random() < 0.85 else rng.uniform(100, 3000))
    near = 16 / size**2
    weights = np.r_[np.full(3, near), np.full(3, near / rate**2)]
    document["tracking"] = {"Q": weights, "R": np.full(3, soft), **_norm(rng, 6)}
    goal = str(rng.choice(["elliptical_nmt", "elliptical_nmt", "linear_nmt", "stationary", "box"]))
    inner, sides = {"inner_semi_minor_m": 0.1 * size}, {"sides": int(rng.choice([8, 16]))}
    half = [0.05 * size] * 3 + [0.05 * size / pace] * 2 + [float("inf")]
    parameters = {
        "elliptical_nmt": inner | {"outer_semi_minor_m": 0.2 * size} | sides,
        "linear_nmt": {"amplitude_max_m": 0.1 * size, "along_track_m": -0.2 * size},
        "stationary": {"state": [0.0, 0.3 * size, 0.0, 0.0, 0.0, 0.0]},
        "box": {"center": [0.2 * size, 0.2 * size, 0.0, 0.0, 0.0, 0.0], "half_widths": half},
    }
    document["goal"] = {"kind": goal, **parameters[goal]}
    if goal == "elliptical_nmt" and rng.random() < 0.5:
        document["goal"]["cross_track_max_m"] = 0.05 * size
    reach, at = 0.07 * size, size * np.array([rng.uniform(0.1, 0.3), rng.uniform(0.5, 0.65), 0.0])
    kind = str(rng.choice(["box", "ball", "polytope", "satellite"]))
    obstacle: Table = {"kind": kind, "name": "debris"}
    if kind == "box":
        obstacle |= {"center_m": at, "half_widths_m": [reach] * 3}
    elif kind == "ball":
        obstacle |= {"center_m": at, "radius_m": reach, "facets": int(rng.choice([6, 14]))}
    elif kind == "polytope":
        obstacle |= {"normals": np.vstack([np.eye(3), -np.eye(3)])}
        obstacle["offsets_m"] = obstacle["normals"] @ at + reach
    else:
        orbit = [0.0, -0.5 * size, 0.0, -eta * size / 4, 0.0, 0.0]
        obstacle |= {"state": orbit, "state_half_widths": extent / 2, "radius_m": reach / 2}
        obstacle |= {"thrust_accel_max_m_s2": push * float(rng.choice([0.0, 1e-3])), "facets": 6}
    if kind != "satellite" and rng.random() < 0.3:
        obstacle["velocity_m_s"] = [0.0, 0.0, 0.1 * size / pace]
    document["obstacles"] = [obstacle]
    document["keep_in"] = []
    if rng.random() < 0.25:
        edge = {"normals": np.vstack([np.eye(3), -np.eye(3)]), "offsets_m": [1.5 * size] * 6}
        document["keep_in"] = [{"kind": "polytope", "name": "zone", **edge}]
    document["experimental"] = []
    for i in range(1 + int(rng.random() < 0.35)):
        law = str(rng.choice(["saturated_affine", "saturated_affine", "affine", "any_thrust"]))
        entry: Table = {"kind": law, "name": f"u{i}"}
        document["experimental"].append(entry)
        if law == "any_thrust":
            continue
        entry |= {"Q": weights * rng.uniform(0.2, 1.5), "R": np.full(3, soft * rng.uniform(1, 3))}
        ref_kind = str(rng.choice(["unaware", "shared", "nmt", "setpoint"]))
        entry["reference"] = {"kind": ref_kind}
        if ref_kind == "nmt":
            entry["reference"] |= {"semi_minor_m": 0.45 * size, "phase_rad": float(rng.uniform(0, 0.3))}
        if ref_kind == "setpoint":
            entry["reference"]["state"] = [0.0, 0.4 * size, 0.0, 0.0, 0.0, 0.0]
    _rules(rng, document, 0.08 * size * rng.uniform(0.3, 1.2))
    document["planner"]["thrust_reserve"] = float(rng.uniform(0.2, 0.5))
    return _plain(document)


def _head(name: str) -> Table:
    return {"schema_version": 1, "name": name, "title": f"Random scene {name}"}


def _direction(rng: Random, d: int) -> np.ndarray:
    v = rng.normal(size=d)
    return v / np.linalg.norm(v)


def _aside(rng: Random, ahead: np.ndarray) -> np.ndarray:
    """A direction across another one; in one dimension either."""
    if len(ahead) == 1:
        return ahead * rng.choice([-1.0, 1.0])
    v = rng.normal(size=len(ahead))
    v -= (v @ ahead) * ahead
    return v / np.linalg.norm(v)


def _initial_set(rng: Random, center: np.ndarray, size: np.ndarray, d: int, choice: bool) -> Table:
    """A box, a ball or a zonotope of about the given half-widths; a ball needs C to be a choice of states."""
    kind = str(rng.choice(["box", "ball", "zonotope"] if choice else ["box", "zonotope"]))
    size = size * rng.choice([1.0] * 8 + [0.0, 1e-7])
    table: Table = {"kind": kind, "center": center}
    if kind == "box":
        table["half_widths"] = size * (rng.random(len(size)) < 0.9)
    elif kind == "ball":
        speed = float(size[d]) if len(size) > d else 0.0
        table |= {"position_radius_m": float(size[0]), "velocity_radius_m_s": speed}
    else:
        count = int(rng.integers(1, len(size) + 3))
        table["generators"] = rng.uniform(-1, 1, (count, len(size))) * size / np.sqrt(count)
    return table


def _norm(rng: Random, n: int) -> Table:
    table: Table = {}
    if rng.random() < 0.3:
        table["bound"] = "lyapunov"
    if rng.random() < 0.2:
        table["weight"] = "identity" if rng.random() < 0.5 else rng.uniform(0.5, 2, n)
    return table


def _rules(rng: Random, document: Table, margin: float) -> None:
    """Recoverable sets, planner, schedule, simulation."""
    kind = str(rng.choice(["polytope"] * 4 + ["ball"] * 2))
    document["recoverable"] = {"kind": kind}
    objective = str(rng.choice(["margin_then_fuel", "margin_then_fuel", "fuel", "distance"]))
    planner = {"objective": objective, "extra_margin_m": float(margin) if rng.random() < 0.85 else 0.0}
    document["planner"] = planner | {"gap": 0.02, "time_limit_s": 30.0}
    rules: Table = {"strategy": str(rng.choice(["greedy", "greedy", "look_ahead"]))}
    if rng.random() < 0.4:
        rules["min_dwell_steps"] = int(rng.integers(2, 5))
    if rng.random() < 0.4:
        rules["max_switches"] = int(rng.integers(0, 8))
    document["schedule"] = rules
    document["simulation"] = {"runs": 1, "seed": int(rng.integers(1000))}


def _restated(rng: Random, document: Table, plant: Plant) -> Table:
    """Return the scene in other units of length, time and input."""
    if rng.random() < 0.6:
        return document
    length, time, thrust = (float(rng.choice(x)) for x in ([0.3, 1, 1e3, 1e6], [1, 1, 30.0], [1, 1e-3, 1e4]))
    time = max(time, length / 1000)  # nothing moves faster than 100 m/s
    n, d = len(plant.A), plant.d
    state = np.full(n, length)
    if plant.C is None and plant.order > 1:
        state[d : 2 * d] = length / time
        state[2 * d :] = length / time**2
    inverse = 1 / state
    system = document["system"]
    system["A"] = plant.A * np.outer(state, inverse) / time
    system["B"] = plant.B * state[:, None] / (time * thrust)
    system["D"] = plant.D * state[:, None] / length / time * (time**2 if plant.order > 1 else time)
    system["input_max"] = np.asarray(system["input_max"]) * thrust
    system["disturbance_max"] *= length / (time**2 if plant.order > 1 else time)
    for table in (document["initial_set"], document["goal"]):
        for key in ("center", "half_widths", "state", "generators"):
            if key in table:
                table[key] = np.asarray(table[key]) * state
        for key, value in (("position_radius_m", state[0]), ("velocity_radius_m_s", state[-1])):
            if key in table:
                table[key] = float(table[key] * value)
    if plant.order == 3 and document["initial_set"]["kind"] == "ball":
        document["initial_set"]["velocity_radius_m_s"] = 0.01 * length / time**2
    for table in (document["horizon"], document.get("feedback", {})):
        for key in ("duration_s", "step_s", "period_s"):
            if key in table:
                table[key] = table[key] * time
    for table in (document["tracking"], *document["experimental"]):
        if "Q" in table:
            Q = np.asarray(table["Q"])
            table["Q"] = Q * inverse**2 if Q.ndim == 1 else Q * np.outer(inverse, inverse)
            table["R"] = np.asarray(table["R"]) / thrust**2
        if "gain" in table:
            table["gain"] = table["gain"] * inverse * thrust
        if "state" in table.get("reference", {}):
            table["reference"]["state"] = table["reference"]["state"] * state
    if isinstance(document["tracking"].get("weight"), np.ndarray):
        document["tracking"]["weight"] = document["tracking"]["weight"] * inverse
    for table in (*document["obstacles"], *document["keep_in"]):
        for key in ("center_m", "half_widths_m", "radius_m", "apex_m", "length_m", "offsets_m"):
            if key in table:
                table[key] = np.asarray(table[key]) * length
        for key in ("state", "state_half_widths"):
            if key in table:
                table[key] = table[key] * state
        for key, value in (("velocity_m_s", length / time), ("thrust_accel_max_m_s2", length / time**2)):
            if key in table:
                table[key] = np.asarray(table[key]) * value
    document["planner"]["extra_margin_m"] *= length
    return document


def _plain(value: Any) -> Any:
    """Return data without numpy."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items() if item is not None}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


def synthesised(seed: int, folder: Path, *assignments: str) -> tuple[Any, Any]:
    """(scenario, schedule) of a random scene, read from a file that is written into a folder, and changed."""
    from polaris.scenario.scenario import load_scenario
    from polaris.synthesis.schedule.synthesize import synthesize
    from tests.kept import kept

    def make():
        path = folder / f"random-{seed}.toml"
        path.write_text(random_scenario(seed), encoding="utf-8")
        scenario = load_scenario(path, assignments)
        return scenario, synthesize(scenario)

    return kept("-".join(["random", str(seed), *assignments]), make)


def written(seed: int, folder: Path) -> Path:
    """Run folder of a random scene; raises as `synthesised` does."""
    from polaris.runs.run import run

    path = folder / f"random-{seed}.toml"
    path.write_text(random_scenario(seed), encoding="utf-8")
    return run(path, folder / f"random-{seed}").path
