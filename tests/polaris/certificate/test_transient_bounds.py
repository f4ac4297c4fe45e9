"""The checker's bounds on faults that are isolated late, against those of the synthesis, fault by fault.

The synthesis' own bounds are flown against in `tests/polaris/synthesis/sources/test_transients.py`.
"""

import copy
import json
from contextlib import suppress
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import flint
import numpy as np
import pytest

from polaris import Tracking, load_scenario, synthesize
from polaris.certificate.claims.argument import Argument
from polaris.certificate.claims.continuation import Tracker
from polaris.certificate.files.document import Document, digest
from polaris.certificate.kernel.balls import column, identity
from polaris.certificate.kernel.verdict import Record, Rejected
from polaris.certificate.kernel.zonotopes import Zonotope
from polaris.certificate.model.craft.tightening import difference_along
from polaris.certificate.model.transients import check_transients, transient_tightening
from polaris.certificate.model.transients import wrong_thrust as checked_thrust
from polaris.runs.certificate import certificate, hexadecimal
from polaris.runs.files.controllers import system_table
from polaris.scenario.scenario import scenario_folder
from polaris.synthesis.sources.late_faults import wrong_thrust
from tests.polaris.tiny import TINY

SOFT = ("tracking.R=[60.0,90.0]", "feedback.period_s=0.25", "system.input_max=[1.0,0.8]")
LOSS = 'faults=[{kind="loss",share=0.1,isolation_s=0.6}]'
LOST = 'faults=[{kind="navigation_lost",lasts_s=1.1}]'
CAMERA = "navigation.measurement={matrix=[[1,0,0,0],[0,1,0,0]],error=[0.002,0.001]}"
FIXED = CAMERA.replace("]}", "],constant_share=0.8}")
ESTIMATE = "navigation.state_error=[0.002,0.002,0.0004,0.0004]"
WRONG = ("thrusters.magnitude_error=0.05", "thrusters.mass_error=0.03")
SPRINGS = "system.A=[[0,0,1,0],[0,0,0,1],[-6,0,0,0],[0,-8,0,0]]"
NETWORK = (
    f'experimental=[{{kind="neural",name="hasty",path="{scenario_folder()}/policies/hasty.onnx",'
    'inputs=["error"],output_scale_N=1.0,reference={kind="shared"}}]'
)

SCENES = {
    "thrust": [LOSS, *WRONG],
    "thrust, delay": [LOSS, *WRONG, "timing.delay_s=0.3"],
    "thrust, missed periods": [LOSS, *WRONG, "timing.missed_periods=2"],
    "thrust, delay and missed periods": [LOSS, *WRONG, "timing.delay_s=0.3", "timing.missed_periods=1"],
    "thrust, jitter": [LOSS, "timing.jitter_s=0.02"],
    "thrust, pulses": [LOSS, *WRONG, "thrusters.pulse=start", "thrusters.fall_s=0.03"],
    "thrust, springs": [LOSS, *WRONG, SPRINGS, "goal.state=[0,0,0,0]"],
    "thrust, camera": [LOSS, *WRONG, CAMERA],
    "thrust, network": [LOSS, NETWORK],
    "thrust, network in float32": [LOSS, NETWORK.replace('"hasty",', '"hasty",precision="float32",')],
    "navigation": [LOST, *WRONG],
    "navigation, delay and missed periods": [
        *(LOST, *WRONG, ESTIMATE),
        *("timing.delay_s=0.3", "timing.missed_periods=1"),
    ],
    "navigation, pulses": [LOST, ESTIMATE, "thrusters.pulse=staggered", "thrusters.impulse_bit_N_s=0.01"],
    "camera": [LOST, CAMERA, *WRONG],
    "constant camera, delay": [LOST, FIXED, "timing.delay_s=0.25"],
    "camera, missed periods": [LOST, CAMERA, *WRONG, "timing.missed_periods=1"],
    "camera, delay and missed periods": [LOST, CAMERA, "timing.delay_s=0.25", "timing.missed_periods=2"],
}
"""Assignments by name."""


@pytest.fixture(autouse=True)
def precision():
    with flint.ctx.workprec(128):
        yield


@cache
def base(*laws):
    """Certificate of a scene without faults."""
    return certificate(synthesize(load_scenario(TINY).with_assignments([*SOFT, *laws])), "tiny")


def document(problem, *laws):
    """Build the document of a scene without faults, with a problem's system in place of its own."""
    data = copy.deepcopy(base(*laws)) | {"system": hexadecimal(system_table(problem))}
    data["controllers"][0]["gain"] = hexadecimal(problem.gain)
    if not laws:
        data["controllers"][1]["gain"] = hexadecimal(problem.system.transients[0].gains)
    unfinished = Document.__new__(Document)
    for assumptions in (lambda: data["assumptions"], lambda: unfinished.assumptions):
        data["assumptions"] = assumptions()
        data["digest"] = digest(data)
        with suppress(Rejected):  # assumptions of the first round are those of the scene without faults
            unfinished.__init__(json.loads(json.dumps(data)))
    return unfinished


def entries(M):
    return np.array([float(x.upper()) for x in M.entries()])


def close(derived, expected, share=6e-3):
    """The checker's bounds are those of the synthesis, and never above them: an honest run is confirmed."""
    assert np.all(derived <= expected * (1 + 1e-9) + 1e-12) and np.all(derived >= expected * (1 - share))


