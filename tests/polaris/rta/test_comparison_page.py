"""The comparison page: defaults follow from the sweep, words from the tables, and all can be flown again."""

import math
import re

import pytest

from benchmarks import comparison as page
from docs.generate import method_docs
from polaris.rta.methods import METHODS
from tests.kept import scheduled
from tests.polaris.rta.scenes import scene
from tests.sizes import fewer

TEXT = page.PAGE.read_text(encoding="utf-8")
TABLES = page.blocks(TEXT)
SWEEP = page.SWEEP.read_text(encoding="utf-8")
MONITOR, SCHEDULE = "Polaris online monitor", "Polaris schedule"
EXPLICIT, IMPLICIT, AHEAD = "Explicit ASIF", "Implicit ASIF", "Look-ahead by simulation"
SHARE, COST, HITS = "Share of U", "Delta-v m/s", "Violations"
ROWS = {"monitor": MONITOR, "asif_explicit": EXPLICIT, "asif_implicit": IMPLICIT, "simulation": AHEAD}
ROWS |= {"simplex_explicit": "Explicit simplex", "simplex_implicit": "Implicit simplex"}
ROWS |= {"reachability": "Forward reachability of U"}
NUMBER = r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?"


def rows(table):
    """Cells of a scene's table, by method and column."""
    head, _, *lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
    assert tuple(head) == page.COLUMNS
    return {cells[0]: dict(zip(head[1:], cells[1:], strict=True)) for cells in lines}


def value(name, method, column):
    """The number of one cell, a mean without its interval."""
    matches = {key: row for key, row in rows(TABLES[name]).items() if key.startswith(method)}
    assert matches, (name, method)
    cells = next(iter(matches.values()))
    return float(cells[column].split(" ± ")[0])


def test_the_page_holds_every_table():
    written = method_docs.tables()
    assert set(TABLES) == {*written, *page.SCENES}
    assert "](figures/comparison-sweep.csv)" in TEXT
    assert {name: TABLES[name] for name in written} == written, "run: python -m docs.generate.method_docs"
    for name in page.SCENES:
        row_count = len(rows(TABLES[name]))
        assert row_count >= len(METHODS), (name, "run: python -m benchmarks.comparison --write")


def test_defaults_are_what_the_sweep_of_the_page_says():
    swept, defaults = page.read_sweep(SWEEP)
    assert set(swept) == set(page.SWEPT), "run: python -m benchmarks.comparison --write"
    assert page.RUNS == page.SWEPT_RUNS
    ours = {"safety", "experimental", "schedule", "code", "monitor", "monitor_code", "monitor_declared"}
    rivals = set(METHODS) - ours
    buffered = {key for key, one in METHODS.items() if any(each.name == "buffer" for each in one.options)}
    assert rivals == buffered, "give a rival the option BUFFER, or add a method that needs none to `ours`"
    tuned = {key for key, one in METHODS.items() if one.options}
    tried = {name.partition(".")[0] for name in swept} | {"monitor_declared"}
    assert tried == tuned, "run: python -m benchmarks.comparison --write"
    grid = scene("robot")
    for full, values in swept.items():
        assert list(values) == page.VALUES[full]
        assert page.chosen(values) == defaults[full]
        method = METHODS[full.partition(".")[0]](grid)
        for option, value in zip(page.SWEPT[full], defaults[full], strict=True):
            assert page.standing(grid, method, option) == pytest.approx(value), full
            assert option is not page.BUFFER or option.default == "0" and value == 0
            if option.name == "buffer" and value:
                assert option.default == f"{value:g} {option.unit}"
    assert METHODS["monitor_declared"](grid).settings == METHODS["monitor"](grid).settings


def test_scenes_have_a_row_for_a_value_that_is_better_there():
    swept, _ = page.read_sweep(SWEEP)
    for name in page.SCENES:
        for full, values in swept.items():
            best, (key, _, option) = page.own(values, name), full.partition(".")
            marked = [row for row in rows(TABLES[name]) if row.startswith(f"{ROWS[key]}, {option} = ")]
            assert len(marked) == (best is not None), (name, full, best)


def ratio(name, one, other, column):
    return value(name, one, column) / value(name, other, column)


