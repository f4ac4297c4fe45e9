"""Texts of results in a session and in a notebook: a few lines, and never markup of a user."""

import dataclasses
import importlib
import inspect
import re
from html.parser import HTMLParser

import numpy as np
import pytest

import polaris
from reach.short_repr import MOST_TEXT, short
from tests.polaris.tiny import flown, synthesised
from tests.test_doors import PACKAGES

LONGEST = MOST_TEXT + 60
PUBLIC = {
    thing
    for package in PACKAGES
    for name in importlib.import_module(package).__all__
    if inspect.isclass(thing := getattr(importlib.import_module(package), name))
}
DATA = sorted(
    (one for one in PUBLIC if dataclasses.is_dataclass(one)),
    key=lambda one: (one.__module__, one.__qualname__),
)


NAMES = {one.__name__ for one in DATA}


def words(kind):
    return set(
        re.findall(r"\w+", kind if isinstance(kind, str) else getattr(kind, "__name__", "") + str(kind))
    )


def holds_much(field):
    return bool(words(field.type) & (NAMES | {"Array", "NDArray", "ndarray", "Mapping", "dict"}))


def results():
    """Dataclasses that public functions return, and those that these are made of."""
    doors = [
        getattr(importlib.import_module(package), name)
        for package in PACKAGES
        for name in importlib.import_module(package).__all__
    ]
    known = set().union(
        *(words(one.__annotations__.get("return", "")) for one in doors if inspect.isfunction(one))
    )
    while True:
        reached = [one for one in DATA if one.__name__ in known]
        more = set().union(*(words(field.type) for one in reached for field in dataclasses.fields(one)))
        if more <= known:
            return reached
        known |= more


def full(cls):
    """An object of a class, every field that may be large filled with a large array."""
    made = object.__new__(cls)
    for field in dataclasses.fields(cls):
        object.__setattr__(made, field.name, np.arange(999.0) / 7 if holds_much(field) else 1.0)
    return made


@pytest.mark.parametrize(
    "cls",
    [one for one in results() if not inspect.isabstract(one)],
    ids=lambda one: f"{one.__module__}.{one.__name__}",
)
def test_every_public_result_has_a_short_text(cls):
    if hasattr(cls, "_brief"):
        return  # of real ones, below
    made = full(cls)
    assert len(repr(made)) <= LONGEST and repr(made).count("\n") <= 3


def reachable(result, seen, depth=0):
    """All objects of these packages within a result."""
    if depth > 8 or id(result) in seen:
        return
    seen[id(result)] = result
    if dataclasses.is_dataclass(result) and not isinstance(result, type):
        parts = [getattr(result, field.name) for field in dataclasses.fields(result)]
    elif isinstance(result, dict):
        parts = list(result.values())
    else:
        parts = list(result) if isinstance(result, (tuple, list)) else []
    for part in parts:
        reachable(part, seen, depth + 1)


def test_results_and_all_public_objects_in_them_are_short():
    scenario, schedule = synthesised()
    runs = polaris.simulate(schedule, 2, 0)
    seen = {}
    reachable([scenario, schedule, flown(), runs, polaris.evaluate(runs, 0, "polaris")], seen)
    met = [one for one in seen.values() if type(one) in PUBLIC]
    assert {"Schedule", "Safety", "Runs", "Metrics", "ControllerRuns", "Reference"} <= {
        type(one).__name__ for one in met
    }
    for one in met:
        assert len(repr(one)) <= LONGEST, type(one)


class Reader(HTMLParser):
    """Tags and texts of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.texts = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)

    def handle_data(self, data):
        self.texts.append(data)


def test_a_schedule_says_what_it_claims():
    schedule = synthesised()[1]
    text, page = repr(schedule), Reader(schedule._repr_html_())
    for part in (schedule.guarantee, f"{schedule.share():.1%}", str(schedule.switches)):
        assert part in text and part in page.texts
    assert set(page.tags) == {"table", "caption", "tbody", "tr", "th", "td"}


def test_names_of_users_are_no_markup():
    evil = "<script>alert(1)</script>"
    schedule = synthesised()[1]
    controllers = tuple(dataclasses.replace(one, name=evil) for one in schedule.controllers)
    page = dataclasses.replace(schedule, controllers=controllers)._repr_html_()
    assert "<script>" not in page and any(evil in text for text in Reader(page).texts)


def test_values_are_short_whatever_they_hold():
    for value in (np.ones((99, 9)), ["x" * 999], {"k" * 999: 1}, "y" * 999, tuple(range(999)), {1, 2}, len):
        assert 0 < len(short(value)) <= 70
    assert short(np.array([1.0, 2.5])) == "[1. , 2.5]" and short(0.1234567891) == "0.123457"
