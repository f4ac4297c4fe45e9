"""Compiled loops against the formulas in NumPy, their oracle; without numba, the loops as they stand."""

import importlib.util

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import asif
from polaris.inspection.closest import TOLERANCE
from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.motion import SampledData
from polaris.inspection.inspection import Inspection
from polaris.model import compiled
from polaris.model.version import versions
from polaris.rta import nearest
from polaris.rta.projection import FILTERED, PRIMAL, project_coupled
from tests.polaris.inspection.test_filters import situation

NUMBA = importlib.util.find_spec("numba") is not None
EXAMPLES = 25 if NUMBA else 2  # as the loops stand, a plain run takes a fifth of them
needs_numba = pytest.mark.skipif(not NUMBA, reason="numba (the extra `fast`) is not installed")


def both(make):
    """Make one with the loops, compiled or as they stand, and one without them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "is_enabled", lambda: True)
        looped = make()
        patch.setattr(compiled, "is_enabled", lambda: False)
        plain = make()
    assert looped.loops is not None and plain.loops is None
    return looped, plain


def drawn(seed, deputies, wide):
    """A random problem, and states and suns of it, one near the centre, where directions fade."""
    rng = np.random.default_rng(seed)
    q = Inspection(
        deputies=deputies,
        mean_motion=rng.uniform(5e-4, 1.2e-3),
        field_of_view=rng.uniform(0.2, 2.0),
        passive_time=rng.uniform(50.0, 900.0),
        deputy_radius=rng.uniform(1.0, 8.0),
    )
    x, sun, _ = situation(seed, R=8)
    x = np.tile(x, (1, 2, 1))[:, 2 : 2 + deputies] * rng.uniform(0.8, 1.2, (8, deputies, 1))
    x[0, 0, :3] *= 0.01 if wide else 1e-6
    return q, x, sun, rng


@given(seed=st.integers(0, 10**6), deputies=st.integers(1, 4), wide=st.booleans(), known=st.booleans())
@settings(max_examples=EXAMPLES)
def test_rows_for_sampled_data_are_those_of_the_formulas(seed, deputies, wide, known):
    q, x, sun, rng = drawn(seed, deputies, wide)
    sampled = SampledData(rng.uniform(0.2, 5.0), rng.uniform(0.1, 1.0))
    looped, plain = both(lambda: Families(q, sampled=sampled))
    inputs = rng.uniform(-1, 1, (8, deputies, 3)) if known else None
    a, b = looped(x, sun, inputs), plain(x, sun, inputs)
    for one, other in ((a.h, b.h), (a.G, b.G), (a.bound, b.bound)):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-11)  # inf where it is inf, too
    one = looped(x[3], sun[3], None if inputs is None else inputs[3])
    assert np.array_equal(one.bound, a.bound[3])


@pytest.mark.parametrize("exact", [False, True])
@given(seed=st.integers(0, 10**6), deputies=st.integers(1, 4), wide=st.booleans())
@settings(max_examples=EXAMPLES)
def test_rows_are_those_of_the_formulas(exact, seed, deputies, wide):
    q, x, sun, _ = drawn(seed, deputies, wide)
    looped, plain = both(lambda: Families(q, exact=exact))
    a, b = looped(x, sun), plain(x, sun)
    # A closest approach may be found at another time, as near but for the tolerance: another gradient.
    passive = plain.among("passive", "deputy_passive")
    np.testing.assert_allclose(a.h[:, ~passive], b.h[:, ~passive], rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(a.h, b.h, rtol=1e-9, atol=2 * TOLERANCE)
    same_time = ~passive | (np.abs(a.h - b.h) < 1e-12)
    size = 1 + np.abs(b.G).max(axis=-1)
    assert (np.abs(a.G - b.G).max(axis=-1) / size)[same_time].max() < 1e-9
    assert (np.abs(a.bound - b.bound) / (1 + np.abs(b.bound)))[same_time].max() < 1e-9
    one = looped(x[3], sun[3])  # leading axes are kept
    assert np.array_equal(one.h, a.h[3]) and one.G.shape == b.G[3].shape


@given(seed=st.integers(0, 10**6), coupled=st.booleans())
@settings(max_examples=4 * EXAMPLES)
def test_programs_are_answered_as_by_the_solver_or_left(seed, coupled):
    rng = np.random.default_rng(seed)
    N, M = (3, 12) if coupled else (1, 6)
    first = rng.integers(0, N, M)
    second = np.where(rng.random(M) < 0.5, (first + 1) % N, -1) if coupled else np.full(M, -1)
    G = rng.standard_normal((1, M, 3)) * 10 ** rng.uniform(-3, 1, (1, M, 1))
    if rng.random() < 0.3:  # rows that nearly say the same
        G[0, 1], first[1], second[1] = G[0, 0] * (1 + 1e-9 * rng.standard_normal(3)), first[0], second[0]
    bound = rng.uniform(-1.5, 0.6, (1, M)) * np.linalg.norm(G, axis=2)
    desired = rng.uniform(-1, 1, (1, N, 3)) * 10 ** rng.uniform(-1, 3)
    u, status, unsolved = nearest.coupled(G, bound, first, second, desired, 1.0)
    expected = project_coupled(G, bound, np.clip(desired, -1.0, 1.0), 1.0, first, second)
    if expected.status[0] != FILTERED:
        assert unsolved == 1 and (status == nearest.LEFT).all()
    elif not unsolved:
        np.testing.assert_allclose(u, expected.u, atol=1e-8)
        relative = u[0, first] - np.where(second[:, None] >= 0, u[0, second], 0.0)
        length = np.linalg.norm(G[0], axis=1) * np.where(second >= 0, 2.0, 1.0) ** 0.5
        assert ((bound[0] - (G[0] * relative).sum(axis=1)) / length).max() <= 2 * PRIMAL
        assert np.abs(u).max() <= 1.0


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # as they stand, the loops say so
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_is_left(bad):
    G, bound, desired = np.diag([1.0, 1.0, -1.0])[None], np.full((1, 3), 0.5), np.zeros((1, 1, 3))
    index = np.zeros(3, dtype=int), np.full(3, -1)
    for values in (G, bound, desired):
        original = values.copy()
        values[0, 0] = bad
        u, status, unsolved = nearest.coupled(G, bound, *index, desired, 1.0)
        solvable = values is bound and bad == -np.inf or values is desired and abs(bad) == np.inf  # clipped
        assert unsolved == (not solvable) and (solvable or (status == nearest.LEFT).all())
        values[:] = original


@pytest.mark.slow
def test_the_command_prints_a_table(capsys):
    """One deputy's row, of two calls."""
    asif.main(["--only", "0", "--calls", "2", "--turns", "1"])
    head, row = capsys.readouterr().out.splitlines()
    assert head.split()[:2] == ["filter", "N"] and row.split()[:2] == ["centralized", "1"]
    assert len(row.split()) == (8 if NUMBA else 5)


def test_the_switch(monkeypatch):
    monkeypatch.setenv("POLARIS_COMPILED", "0")
    assert Families(Inspection(deputies=1)).loops is None and versions()["numba"] == "not used"
    monkeypatch.setenv("POLARIS_COMPILED", "1")
    assert (Families(Inspection(deputies=1)).loops is not None) == NUMBA
    assert (versions()["numba"] != "not used") == NUMBA
