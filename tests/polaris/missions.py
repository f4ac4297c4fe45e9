"""Small missions for tests of Proposition 12 (d): a robot goes to places, and waits for GO in between."""

import tomllib

import numpy as np

from polaris.scenario.reading import write_toml
from tests.polaris.tiny import TINY

WIDE = [0.3, 0.3, 0.08, 0.08]
PLACES = ([8.0, 6.0, 0.0, 0.0], [0.0, 6.0, 0.0, 0.0], [8.0, 0.0, 0.0, 0.0])


def shared(moving=False):
    """Tables that all legs have."""
    table = tomllib.loads(TINY.read_text(encoding="utf-8"))
    for key in ("initial_set", "goal", "horizon"):
        del table[key]
    table |= {"kind": "mission", "name": "tour", "title": "Tour of a robot", "feedback": {"period_s": 0.5}}
    table["tracking"]["R"] = [60.0, 60.0]
    table["experimental"] = [{**table["experimental"][0], "reference": {"kind": "shared"}}]
    table["simulation"]["runs"] = 4
    table["obstacles"] = table["obstacles"][: 1 + moving]
    return table


def leg(name, start, goal, duration=14.0, half_widths=WIDE, **fields):
    """The table of a leg."""
    box = {"kind": "box", "center": start, "half_widths": half_widths}
    stop = {"kind": "stationary", "state": goal}
    time = {"duration_s": duration, "step_s": 1.0}
    return {"name": name, "initial_set": box, "goal": stop, "horizon": time, **fields}


def tour(moving=False, **fields):
    """A mission of three legs."""
    a, b, c = PLACES
    out = leg("out", [0.0, 0.0, 0.0, 0.0], a, half_widths=[0.05, 0.05, 0.01, 0.01], **fields)
    return shared(moving) | {"legs": [out, leg("across", a, b, **fields), leg("home", b, c, **fields)]}


def random_tour(seed):
    """A mission of random places, weights and noise, in which each leg has its own."""
    rng, document = np.random.default_rng(seed), tour()
    boxes = (([6.0, 4.0], [9.0, 7.0]), ([-1.0, 5.0], [2.0, 8.0]), ([6.0, -1.0], [9.0, 0.5]))
    places = [[0.0, 0.0], *(rng.uniform(*ends) for ends in boxes)]
    for each, start, goal in zip(document["legs"], places[:-1], places[1:], strict=True):
        each["initial_set"]["center"] = [*map(float, start), 0.0, 0.0]
        each["goal"]["state"] = [*map(float, goal), 0.0, 0.0]
        each["tracking"] = {"Q": [25.0] * 4, "R": [float(rng.uniform(20, 90))] * 2}
    document["system"]["disturbance_max"] = float(rng.uniform(0.005, 0.02))
    if rng.random() < 0.5:
        document["navigation"] = {"position_error_m": 0.02, "velocity_error_m_s": 0.005}
    return document


def orbiting():
    """A mission in orbit: to an ellipse about a target, and back."""
    n, hold, b = 0.00113, [0.0, -150.0, 0.0, 0.0, 0.0, 0.0], 30.0
    place, wide = [0.0, -2 * b, 0.0, -n * b, 0.0, 0.0], [3.0, 3.0, 3.0, 0.005, 0.005, 0.005]
    orbit = {"kind": "box", "center": place, "half_widths": [0.0] * 6, "tolerance_m": 5.0}
    time = {"duration_s": 2400.0, "step_s": 120.0}
    craft = {"kind": "clohessy_wiltshire", "mean_motion_rad_s": n, "mass_kg": 10.0, "thrust_max_N": 0.1}
    soft = {"kind": "saturated_affine", "name": "soft", "Q": [0.001] * 3 + [50.0] * 3, "R": [4e3] * 3}
    table = shared() | {
        "system": craft | {"disturbance_max_m_s2": 1e-6},
        "feedback": {"period_s": 24.0},
        "tracking": {"Q": [0.01] * 3 + [100.0] * 3, "R": [4e3] * 3},
        "planner": {"objective": "fuel"},
        "obstacles": [{"kind": "ball", "name": "target", "center_m": [0.0] * 3, "radius_m": 8.0}],
        "experimental": [soft],
    }
    legs = [leg("approach", hold, hold, half_widths=[1.0] * 3 + [0.002] * 3)]
    legs.append(leg("back", place, hold, half_widths=wide))
    legs[0]["goal"] = orbit
    return table | {"name": "orbiting", "legs": [each | {"horizon": time} for each in legs]}


def written(document, folder):
    """Write a mission into a folder; returns the file."""
    path = folder / "tour.toml"
    path.write_text(write_toml(document), encoding="utf-8")
    return path
