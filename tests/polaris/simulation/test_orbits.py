"""Real orbits: sources of [orbit] and of start sets, ephemerides in and out, the bound of eccentricity."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from polaris.certificate.checker import verify
from polaris.cli.app import app
from polaris.model.errors import ScenarioError
from polaris.runs.files.arrays import read_flights
from polaris.scenario.scenario import load_scenario
from polaris.scenario.schedule import ScheduleScenario
from polaris.simulation.orbit.environment import MU, Environment
from polaris.simulation.orbit.frame import frame_rates
from polaris.simulation.orbit.inertial import (
    AXIS,
    elements_of_state,
    from_hill,
    hill_axes,
    propagate,
    state_of_elements,
    to_hill,
)
from polaris.simulation.orbit.model_error import error_within, sample_residual
from polaris.simulation.orbit.oem import (
    SECOND,
    Ephemeris,
    Track,
    epoch_text,
    oem_lines,
    parse_epoch,
    read_oem,
)
from polaris.simulation.orbit.region import Region
from polaris.simulation.orbit.residual import residual_bound
from polaris.simulation.orbit.start import start_set
from polaris.simulation.orbit.truth import declared

DATA = Path(__file__).parents[1] / "data" / "client"
"""Ephemerides of two craft 400 m apart, 590 km up, e = 0.0042, and a scenario that reads them."""

AIR = {"density_kg_m3": 3e-13, "scale_height_m": 6e4}
AIR |= {"ballistic_coefficient_m2_kg": 1e-2, "ballistic_difference_max_m2_kg": 1e-2}
ELEMENTS = {"epoch": "2026-01-31T12:00:00", "semi_major_axis_m": 6965.6e3, "eccentricity": 0.0042}
ELEMENTS |= {"inclination_deg": 98.2, "ascending_node_deg": 40.0}
ELEMENTS |= {"perigee_deg": 120.0, "true_anomaly_deg": 20.0}
LINES = [  # of the space station, from the paper that revisits SGP4
    "1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927",
    "2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537",
]


def document(orbit, folder=None, **system):
    """A scenario whose target is on a given orbit."""
    data = load_scenario(DATA / "client.toml").to_dict()
    del data["system"]["mean_motion_rad_s"]
    data["system"] |= system
    data["orbit"] = AIR | orbit
    return ScheduleScenario.from_dict(data, "here", folder=folder)


def random_orbit(rng):
    """Elements of a random low orbit, above the ground at perigee, as numbers and as a table."""
    e = rng.choice([0.0, 10 ** rng.uniform(-4, -1.1)])
    a = rng.uniform(6.75e6, 9e6) / (1 - e)
    angles = [np.arccos(rng.uniform(-1, 1)), *rng.uniform(0, 2 * np.pi, 3)]
    names = ["inclination_deg", "ascending_node_deg", "perigee_deg", "true_anomaly_deg"]
    table = {"epoch": "2026-031T12:00:00.5", "semi_major_axis_m": a, "eccentricity": e}
    return (a, e, *angles), table | dict(zip(names, np.degrees(angles).tolist(), strict=True))


def test_the_bound_of_ellipses_holds_on_random_ones_and_not_with_a_quarter_of_it():
    rng = np.random.default_rng(0)
    for _ in range(40):
        speeds = 10.0 ** rng.uniform(-3, 1) * np.array([1, 1, 0.1])
        upper = np.append(10.0 ** rng.uniform(0, 3.5, 3), speeds)[None]
        region = Region(("box",), np.zeros(1), -upper, upper)
        env = Environment(10 ** rng.uniform(-4, -2.93), j2=False, eccentricity=10 ** rng.uniform(-4, -1))
        sampled = sample_residual(env, region, 3000, rng)
        assert sampled <= residual_bound(env, *region.extent).total.max()
        less = replace(env, eccentricity=env.eccentricity / 4)
        assert sampled > residual_bound(less, *region.extent).eccentricity.max()


@pytest.mark.parametrize("seed", range(6))
def test_targets_stay_on_the_ellipses_that_follow_from_their_elements(seed):
    """For six revolutions, three times as long as what was looked at; J2 turns the perigee meanwhile."""
    elements, table = random_orbit(np.random.default_rng(seed))
    env = Environment.from_scenario(document({"elements": table}))
    assert env.mean_motion == pytest.approx(np.sqrt(MU / elements[0] ** 3), rel=5e-3)
    first = state_of_elements(*elements)
    assert np.allclose(state_of_elements(*elements_of_state(first)), first, rtol=1e-8, atol=1e-3)
    states = propagate(env, first, np.linspace(0, 12 * np.pi / env.mean_motion, 900))
    axes, omega = hill_axes(states)
    R = np.linalg.norm(states[:, :3], axis=1)
    rate = np.sum(states[:, :3] * states[:, 3:], axis=1) / R
    target = np.column_stack([R, rate, R**2 * omega[:, 2], axes @ AXIS])
    assert np.allclose(frame_rates(env, target)[0], omega, rtol=1e-9)
    upright = target.copy()
    upright[:, 5] = np.abs(upright[:, 5])
    assert declared(env, upright[None])[0]
    assert not declared(replace(env, eccentricity=max(env.eccentricity - 1.5e-3, 0.0)), upright[None])[0]


def test_elements_agree_with_sgp4s_own():
    pytest.importorskip("sgp4")
    scenario = document({"two_line_elements": LINES})
    env = Environment.from_scenario(scenario)
    per_day = env.mean_motion * 86400 / (2 * np.pi)
    assert per_day == pytest.approx(15.72125391, rel=2e-3)
    assert np.degrees(env.inclination_max) == pytest.approx(51.64, abs=0.4)
    elements = scenario.model.orbit.elements
    assert elements.frame == "TEME" and elements.epoch.startswith("2008-09-20T12:25:40.10")
    assert 0.0006703 < env.eccentricity < 0.0006703 + 2.5e-3


@pytest.mark.parametrize(
    ("orbit", "system", "rule"),
    [
        ({}, {}, "mean_motion_rad_s.*is required"),
        ({"elements": ELEMENTS, "ephemeris": "target.oem"}, {}, "must have one of"),
        ({"elements": ELEMENTS, "epoch": "2026-01-31T12:00:00"}, {}, "elements have an epoch"),
        ({"elements": ELEMENTS | {"epoch": "noon"}}, {}, "must be of the form"),
        ({"elements": ELEMENTS | {"eccentricity": 0.15}}, {}, "perigee above the Earth"),
        ({"elements": ELEMENTS | {"eccentricity": 0.15, "semi_major_axis_m": 8.5e6}}, {}, "at most 0.1"),
        ({"elements": ELEMENTS}, {"mean_motion_rad_s": 0.0015}, "must be that of the orbit, near 0.00108"),
        ({"ephemeris": "target.oem", "epoch": "2026-02-01T12:00:00"}, {}, "must lie in the target's eph"),
        ({"ephemeris": "target.oem", "epoch": "2026-01-31T12:30:00"}, {}, "must cover the scenario's 1800 s"),
        ({"ephemeris": "nothing.oem"}, {}, "there is no such file"),
        ({"two_line_elements": LINES[::-1]}, {}, "line 1 must have 69 characters"),
        ({"two_line_elements": [LINES[0][:-1] + "3", LINES[1]]}, {}, "checksum"),
        ({"two_line_elements": LINES, "epoch": "2009-01-01T00:00:00"}, {}, "within 14 days"),
        ({"two_line_elements": LINES, "epoch": "2008-13-01T00:00:00"}, {}, "date and a time that exist"),
    ],
)
def test_bad_orbits_end_in_one_sentence(orbit, system, rule):
    if "two_line_elements" in orbit:
        pytest.importorskip("sgp4")
    with pytest.raises(ScenarioError, match=rule):
        document(orbit, DATA, **system)


def test_what_followed_is_noted_and_does_not_follow_again():
    scenario = document({"elements": ELEMENTS})
    assert "propagated with J2" in scenario.derived[0] and "assumed of the target" in scenario.derived[1]
    assert all(line in scenario.copy_text() for line in scenario.derived)
    reread = ScheduleScenario.from_dict(scenario.to_dict())
    assert reread.to_dict() == scenario.to_dict() and not reread.derived
    assert scenario.set("planner.gap", 0.1).derived == scenario.derived
    declared = document({"elements": ELEMENTS, "eccentricity_max": 0.02, **{
        "radius_deviation_max_m": 1.0, "radial_rate_max_m_s": 1.0, "rate_deviation_max": 1e-3,
    }}, mean_motion_rad_s=0.001086)  # fmt: skip
    assert not declared.derived and declared.model.orbit.eccentricity_max == 0.02


def written(path, track, epoch="2026-01-31T12:00:00"):
    """Write one track."""
    path.write_text("\n".join(oem_lines(track, parse_epoch(epoch), "EME2000", "UTC")) + "\n")
    return path


def test_what_is_written_is_read_and_interpolated(tmp_path):
    env, start = Environment(1.05e-3), state_of_elements(7e6, 0.01, 1.0, 2.0, 3.0, 0.5)
    times = np.arange(0.0, 7200.1, 60.0)
    states = propagate(env, start, times)
    read = read_oem(written(tmp_path / "a.oem", Track("a", times[::5], states[::5])))
    between = read.states_at([read.epochs[0] + round(t) * SECOND for t in times])
    assert np.abs(between - states)[:, :3].max() < 1e-3 and np.abs(between - states)[:, 3:].max() < 1e-6
    with pytest.raises(ScenarioError, match="covers 2026-01-31T12:00:00"):
        read.states_at([read.epochs[-1] + 1])
    indices = [0, 1, 2, 30, 31]
    read = read_oem(written(tmp_path / "b.oem", Track("b", times[indices], states[indices])))
    with pytest.raises(ScenarioError, match="gap: states about it are 1680 s apart"):
        read.states_at([read.epochs[0] + 900 * SECOND])
    for text in ("2026-01-31T12:00:00.000001", "1999-12-31T23:59:59.999999999"):
        assert epoch_text(parse_epoch(text)) == text


CHANGES = {
    "metres": (r"(\d{4}-\S+:00) (-?\d+)\.(\d{3})(\d{3})", r"\1 \2\3.\4", "positions must be in km"),
    "turning frame": ("EME2000", "ITRF2000", "REF_FRAME is ITRF2000; it must be one of EME2000"),
    "time system": ("UTC", "UT1", "TIME_SYSTEM is UT1; it must be one of UTC"),
    "centre": ("= EARTH", "= MARS", "CENTER_NAME is MARS"),
    "unknown key": ("OBJECT_ID", "OBJECT_IDS", "unknown key OBJECT_IDS"),
    "missing key": (r"REF_FRAME = EME2000\n", "", "must have REF_FRAME"),
    "order": ("12:10:00 ", "12:04:00 ", "epochs must increase"),
    "not finite": (r"4413\.\d+", "nan", "must be finite"),
    "no number": (r"4413\.\d+", "4413,8", "could not convert"),
    "too few": (r"4413\.\d+ ", "", "must have 6 or 9 numbers, has 5"),
    "leap second": ("12:05:00 ", "12:05:60 ", "leap seconds are not read"),
    "correlation above one": ("0 1.0e-6", "2.0e-6 1.0e-6", "positive semidefinite"),
    "cut covariance": ("0 0 0 0 0 9.0e-12\n", "", "must have 6 numbers, has 1"),
    "cut file": (r"(?s)2026-01-31T12:05.*", "", "ends too early"),
    "other message": ("CCSDS_OEM_VERS", "CCSDS_OPM_VERS", "must begin with CCSDS_OEM_VERS"),
    "date with a space": (
        r"(2026-01-31)T(\d\d:05:00 )",
        r"\1 \2",
        "must be of the form 2026-01-31T12:00:00.000",
    ),
    "no end of metadata": (r"META_STOP\n", "", "META_STOP is missing before it"),
    "XML": (r"^", "<?xml version='1.0'?>\n", "is XML"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_bad_ephemerides_end_in_one_sentence(tmp_path, change):
    pattern, new_text, rule = CHANGES[change]
    text = (DATA / "chaser.oem").read_text()
    changed = re.sub(pattern, new_text, text)
    assert changed != text
    (tmp_path / "chaser.oem").write_text(changed)
    with pytest.raises(ScenarioError, match=re.escape(rule)) as error:
        read_oem(tmp_path / "chaser.oem")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("pattern", "put", "rule"),
    [
        ("EME2000", "GCRF", "another frame"),
        ("= UTC", "= TAI", "another time_system"),
        (r"(?s)COVARIANCE_START.*", "", "must have a covariance at the time 0 of the scenario; it has none"),
        ("COV_REF_FRAME = RTN", "COV_REF_FRAME = TNW", "must have covariances in EME2000 or one of RTN"),
        (
            r"(?m)(00 \S+ \S+ \S+) (\S+) (\S+) (\S+)$",
            r"\1 -\2 -\3 -\4",
            r"initial_set\.center.* m/s'; must be at most",
        ),
    ],
)
def test_two_ephemerides_that_do_not_fit_end_in_one_sentence(tmp_path, pattern, put, rule):
    for name in ("target.oem", "client.toml"):
        (tmp_path / name).write_text((DATA / name).read_text())
    changed = re.sub(pattern, put, (DATA / "chaser.oem").read_text()).replace(" --", " ")
    (tmp_path / "chaser.oem").write_text("\ufeff" + changed)  # a mark of the byte order is read over
    with pytest.raises(ScenarioError, match=rule):
        load_scenario(tmp_path / "client.toml")


@pytest.mark.parametrize("frame", ["RTN", "EME2000", "rotating"])
def test_start_sets_hold_every_error_within_sigma(frame):
    """Random covariances of both craft; errors on the ellipsoid go through the nonlinear relative state."""
    rng = np.random.default_rng(3)
    rotating, axes_of = frame == "rotating", frame.replace("rotating", "RTN")
    target = state_of_elements(6.97e6, 0.0042, 1.71, 0.7, 2.0, 0.3)
    chaser = from_hill(target, np.array([100.0, 400.0, -50.0, 0.2, -0.1, 0.05]))
    scale = np.diag([3.0, 20.0, 2.0, 0.01, 0.004, 0.002])
    roots = [scale @ np.linalg.qr(rng.normal(size=(6, 6)))[0] * rng.uniform(0.2, 1, 6) for _ in range(2)]
    files = [
        Ephemeris("x", "EME2000", "UTC", (0, SECOND), np.array([state, state]), {0: (axes_of, root @ root.T)})
        for state, root in zip((target, chaser), roots, strict=True)
    ]
    centre, spans, text = start_set(*files, 0, 2.0, rotating)
    assert np.allclose(centre, to_hill(target, chaser)) and "2 sigma" in text
    draws = rng.normal(size=(4000, 12))
    draws *= 2.0 / np.linalg.norm(draws, axis=1, keepdims=True)
    perturbed = []
    for state, root, part in zip((target, chaser), roots, (draws[:, :6], draws[:, 6:]), strict=True):
        error, (axes, omega) = part @ root.T, hill_axes(state)
        if frame != "EME2000":
            place, speed = error[:, :3], error[:, 3:]
            speed = speed + np.cross(omega, place) if rotating else speed
            error = np.hstack([place @ axes, speed @ axes])
        perturbed.append(state + error)
    inside = np.linalg.solve(spans, (to_hill(*perturbed) - centre).T)
    assert np.abs(inside).max() <= 1 + 1e-4  # of second order in the errors
    assert np.linalg.norm(inside, axis=0).max() > 0.8


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """Run folder of the scenario that two ephemerides make, with aborts to an own orbit, exported."""
    out = tmp_path_factory.mktemp("client") / "run"
    abort = '{kind="elliptical_nmt", inner_semi_minor_m=150.0, outer_semi_minor_m=260.0}'
    changes = "recoverable.recourse=none", "simulation.runs=3", f"abort={{orbit={abort}, within_s=5400.0}}"
    words = [word for change in changes for word in ("--set", change)]
    words = ["run", str(DATA / "client.toml"), "--no-figures", "--out", str(out), *words]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.stderr
    assert "note: assumption: the start set covers 3 sigma" in done.stderr
    assert "Model error: the linear model neglects at most" in done.stdout and "MORE THAN" not in done.stdout
    done = CliRunner().invoke(app, ["export", "oem", str(out)])
    assert done.exit_code == 0 and str(out / "oem" / "reference.oem") in done.stdout
    return out


def test_the_run_covers_its_model_error_and_verifies(client):
    done = CliRunner().invoke(app, ["verify", str(client)])
    assert done.exit_code == 0, done.stdout
    done = CliRunner().invoke(app, ["model-error", str(client), "--json"])
    summary = json.loads(done.stdout)
    assert done.exit_code == 0 and summary["covered"] and summary["sampled_m_s2"] < summary["bound_m_s2"]
    assert summary["parts_m_s2"]["eccentricity"] > summary["parts_m_s2"]["oblateness"] > 0
    done = CliRunner().invoke(app, ["model-error", str(client), "--set", "orbit.eccentricity_max=0.02"])
    assert done.exit_code == 5 and "TOO SMALL" in done.stdout
    done = CliRunner().invoke(app, ["model-error", str(client), "--set", "planner.gap=0.1"])
    assert done.exit_code == 2 and "keys of [orbit] only" in done.stderr


def test_exports_give_the_run_back_to_a_reader_nobody_here_wrote(client):
    pytest.importorskip("ccsds_ndm")
    target = of_ccsds_ndm(client / "oem" / "target.oem")
    flights = read_flights(client / "trajectories.npz")
    tracks = {f"{key}-{label.replace(' ', '-')}": x for key, one in flights.items()
              for label, x in zip(one.labels, one.states, strict=True)}  # fmt: skip
    for name in ("polaris-nominal", "safety-nominal", "polaris-run-0"):
        file = client / "oem" / f"{name}.oem"
        read, ephemeris = of_ccsds_ndm(file), read_oem(file)
        assert np.abs(np.array(list(read.values())) - ephemeris.states).max() < 1e-6
        relative = to_hill(np.array([target[epoch] for epoch in read]), ephemeris.states)
        assert len(relative) == len(tracks[name])
        errors = np.abs(relative - tracks[name])
        assert errors[:, :3].max() < 1e-3 and errors[:, 3:].max() < 1e-6


FORGED_ERRORS = {
    "declared": lambda error: error.update(declared_m_s2=error["declared_m_s2"] * 1.01),
    "covered": lambda error: error.update(covered=False),
    "bound": lambda error: error.update(bound_m_s2=error["bound_m_s2"] / 2),
    "parts": lambda error: error["parts_m_s2"].update(eccentricity=1.0),
    "left out": lambda error: error.clear(),
}


@pytest.mark.parametrize("name", FORGED_ERRORS)
def test_a_forged_model_error_is_refused(client, name, tmp_path):
    """A run states its model error; what contradicts scenario or certificate is refused, as is none."""
    forged = shutil.copytree(client, tmp_path / "forged")
    summary = json.loads((forged / "summary.json").read_text())
    FORGED_ERRORS[name](summary["model_error"])
    if not summary["model_error"]:
        del summary["model_error"]
    (forged / "summary.json").write_text(json.dumps(summary))
    verdict = verify(forged)
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "summary"), verdict.text()


def test_the_disturbance_bound_follows_from_a_distance_or_stays_as_given():
    source = {"elements": ELEMENTS, "within_m": 420.0}
    data = load_scenario(DATA / "client.toml").to_dict()
    del data["system"]["disturbance_max_m_s2"], data["system"]["mean_motion_rad_s"]
    data["orbit"] = AIR | source
    scenario = ScheduleScenario.from_dict(data, "here")
    w_max, least = scenario.system().w_max, float(error_within(scenario, 420.0).total)
    assert least <= w_max <= 1.1 * least and "within_m" not in scenario.to_dict()["orbit"]
    assert any(f"{w_max:g} m/s^2 covers the model error within 420 m" in line for line in scenario.derived)
    assert document(source, disturbance_max_m_s2=1e-6).system().w_max == 1e-6
    alone = scenario.to_dict()
    del alone["system"]["disturbance_max_m_s2"], alone["orbit"]["elements"]
    alone["orbit"]["within_m"] = 420.0
    assert ScheduleScenario.from_dict(alone, "here").system().w_max == w_max
    alone["horizon"] = {"duration_s": 60.0, "step_s": 2.0}
    short = ScheduleScenario.from_dict(alone, "here")  # a flight that covers it in a minute is faster
    bound = residual_bound(Environment.from_scenario(short), 420.0, 420.0, 14.0)
    assert short.system().w_max >= float(bound.total)
    del alone["system"]["mean_motion_rad_s"]
    with pytest.raises(ScenarioError, match=r"orbit\.within_m"):
        ScheduleScenario.from_dict(alone, "here")


def of_ccsds_ndm(path):
    from ccsds_ndm.ndm_io import NdmIo

    states = NdmIo().from_path(path).body.segment[0].data.state_vector
    names = ["x", "y", "z", "x_dot", "y_dot", "z_dot"]
    return {x.epoch: np.array([float(getattr(x, name).value) for name in names]) * 1e3 for x in states}


def test_exported_targets_move_as_the_model_error_has_them(client):
    """Between nodes Hermite's cubic of the file is within a millimetre; the target is that of the source."""
    source, out = read_oem(DATA / "target.oem"), read_oem(client / "oem" / "target.oem")
    assert out.epochs[0] == source.epochs[0]
    shared = [epoch for epoch in source.epochs if epoch in set(out.epochs)]
    errors = np.abs(out.states_at(shared) - source.states_at(shared))[:, :3]
    assert len(shared) > 5 and errors.max() < 0.1  # the air of the file's maker aside
    reference = read_oem(client / "oem" / "reference.oem")
    rows = np.loadtxt(client / "reference.csv", delimiter=",", skiprows=1, usecols=range(7), max_rows=60)
    epochs = [reference.epochs[0] + round(t) * SECOND for t in rows[:, 0]]
    relative = to_hill(out.states_at(epochs), reference.states_at(epochs))
    assert np.abs(relative - rows[:, 1:])[:, :3].max() < 1e-3
    branches = [read_oem(path) for path in client.glob("oem/branch-*.oem")]
    assert branches
    for branch in branches:
        assert np.allclose(branch.states[0], reference.states_at(branch.epochs[:1])[0], atol=1e-5)
        assert np.abs(branch.states[-1] - reference.states[-1]).max() > 10
