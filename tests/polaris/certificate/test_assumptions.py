"""Assumptions of a proof: one list on the screen, in the summary, the report and the certificate."""

import tomllib
from functools import cache
from types import SimpleNamespace

import pytest

from polaris.certificate.assumptions import Assumptions
from polaris.certificate.claims import coasting
from polaris.certificate.files.document import Document, digest
from polaris.certificate.kernel.verdict import Rejected
from polaris.certificate.model.perception import check_unsafe
from polaris.cli.show.schedule import show_summary
from polaris.report.html.run_report import guarantee_section as told_in_report
from polaris.report.sentences import reach
from polaris.runs.certificate import certificate
from polaris.runs.schedule import SCHEDULE, FlownSchedule
from polaris.scenario.scenario import ScheduleScenario
from polaris.synthesis.schedule.synthesize import synthesize
from tests.kept import CHOSEN
from tests.polaris.conftest import synthesised
from tests.polaris.tiny import TINY, flown

SATELLITE = {"kind": "satellite", "name": "other", "state": [2.0, 9.0, 0.0, 0.0]}
SATELLITE |= {"state_half_widths": [0.0] * 4, "radius_m": 0.5, "thrust_accel_max_m_s2": 1e-3}


@cache
def scene(name):
    """Scenario and schedule of variants of the tiny scene."""
    if name == "static":
        return synthesised("static", CHOSEN)
    data = tomllib.loads(TINY.read_text(encoding="utf-8"))
    if name == "satellite only":
        data["obstacles"] = [SATELLITE]
    if name == "at rest, sampled":
        data = data | {"obstacles": data["obstacles"][:1], "feedback": {"period_s": 0.1}}
    scenario = ScheduleScenario.from_dict(data)
    return scenario, synthesize(scenario)


@pytest.mark.parametrize(
    ("horizon", "until", "text"),
    [
        ("infinite", None, "for all time"),
        ("one_period", 7050.0, "until 7050 s (end of the schedule, then one period under S)"),
        ("none", 1800.0, "until 1800 s (end of the schedule)"),
    ],
)
def test_run_and_checker_have_one_phrase_for_the_end_of_a_claim(horizon, until, text, monkeypatch):
    claim = {"horizon": horizon, "until_s": until}
    monkeypatch.setattr(coasting, "_closes", lambda *_: None)
    document = SimpleNamespace(horizon=horizon, claim_end=until, steps=10, cells=12)
    assert reach(claim) == text == coasting.check_end(document, None)


UNTIL, EVER = (f"after T: the safety controller flies on {how}" for how in ("until ", "for ever"))


@pytest.mark.parametrize(
    ("name", "rest", "others", "last"),
    [
        ("tiny", True, False, UNTIL),
        ("satellite only", False, True, UNTIL),
        ("at rest, sampled", True, False, EVER),
        ("static", True, False, EVER),
    ],
)
def test_those_that_apply_and_no_others_are_said_in_the_same_words(name, rest, others, last):
    """A certificate that leaves one out, or speaks of satellites that are none, is rejected."""
    scenario, schedule = scene(name)
    lines = list(schedule.assumptions)
    words = {line.split(":")[0] for line in lines}
    assert ("sets at rest" in words, "other satellites" in words) == (rest, others)
    assert {"model", "position", "initial state", "chaser", "perception", "sampling", "clocks"} <= words
    assert lines[-2].startswith(last) and lines[-1].startswith("arithmetic: ")
    data = certificate(schedule, scenario.name)
    assert data["assumptions"] == lines[:-1]
    assert Document(data).assumptions == lines[:-1]
    for i, line in enumerate(lines[:-1]):
        if not line.startswith("other satellites"):
            with pytest.raises(Rejected, match="assumptions"):
                restated(data, lines[:i] + lines[i + 1 : -1])
    safety = schedule.safety
    end = {"horizon": data["horizon"], "until": safety.end.until, "position": safety.problem.system.C}
    if name in (
        "tiny",
        "satellite only",
    ):  # the certificate alone may say either, but not beside its scenario
        w_max, h = safety.problem.system.w_max, safety.tracking.flow.h
        other = Assumptions(w_max, h, resting=rest, satellites=not others, **end).sentences()
        pytest.importorskip("flint")
        with pytest.raises(Rejected, match="assumptions: the scenario has"):
            check_unsafe(restated(data, other), tomllib.loads(scenario.to_toml()))


def restated(data, assumptions):
    """Return the document with other assumptions."""
    data = data | {"assumptions": assumptions}
    return Document(data | {"digest": digest(data)})


def test_screen_and_report_say_all_of_them(capsys):
    scenario, schedule = scene("tiny")
    result = {
        "title": scenario.title,
        **SCHEDULE.to_summary(scenario, FlownSchedule(schedule, flown()), {"total": 1.0}),
    }
    show_summary(result, "folder")
    screen, page = capsys.readouterr().out, told_in_report(result["guarantee"])
    for line in schedule.assumptions:
        assert f"  - {line}\n" in screen
        assert line.replace("'", "&#39;").replace("<", "&lt;") in page or line in page