@pytest.mark.parametrize("name", SCENES)
def test_effects_of_a_fault_are_those_that_the_synthesis_bounds(name):
    problem = load_scenario(TINY).with_assignments([*SOFT, *SCENES[name]]).problem()
    tracking = Tracking(problem.system, problem.gain, problem.feedback, problem.delta)
    laws = [text for text in SCENES[name] if text.startswith("experimental")]
    argument, (fault,) = Argument(document(problem, *laws), Record()), problem.system.transients
    start = argument.craft.start(Zonotope(column([0.0] * 4), identity(4) * 0.05))
    tracker = Tracker.from_sets(argument.document, argument.craft, argument.upsets, [start])
    if len(fault.pushes):
        expected = wrong_thrust(problem.system, fault, problem.gain, tracking.loop)
        boxes = [entries(box) for box in argument.upsets]
    else:
        every = np.eye(tracking.loop.N)
        expected = [each.support(every) for each in tracking.transients]
        boxes = [entries(column(difference_along(identity(len(every)), each))) for each in tracker.outages]
    assert np.max(expected, axis=0)[:4].min() > 0
    close(np.max(boxes, axis=0), np.max(expected, axis=0), 2e-8 if laws else 6e-3)
    expected = tracking.transient_tightening(np.eye(4))
    derived = np.array([[float(x) for x in row] for row in tracker.tightenings("rows", identity(4)).fault])
    later = np.minimum(np.arange(len(derived)) + 2, len(expected) - 1)  # nodes that are next to a period
    assert np.all(derived <= expected[later] * (1 + 1e-9)) and np.all(derived >= expected[later] * 0.93)


def test_a_black_box_may_answer_a_fault_with_any_command():
    problem = load_scenario(TINY).with_assignments([*SOFT, LOSS, *WRONG]).problem()
    argument, (fault,) = Argument(document(problem), Record()), problem.system.transients
    loop = Tracking(problem.system, problem.gain, problem.feedback, problem.delta).loop
    expected = wrong_thrust(problem.system, replace(fault, boxes=True), problem.gain, loop)
    safety, law = argument.document.laws
    argument.document.laws = [safety, replace(law, kind="black_box", gain=None)]
    boxes = [entries(box) for box in checked_thrust(argument.document, argument.craft, [])]
    close(np.max(boxes, axis=0), np.max(expected, axis=0))
    assert np.all(np.max(boxes, axis=0) > 1.2 * np.max([entries(box) for box in argument.upsets], axis=0))


def faulty(transients, **more):
    """Part of a document with late faults."""
    fields = {"allocation": {"directions": [[1.0, 0.0], [0.6, -0.8]], "limits": [2.0, 1.0], "layout": False}}
    fields |= {"u_max": [1.0, 1.0], "pulse_place": ""} | more
    return SimpleNamespace(transients=transients, **fields)


WEAK = {"kind": "loss", "share": 0.5, "isolation_s": 0.4}
OUTAGE = {"kind": "navigation_lost", "lasts_s": 2.0}
PUSHED = {"name": "loss", "lasts": 0.4, "pushes": [[1.0, 0.0], [0.3, 0.4]]}
UNSEEN = {"name": "navigation_lost", "lasts": 2.0}


def test_faults_must_be_those_of_the_scenario_with_what_every_thruster_may_do():
    scenario = {"faults": [WEAK, {"kind": "stuck_off"}, OUTAGE]}
    honest = [PUSHED, UNSEEN]
    check_transients(faulty(honest), scenario)
    check_transients(faulty([UNSEEN], allocation=None), {"faults": [OUTAGE]})
    doubled = [{**PUSHED, "pushes": (2 * np.array(PUSHED["pushes"])).tolist()}, UNSEEN]
    check_transients(faulty(doubled, pulse_place="staggered"), scenario)
    for transients, more, text in (
        ([PUSHED], {}, "isolated late"),
        ([{**PUSHED, "lasts": 0.3}, UNSEEN], {}, "isolated late"),
        ([PUSHED, {**UNSEEN, "lasts": 1.0}], {}, "isolated late"),
        ([{**PUSHED, "name": "stuck_off"}, UNSEEN], {}, "isolated late"),
        ([UNSEEN, PUSHED], {}, "isolated late"),
        ([{"name": "loss", "lasts": 0.4}, UNSEEN], {}, "belongs to thrusters"),
        ([PUSHED, {**UNSEEN, "pushes": [[1.0, 1.0]]}], {}, "belongs to thrusters"),
        ([{**PUSHED, "pushes": [[1.0, 0.0]]}, UNSEEN], {}, "not covered"),
        ([{**PUSHED, "pushes": [[1.0, 0.0], [0.3, 0.39]]}, UNSEEN], {}, "not covered"),
        (honest, {"pulse_place": "staggered"}, "not covered"),
    ):
        with pytest.raises(Rejected, match=text):
            check_transients(faulty(transients, **more), scenario)


def test_a_tightening_holds_what_is_larger_two_periods_on_or_after_settling():
    """A fault ends up to two periods after a hand-over, and any number of periods before a node."""
    needs, nothing = [1.0, 5.0, 2.0, 7.0, 3.0], identity(1)
    for settled, bounds in (
        (0.0, [5.0, 7.0, 7.0, 7.0, 7.0]),
        (6.0, [6.0, 7.0, 7.0, 7.0, 7.0]),
        (9.0, [9.0] * 5),
    ):
        rows = SimpleNamespace(
            rows=nothing,
            carried=[nothing] * len(needs),
            boxed=lambda box, lag: [flint.arb(needs[lag])],
            tightening_after_settling=lambda box, settled=settled: [flint.arb(settled)],
        )
        tightening = transient_tightening(rows, [nothing])
        assert [float(x) for (x,) in tightening] == bounds
