"""Texts of results in a session and in a notebook: a few lines, and never markup of a user."""

import dataclasses
import html
import importlib
import inspect
import re

import numpy as np

import polaris
from reach.short_repr import MOST_TEXT, short
from tests.polaris.tiny import flown, synthesised
from tests.test_doors import PACKAGES

LONGEST = MOST_TEXT + 60
DOORS = [importlib.import_module(package) for package in PACKAGES]
PUBLIC = {thing for door in DOORS for name in door.__all__ if inspect.isclass(thing := getattr(door, name))}


def reachable(result, by_id, depth=0):
    """All objects of these packages within a result."""
    if depth > 8 or id(result) in by_id:
        return
    by_id[id(result)] = result
    if dataclasses.is_dataclass(result) and not isinstance(result, type):
        parts = [getattr(result, field.name) for field in dataclasses.fields(result)]
    elif isinstance(result, dict):
        parts = list(result.values())
    else:
        parts = list(result) if isinstance(result, (tuple, list)) else []
    for part in parts:
        reachable(part, by_id, depth + 1)


def test_results_and_all_public_objects_in_them_are_short():
    scenario, schedule = synthesised()
    runs = polaris.simulate(schedule, 2, 0)
    by_id = {}
    reachable([scenario, schedule, flown(), runs, polaris.evaluate(runs, 0, "polaris")], by_id)
    public = [one for one in by_id.values() if type(one) in PUBLIC]
    names = {type(one).__name__ for one in public}
    assert {"Schedule", "Safety", "Runs", "Metrics", "ControllerRuns", "Reference"} <= names
    for one in public:
        assert len(repr(one)) <= LONGEST, type(one)


def test_a_schedule_says_what_it_claims_and_names_of_users_are_no_markup():
    schedule, evil = synthesised()[1], "<script>alert(1)</script>"
    controllers = tuple(dataclasses.replace(one, name=evil) for one in schedule.controllers)
    text, page = repr(schedule), dataclasses.replace(schedule, controllers=controllers)._repr_html_()
    for part in (schedule.guarantee, f"{schedule.share():.1%}", str(schedule.switches)):
        assert part in text and f">{part}<" in page
    assert set(re.findall(r"<(\w+)", page)) == {"table", "caption", "tbody", "tr", "th", "td"}
    assert html.escape(evil) in page


def test_values_are_short_whatever_they_hold():
    for value in (np.ones((99, 9)), ["x" * 999], {"k" * 999: 1}, "y" * 999, tuple(range(999)), {1, 2}, len):
        assert 0 < len(short(value)) <= 70
    assert short(np.array([1.0, 2.5])) == "[1. , 2.5]" and short(0.1234567891) == "0.123457"
