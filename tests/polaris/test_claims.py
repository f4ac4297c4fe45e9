"""What a run claims beside safety, against what its scenario demands and against the rest of its folder."""

import numpy as np
import pytest

pytest.importorskip("flint")

from polaris.certificate.checker import verify
from polaris.report import write_report
from polaris.report.figures import draw_run
from polaris.runs.arrays import read_arrays, tube_arrays
from polaris.runs.run import run
from polaris.scenario.scenario import load_scenario
from polaris.simulation.simulate import simulate
from polaris.synthesis.synthesize import synthesize

from .forging import QUARTER
from .tiny import TINY

CORNER = (
    "initial_set.center=[1.0,1.0,0.0,0.0]",
    'obstacles=[{kind="polytope",name="wall",normals=[[2.0,0.0]],offsets_m=[0.0],unbounded=true},'
    '{kind="polytope",name="wedge",normals=[[1.0,-1.0],[-1.0,4.0]],offsets_m=[0.0,-0.0],unbounded=true}]',
    'keep_in=[{kind="polytope",name="quadrant",normals=[[0.0,-1.0],[-1.0,3e-9]],offsets_m=[0.0,0.0]},'
    '{kind="cone",name="cone",apex_m=[0.0,0.0],axis=[1.0,1.0],half_angle_deg=80.0}]',
)
"""Every set has its facets through the origin."""


def test_a_scene_of_walls_through_the_origin_is_proven_drawn_and_verified(tmp_path):
    assignments = [QUARTER, "simulation.runs=2", "schedule.bound_programs=0", *CORNER]
    made = run(TINY, tmp_path / "run", overrides=assignments, draw=draw_run)
    assert made.summary["guarantee"]["kind"] == "proved"
    write_report(made.path)
    verdict = verify(made.path)
    assert verdict.outcome == "VERIFIED", verdict.text()


# -- tubes.npz --------------------------------------------------------------------------------------

SOFT = (
    *('feedback={kind="sampled",period_s=0.25}', "tracking.Q=[0.1,0.1,0.1,0.1]", "tracking.R=[10.0,10.0]"),
    *("initial_set.half_widths=[0.0005,0.0005,0.0001,0.0001]", "system.disturbance_max=0.0001"),
    *("experimental.0.Q=[0.1,0.1,0.1,0.1]", "experimental.0.R=[10.0,10.0]"),
    *('experimental.0.reference={kind="shared"}', "planner.extra_margin_m=0.0"),
    'obstacles=[{kind="ball",name="far",center_m=[0.0,60.0],radius_m=1.0}]',
)
"""Next to no feedback: what displaces flights is not hidden in what they need to answer it."""
BIT = "thrusters.impulse_bit_N_s=0.02"
DISPLACED = {
    "carried": [BIT, "thrusters.remainder=carried"],
    "carried, of another size": [BIT, "thrusters.remainder=carried", "thrusters.magnitude_error=0.05"],
    "carried and pulsed": [BIT, "thrusters.remainder=carried", "thrusters.pulse=centred"],
    "pulsed": ["thrusters.pulse=centred"],
    "early or late": ["timing.jitter_s=0.02"],
}


@pytest.mark.parametrize("kind", DISPLACED)
def test_flights_are_inside_the_sets_of_the_file_at_nodes_and_between(kind, tmp_path):
    """Along random rows, each flight against the zonotopes as they are read; some use most of them."""
    schedule = synthesize(load_scenario(TINY).with_assignments([*SOFT, *DISPLACED[kind]]))
    np.savez(tmp_path / "tubes.npz", **tube_arrays(schedule))
    file, runs = read_arrays(tmp_path / "tubes.npz"), simulate(schedule, 150, 0, initial="corners")
    (K, q), system = file["bow"].shape[:2], schedule.safety.problem.system
    at = np.arange(K)[:, None] * q + np.arange(q + 1)
    errors = runs.states[:, at] - schedule.safety.reference.fine(q)[:K]
    within = between(runs, schedule, parts=20).reshape(len(errors), K, q, -1, system.n)
    most, rng = 0.0, np.random.default_rng(0)
    for row in [*np.eye(system.n), *rng.normal(size=(20, system.n))]:
        middle, bow = file["center_error"] @ row, file["bow"] @ np.abs(row)
        half = np.abs(file["generators"].astype(float) @ row).sum(axis=1).T
        share = np.abs(errors @ row - middle) / half
        assert np.all(share <= 1 + 1e-6)
        most = max(most, float(share[:, :, 1:].max()))
        low, high, along = middle - half, middle + half, within @ row
        off = system.w_max * schedule.safety.tracking.flow.h  # `between` knows of none
        assert np.all(along >= (np.minimum(low[:, :-1], low[:, 1:]) - bow - off)[..., None])
        assert np.all(along <= (np.maximum(high[:, :-1], high[:, 1:]) + bow + off)[..., None])
    last = np.abs(errors[:, -1, -1] - file["final_center_error"])
    assert np.all(last <= np.abs(file["final_generators"]).sum(axis=1) + 1e-9)
    assert most > (0.5 if "carried" in kind else 0.02)


def between(runs, schedule, parts):
    """Errors within every period of a double integrator under the thrust that was applied, held or pulsed."""
    h, fired = schedule.safety.tracking.flow.h, np.array(schedule.safety.problem.system.timing.fired)
    ends, u = np.linspace(-0.5, 0.5, parts + 1)[:, None], runs.inputs[:, :, None]
    if len(fired):
        on = np.abs(u) / fired / 2
        u = np.sign(u) * fired * np.maximum(np.minimum(on, ends[1:]) - np.maximum(-on, ends[:-1]), 0) * parts
    nu = np.repeat(schedule.safety.reference.nu, runs.inputs.shape[1] // schedule.safety.problem.K, axis=0)
    K, count = schedule.safety.problem.K, runs.inputs.shape[1]
    start = runs.states[:, :-1] - np.vstack([*schedule.safety.reference.fine(count // K)[:K, :-1]])
    d = np.cumsum(u - nu[:count, None] + np.zeros((parts, 1)), axis=2) * h / parts
    d = start[:, :, None, 2:] + np.concatenate([0 * d[:, :, :1], d], axis=2)
    p = start[:, :, None, :2] + np.cumsum((d[:, :, 1:] + d[:, :, :-1]) / 2, axis=2) * h / parts
    return np.concatenate([p, d[:, :, 1:]], axis=-1)
