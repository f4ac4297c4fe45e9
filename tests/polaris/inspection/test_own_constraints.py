"""Constraints of one's own: one class each, kept by the filters, judged and sampled like the paper's."""

import numpy as np
import pytest

from polaris.inspection import (
    Constraint,
    Evaluation,
    Families,
    FlightBatch,
    InitialConditions,
    Inspection,
    SampledData,
    allowable,
    build_filter,
    fly_block,
    fly_one,
)
from polaris.inspection.constraints.constraint import KINDS
from polaris.inspection.constraints.strengthening import PRESETS, Strengthening
from polaris.inspection.filters.explicit import make_filter
from polaris.inspection.flights.evaluation import least_values
from polaris.model import compiled
from polaris.model.errors import ScenarioError


class Ceiling(Constraint):
    """Nobody above 50 m cross-track."""

    label, meaning, unit, rank = "ceiling", "height cross-track", "m", 3

    def value(self, z, sun=0.0):
        return 50.0 - z[..., 2]

    def __call__(self, z, sun=0.0):
        gradient = np.broadcast_to([0, 0, -0.05, 0, 0, -1.0], z.shape)
        return Evaluation(0.05 * self.value(z) - z[..., 5], gradient, 0.0)

    def curvature(self, z, sun, motion):
        return 0.05 * motion.acceleration + motion.jerk


class Tether(Ceiling):
    """No pair farther apart than 200 m along-track."""

    label, pair, family = "tether", True, "formation"

    def value(self, z, sun=0.0):
        return 200.0**2 - z[..., 1] ** 2

    def __call__(self, z, sun=0.0):
        gradient = np.zeros(z.shape)
        gradient[..., 1], gradient[..., 4] = -0.1 * z[..., 1] - 2 * z[..., 4], -2 * z[..., 1]
        return Evaluation(0.05 * self.value(z) - 2 * z[..., 1] * z[..., 4], gradient, 0.0)

    def curvature(self, z, sun, motion):
        v, a, far = motion.speed, motion.acceleration, np.abs(z[..., 1]) + motion.speed * motion.period
        return 2 * (0.05 * (v * v + far * a) + 3 * v * a + far * motion.jerk)


class Bare(Ceiling):
    curvature = Constraint.curvature


Q = Inspection(deputies=2, constraints=(Ceiling(), Tether()))
START = np.array([[0.0, -300.0, 20.0, 0, 0, 0], [0.0, -400.0, -30.0, 0, 0, 0]])


class Upwards:
    """Full thrust up, and away from each other."""

    def __call__(self, t, x):
        return np.broadcast_to([[0.0, 1.0, 1.0], [0.0, -1.0, 1.0]], (*x.shape[:-1], 3)).copy()


def flown(q, kind, without=()):
    families = Families(q, "linear", without, SampledData(1.0))
    flights = FlightBatch(q, START[None], np.zeros(1), 80.0 if not without else 200.0, 1.0, Upwards())
    run = fly_one(flights, make_filter(families, kind))
    return least_values(run, Families(q, "linear", exact=True), 4).constraints


@pytest.mark.parametrize("loops", [True, False])
@pytest.mark.parametrize("kind", ["centralized", "consensus"])
def test_one_class_is_kept_and_judged(kind, loops, monkeypatch):
    monkeypatch.setattr(compiled, "is_enabled", lambda: loops)
    least = flown(Q, kind)
    assert list(least) == [*KINDS, "ceiling", "tether"]
    assert min(one.value for one in least.values()) >= 0
    assert least["ceiling"].value < 5 and least["tether"].value < 5000  # flown against


def test_without_them_both_are_violated():
    judged = flown(Q, "centralized", without=("ceiling", "formation"))
    assert judged["phi6"].value >= 0 and judged["ceiling"].value < 0 and judged["tether"].value < 0


@pytest.mark.parametrize("sampled", [None, SampledData(1.0)])
def test_rows_of_loops_and_formulas_agree(sampled, monkeypatch):
    rows = []
    for loops in (True, False):
        monkeypatch.setattr(compiled, "is_enabled", lambda loops=loops: loops)
        families = Families(Q, "linear", sampled=sampled, exact=True)
        assert bool(families.loops) == loops
        rows.append(families(START[None] + np.linspace(0, 9, 4)[:, None, None], np.zeros(4)))
    for name in ("h", "G", "bound"):
        np.testing.assert_allclose(getattr(rows[0], name), getattr(rows[1], name), rtol=1e-9, atol=1e-9)
    assert families.labels[-3:] == ("ceiling[0]", "ceiling[1]", "tether[0,1]")
    assert families.rank(np.ones(len(families.labels)))[-3:].tolist() == [6, 6, 6]


def test_many_flights_are_drawn_and_judged_by_them():
    q = Inspection(deputies=2, constraints=(Ceiling(),))
    families = Families(q, "linear")
    x, sun = InitialConditions(families, 0, 512).first(8)
    assert (x[..., 2] <= 50).all()
    outcome = fly_block(FlightBatch(q, x, sun, 10.0), make_filter(families, "centralized"))
    assert "ceiling" in outcome.least and outcome.columns["least_ceiling"].shape == (8,)


def with_(name, attribute):
    return Inspection(deputies=2, constraints=(type("Own", (Ceiling,), {name: attribute})(),))


