"""Assumptions of a proof: one list on the screen, in the summary, the report and the certificate."""

import json
import tomllib
from functools import cache

import pytest

from polaris.certificate.assumptions import Assumptions
from polaris.certificate.files.document import Document, digest
from polaris.certificate.kernel.verdict import Rejected
from polaris.cli.show.schedule import show_summary
from polaris.report.html.run_report import guarantee_section as told_in_report
from polaris.runs.certificate import certificate
from polaris.runs.schedule import SCHEDULE, FlownSchedule
from polaris.scenario.scenario import load_scenario
from polaris.synthesis.schedule.synthesize import synthesize
from tests.kept import CHOSEN
from tests.polaris.conftest import synthesised
from tests.polaris.tiny import TINY, flown

SATELLITE = {
    "kind": "satellite",
    "name": "other",
    "state": [2.0, 9.0, 0.0, 0.0],
    "state_half_widths": [0.0] * 4,
    "radius_m": 0.5,
    "thrust_accel_max_m_s2": 1e-3,
}


@cache
def scene(name):
    """Scenario and schedule of variants of the tiny scene."""
    if name == "static":
        return synthesised("static", CHOSEN)
    data = tomllib.loads(TINY.read_text(encoding="utf-8"))
    if name == "satellite only":
        data["obstacles"] = [SATELLITE]
    if name == "satellite":
        data["obstacles"].append(SATELLITE)
    if name == "at rest, sampled":
        del data["obstacles"][1]
        data["feedback"] = {"period_s": 0.1}
    scenario = type(load_scenario(TINY)).from_dict(data)
    return scenario, synthesize(scenario)


def words(lines):
    return [line.split(":")[0] for line in lines]


@pytest.mark.parametrize(
    ("name", "rest", "others", "last"),
    [
        ("tiny", True, False, "after T: the safety controller flies on until "),
        ("satellite", True, True, "after T: the safety controller flies on until "),
        ("satellite only", False, True, "after T: the safety controller flies on until "),
        ("at rest, sampled", True, False, "after T: the safety controller flies on for ever"),
        ("static", True, False, "after T: the safety controller flies on for ever"),
    ],
)
def test_those_that_apply_and_no_others_are_said_everywhere_in_the_same_words(name, rest, others, last):
    scenario, schedule = scene(name)
    said = list(schedule.assumptions)
    assert ("sets at rest" in words(said), "other satellites" in words(said)) == (rest, others)
    assert {"model", "position", "initial state", "chaser", "perception", "sampling", "clocks"} <= set(
        words(said)
    )
    assert said[-2].startswith(last) and said[-1].startswith("arithmetic: ")
    data = certificate(schedule, scenario.name)
    assert data["assumptions"] == said[:-1]
    assert Document(data).assumptions == said[:-1]


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


@pytest.mark.parametrize("name", ["tiny", "satellite", "static"])
def test_a_certificate_that_leaves_one_out_is_rejected(name):
    scenario, schedule = scene(name)
    data = certificate(schedule, scenario.name)
    for i, line in enumerate(data["assumptions"]):
        changed = json.loads(json.dumps(data))
        del changed["assumptions"][i]
        changed["digest"] = digest(changed)
        if line.startswith("other satellites"):
            rejected_beside(scenario, changed)
            continue
        with pytest.raises(Rejected, match="assumptions"):
            Document(changed)


def test_satellites_that_are_none_need_no_assumption():
    scenario, schedule = scene("tiny")
    data = certificate(schedule, scenario.name)
    safety = schedule.safety
    end = {"horizon": "one_period", "until": safety.end.until}
    premises = Assumptions(
        0.02, schedule.safety.tracking.flow.h, satellites=True, position=safety.problem.system.C, **end
    )
    data["assumptions"] = premises.sentences()
    data["digest"] = digest(data)
    rejected_beside(scenario, data)


def rejected_beside(scenario, data):
    """Only the scenario tells whether there are satellites: the certificate alone may say either."""
    pytest.importorskip("flint")
    from polaris.certificate.model.perception import check_unsafe

    with pytest.raises(Rejected, match="assumptions: the scenario has"):
        check_unsafe(Document(data), tomllib.loads(scenario.to_toml()))


def test_nothing_is_said_of_time_after_t_where_nothing_is_claimed():
    assert Assumptions(0.0, 1.0).sentences()[-1] == "fuel: enough for every command up to T"
    assert "until 5 s" in Assumptions(0.0, 1.0, horizon="one_period", until=5.0).sentences()[-1]