def test_the_words_of_the_page_follow_from_its_tables():
    """Proven methods hit nothing, the monitor is worth flying, and look-ahead needs its buffer."""
    swept, defaults = page.read_sweep(SWEEP)
    proving = {one.name for one in METHODS.values() if one.proven}
    for name, share, switches, cost in (("static", 0.91, 10, 1.2), ("dynamic", 0.94, 6, 1.5)):
        assert value(name, MONITOR, SHARE) >= share
        assert value(name, MONITOR, "Switches") <= switches and value(name, MONITOR, COST) <= cost
    for name in page.SCENES:
        for row in (AHEAD, "Forward reachability", "Implicit simplex"):
            assert value(name, row, HITS) == 0
        more = value(name, MONITOR, SHARE) - value(name, SCHEDULE, SHARE)
        assert -0.045 < more < -0.035 if name == "static" else 0 < more < 0.03
        assert 0.97 < ratio(name, MONITOR, SCHEDULE, COST) < (1.1 if name == "dynamic" else 1.03)
        assert ratio(name, IMPLICIT, MONITOR, COST) == pytest.approx(1, abs=0.03)
        assert max(value(name, f"{kind} simplex", SHARE) for kind in ("Explicit", "Implicit")) < 0.35
        proven = [row for key, row in rows(TABLES[name]).items() if key in proving]
        assert proven and all(row[HITS] == "0" for row in proven)
    others = [row for row in rows(TABLES["static"]) if not row.startswith(("U alone", EXPLICIT))]
    assert all(ratio("static", row, "S alone", COST) == pytest.approx(1, abs=0.1) for row in others)
    for name in ("static", "dynamic"):
        assert ratio(name, EXPLICIT, MONITOR, COST) == pytest.approx(2, rel=0.1)
    lookahead, (horizon, _) = swept["simulation.horizon, buffer"], defaults["simulation.horizon, buffer"]
    assert all(cells["static"].violations for (_, buffer), cells in lookahead.items() if not buffer)
    near = [cells["robot"].violations for (far, _), cells in lookahead.items() if far == horizon / 2]
    plain = next(iter(swept["simplex_implicit.buffer"].values()))
    assert set(near) == {page.RUNS} and page.RUNS / 2 < plain["robot"].violations < page.RUNS


def compare(table, real, tolerance=0.05):
    """Tables agree, number by number: counts of a few runs to one in ten, the rest to five per cent."""
    assert [line.count("|") for line in table.splitlines()] == [line.count("|") for line in real.splitlines()]
    for one, other in zip(table.splitlines(), real.splitlines(), strict=True):
        one, other = (re.sub(r" ± [\d.e+-]+", "", line.replace("*", "")) for line in (one, other))
        assert re.sub(NUMBER, "", one) == re.sub(NUMBER, "", other)
        for ours, theirs in zip(re.findall(NUMBER, one), re.findall(NUMBER, other), strict=True):
            assert math.isclose(float(ours), float(theirs), rel_tol=tolerance, abs_tol=0.02), (one, other)


@pytest.mark.slow
@pytest.mark.parametrize("name", page.SCENES)
def test_a_scenes_table_is_flown_again(name):
    swept, _ = page.read_sweep(SWEEP)
    settings = {key: page.own(values, name) for key, values in swept.items()}
    tuned = {key: best for key, best in settings.items() if best is not None}
    table, _ = page.scene_table(scheduled(name)[1], page.RUNS, tuned)
    compare(TABLES[name], table)


@pytest.mark.slow
@pytest.mark.parametrize("name", page.SCENES)
def test_the_sweep_is_flown_again(name, monkeypatch):
    """Every value on one scene, or on all, but for the longest look-aheads and the largest buffers."""
    for key, options in page.SWEPT.items():
        for i, limit in ((i, {"horizon": 0.2, "buffer": 0.2}.get(one.name)) for i, one in enumerate(options)):
            if limit is not None and len(options) > 1:
                monkeypatch.setitem(page.VALUES, key, [at for at in page.VALUES[key] if at[i] <= limit])
        one_in = fewer(1, 2 * len(page.SCENES))
        some = page.VALUES[key][page.SCENES.index(name) % one_in :: one_in]
        monkeypatch.setitem(page.VALUES, key, some)
    swept_now = page.sweep({name: scheduled(name)[1]}, page.SWEPT_RUNS)
    swept, _ = page.read_sweep(SWEEP)
    for key, values in swept_now.items():
        for setting, cells in values.items():
            printed, real = swept[key][setting][name], cells[name]
            assert printed.violations == pytest.approx(real.violations, abs=1), (key, setting)
            assert printed.share == pytest.approx(real.share, abs=0.02), (key, setting)
            assert printed.delta_v == pytest.approx(real.delta_v, rel=0.05), (key, setting)
            assert printed.deviation == pytest.approx(real.deviation, rel=0.05), (key, setting)