def valued(value):
    """An evaluation whatever the state: `value` maps the states to the three parts."""
    return lambda self, z, sun=0.0: value(z)


WRONG = {
    "label": [5, None, b"x", "", "h1", "h5+", "phi3", "sun", "thrust", "a[0]", "\x1b[31m"],
    "family": ["speed", 3, None],
    "rank": [-1, 2.5, "x", None, np.nan, 10**30],
    "alpha": [None, 0.3, lambda h: h],
    "pair": ["no", None, np.array([1, 2])],
    "value": [
        *(
            valued(lambda z: 3.0),
            valued(lambda z: z),
            valued(lambda z: z[..., 2] < 50),
            valued(lambda z: None),
        ),
        *(valued(lambda z: 1 / 0), valued(lambda z: z[..., 2] - z[..., 2].mean())),
        valued(lambda z: np.multiply(z, 0, out=z)[..., 0]),
    ],
    "__call__": [
        valued(lambda z: Evaluation(1.0, z, 0.0)),
        valued(lambda z: Evaluation(z[..., :2], z, 0.0)),
        valued(lambda z: Evaluation(z[..., 2], z[..., :3], 0.0)),
        valued(lambda z: Evaluation(z[..., 2], z, z)),
        valued(lambda z: Evaluation(z[..., 2] + 0j, z, 0.0)),
        *(valued(lambda z: (z[..., 2], z)), valued(lambda z: None)),
    ],
    "curvature": [
        lambda self, z, *_: z,
        lambda self, z, *_: None,
        lambda self, z, sun, motion: motion.nothing,
    ],
    "sampled": [lambda self: None],
    "repeat": [0, 2],
}


@pytest.mark.parametrize(
    ("name", "wrong"), [(name, wrong) for name, every in WRONG.items() for wrong in every]
)
def test_what_is_no_constraint_is_refused_by_name(name, wrong):
    """Some ended in a TypeError of a later call, some took the name of one of the paper's."""
    with pytest.raises(ScenarioError, match=r"^constraints.*; must "):
        with_(name, wrong)


SHARED = ("centralized", "consensus", "half")
NONE = {
    "value": ("value", valued(lambda z: np.full(z.shape[:-1], np.nan))),
    "h": ("__call__", valued(lambda z: Evaluation(z[..., 2] * np.nan, z, 0.0))),
    "curvature": ("curvature", lambda self, z, sun, motion: z[..., 2] * np.nan),
    "gradient": ("__call__", valued(lambda z: Evaluation(z[..., 2], z * np.nan, 0.0))),
}


@pytest.mark.parametrize(("name", "kind"), list(zip(NONE, [*SHARED, "centralized"], strict=True)))
@pytest.mark.parametrize("loops", [True, False])
def test_what_has_no_number_for_a_state_is_short_and_the_others_are_kept(name, loops, kind, monkeypatch):
    """The program failed for all: nobody braked, and the pair came to 8 m where 10 m are asked for."""
    monkeypatch.setattr(compiled, "is_enabled", lambda: loops)
    q = with_(*NONE[name])
    f = build_filter("centralized" if kind == "centralized" else "decentralized", q, 1.0, sharing=kind)
    x, (Phi, Gamma) = np.array([[0, -300, 300.0, 0, 0, 0.1], [0, -300, 315.0, 0, 0, -0.1]]), q.discretize(1.0)
    for k in range(35):
        answer = f.filter(float(k), x, np.array([[0, 0, 1.0], [0, 0, -1.0]]))
        assert answer.missed["ceiling[0]"] == np.inf and answer.status == "short"
        x = x @ Phi.T + answer.u @ Gamma.T
        phi = allowable(q, x, q.sun_angle(k + 1.0))
        assert min(phi[one].min() for one in KINDS if one in phi) >= 0
    assert np.isnan(phi["ceiling"]).all() == (name == "value")


def test_each_has_its_own_alpha_in_a_family_and_any_sequence_will_do():
    """Of two in one family the last one's was used for both; a list ended in a TypeError when judged."""
    slow, quick = (type("Own", (Ceiling,), {"label": name, "family": "roof"})() for name in ("slow", "quick"))
    slow.alpha, quick.alpha = Strengthening((0.1, 0.0, 0.0)), Strengthening((0.9, 0.0, 0.0))
    q = Inspection(deputies=2, constraints=[slow, quick])
    rows = Families(q, "afrl")(START, np.zeros(()))
    assert rows.h[-4] == rows.h[-2] and rows.bound[-4] > rows.bound[-2]
    functions = {**PRESETS["linear"], "roof": slow.alpha}
    bound = Families(q, functions)(START, np.zeros(())).bound
    assert bound[-4] == bound[-2] == rows.bound[-4]
    assert {"slow", "quick"} <= {*allowable(q, START, 0.0)}


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Families(Inspection(constraints=(Bare(),)), sampled=SampledData(1.0)), "curvature"),
        (lambda: build_filter("explicit", Q), "custom constraints need a barrier filter"),
        (lambda: Inspection(constraints=(Ceiling(), Ceiling())), "labels, each different"),
        (lambda: Inspection(constraints=(Ceiling,)), "must be a Constraint"),
        (lambda: build_filter("central", Q), "must be one of"),
        (lambda: Families(Q, without=("roof",)), "must be one of .*formation"),
    ],
)
def test_what_cannot_be_is_refused(make, match):
    with pytest.raises(ScenarioError, match=match):
        make()
