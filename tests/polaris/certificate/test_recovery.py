"""The checker's recovery argument (Proposition 11): no limit is left out, whenever it is."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest
from flint import arb

from polaris.certificate.claims.argument import Argument
from polaris.certificate.claims.arrival import Arrival
from polaris.certificate.claims.continuation import Continuation, HandOver
from polaris.certificate.claims.recovery import Recovery
from polaris.certificate.files.artefacts import FileClaims
from polaris.certificate.kernel.balls import column, identity, matrix
from polaris.certificate.kernel.motion import Plant
from polaris.certificate.kernel.verdict import Record, Rejected
from polaris.certificate.kernel.zonotopes import Zonotope
from polaris.certificate.model.craft.settling import Settling
from polaris.certificate.model.craft.tightening import SetIntersample, Tightening
from polaris.certificate.model.limits import Limits, NodeLimit
from polaris.certificate.model.transients import transient_tightening
from tests.polaris.loops import loop_of_errors

Q, CELLS, H, GAIN = 2, 16, 0.5, 2.0


def recovery(blocked=None):
    """A loop that forgets quickly, wide limits at every node, and one that nothing meets."""
    one = matrix([[1.0]])
    plant = Plant(one, one, one, one, [arb(10)], arb(0.01), arb(H))
    loop = loop_of_errors(plant, matrix([[GAIN]]))
    memory = Settling.for_craft(loop, column([arb(1)]), Q)
    wide, none = NodeLimit(0, arb(100), "wall", arb(100)), NodeLimit(0, arb(-1), "wall", arb(100))
    targets = [[[none if (cell, i) == blocked else wide] for i in range(Q + 1)] for cell in range(CELLS)]
    limits = Limits(identity(1), targets)
    document = SimpleNamespace(q=Q, steps=CELLS - 2, delta=1.0, horizon="one_period", cells=CELLS)
    return Recovery(document, limits, Tightening(loop, memory, identity(1)))


def check(found, step, after=0):
    """One set of errors, some periods after the start of a step."""
    node = step * Q + after
    found.check_sets({node: Zonotope(column([arb(0)]), identity(1))}, {node: 0.1})
    found.check_far()


@pytest.mark.parametrize("step", [0, 3])
def test_a_limit_that_nothing_meets_is_noticed_wherever_it_is(step):
    for cell in range(step, CELLS):
        for i in range(Q + 1):
            with pytest.raises(Rejected):
                check(recovery((cell, i)), step)


@pytest.mark.parametrize("cell", range(CELLS))
def test_a_flight_keeps_no_limit_that_nothing_meets_even_if_no_share_is_claimed(cell):
    """Without a claimed share the limits beyond the settling horizon are those of all sets together."""
    flight = Continuation(None, None, None)
    flight.__dict__["recovery"] = limits = recovery((cell, 1))
    assert limits.tightenings.settling.periods < (CELLS - 1) * Q
    with pytest.raises(Rejected):
        flight.keeps({0: Zonotope(column([arb(0)]), identity(1))})


def test_a_share_that_is_claimed_is_left_of_limits_beyond_the_memory_too():
    limits, start = recovery(), Zonotope(column([arb(0)]), identity(1))
    clearance = limits.tightenings.disturbed[-1][0] * 1.2 + 1e-3
    limits.limits.targets[CELLS - 3][1] = [NodeLimit(0, clearance, "wall", clearance)]
    limits.check_sets({0: start}, {0: 0.1})
    with pytest.raises(Rejected, match="0.5 claimed, for the set at 0 s, wall beyond the settling horizon"):
        limits.check_sets({0: start}, {0: 0.5})


def test_between_nodes_a_set_needs_what_its_motion_bends_however_exactly_it_is_looked_at():
    start = Zonotope(column([arb(0)]), identity(1))
    for lag in range(4):
        limits = recovery()
        exact = start.support(limits.tightenings.carried[lag])[0] + limits.tightenings.disturbed[lag][0]
        intersample = SetIntersample(limits.tightenings, start).next_to(lag)[0]
        for share, fits in ((1 + 1e-6, True), (0.99, False)):
            clearance = exact + intersample * share
            cell, place = divmod(lag, Q)
            limits.limits.targets[cell][place] = [NodeLimit(0, clearance, "wall", clearance)]
            with nullcontext() if fits else pytest.raises(Rejected, match="wall"):
                limits.check_sets({0: start}, {})


@pytest.mark.parametrize(("late", "code"), [(False, False), (True, False), (False, True)])
def test_s_takes_over_at_any_node_where_a_fault_is_isolated_late(late, code, monkeypatch):
    read = ("", SimpleNamespace(rows=[]), "double", "")  # code without the online monitor
    monkeypatch.setattr("polaris.certificate.claims.argument.read_code", lambda folder: read)
    sets_by_node, doc = {}, SimpleNamespace(modes=[1, 0, 1], q=3, transients=[{}] if late else [])
    argument = SimpleNamespace(
        document=doc, claims=FileClaims(), K=3, record=Record(), code=Path() if code else None
    )
    flight = SimpleNamespace(
        keeps=lambda reached, claimed: sets_by_node.update(reached) or 1.0,
        recovery=SimpleNamespace(nodes=9),
        tracker=SimpleNamespace(settling=SimpleNamespace(periods=1)),
    )
    Argument.recoverability(
        argument, flight, "abcd", [SimpleNamespace(nodes=each) for each in ("pq", "rs", "tu")]
    )
    within = {1: "p", 2: "q", 7: "t", 8: "u"} if late or code else {}
    assert sets_by_node == {0: "a", 3: "b", 6: "c"} | within


@pytest.mark.parametrize("node", [0, 3, 100])
def test_a_goal_is_missed_by_what_displaces_states_at_nodes_and_commands_are_not(node):
    """Jitter and carried impulses displace states (Lemma 6); S answers to what it sees."""
    tightenings, needed = recovery().tightenings, []
    start = Zonotope(column([arb(0)]), identity(1))
    for offset, jump in ((0.0, 0.0), (0.3, 0.0), (0.0, 0.2)):
        document = SimpleNamespace(
            at_nodes=[offset], feedback_bound=[], error_by_step=[], steps=2, q=3, cells=2
        )
        path, tracker = SimpleNamespace(jump=column([arb(jump)])), SimpleNamespace(craft=tightenings.craft)
        flight, hand_overs = Continuation(document, path, tracker), (HandOver(start, 6, 6),)
        arrival = Arrival(flight, hand_overs, arb(0))
        both = [
            float(flight.tightening(tightenings, hand_overs, 6 + node, around)[0]) for around in (False, True)
        ]
        needed.append((*both, float(arrival.holding(tightenings))))
    (at_node, command, holding), (at_node_off, command_off, holding_off), (jumped, more, _) = needed
    assert at_node_off >= at_node + 0.3 * (1 - 1e-12) and holding_off >= holding + 0.3 * (1 - 1e-12)
    assert command_off == command
    remaining = 0.2 * abs(float(tightenings.craft.F[0, 0])) ** node  # of a step of the reference at T
    assert jumped >= at_node + remaining * (1 - 1e-9) and more >= command + remaining * (1 - 1e-9)


def test_a_fault_may_have_been_isolated_in_any_period_since_a_hand_over():
    """Of bounds at a node the chord to the next is taken, and a period begins at either."""
    bounds = [1.0, 3.0, 2.0, 5.0, 4.0, 0.0]
    tightenings = SimpleNamespace(
        rows=identity(1),
        carried=bounds,
        boxed=lambda box, lag: [arb(bounds[lag])],
        tightening_after_settling=lambda box: [arb(0.5)],
    )
    steps = [float(largest) for (largest,) in transient_tightening(tightenings, [column([arb(1)])])]
    assert steps == [max(bounds[: lag + 3]) for lag in range(len(bounds))]


def test_everything_that_is_older_than_the_horizon_counts_to_the_last_digit():
    """A unit in every period of a scalar loop adds up to a geometric series."""
    tightenings = recovery().tightenings
    factor, periods = tightenings.craft.F[0, 0], tightenings.settling.periods
    assert (
        0 < factor < 1
        and tightenings.tail_bound(column([arb(1)]))[0] >= (factor**periods / (1 - factor)).lower()
    )


def test_wide_limits_are_met_and_what_is_over_is_over():
    limits = recovery()
    assert limits.tightenings.settling.periods < (CELLS - 3) * Q, (
        "some limits lie beyond the settling horizon"
    )
    check(limits, 0)
    check(limits, 3)
    check(recovery((1, 1)), 3)
    check(recovery((3, 0)), 3, after=1)
    with pytest.raises(Rejected):
        check(recovery((3, 2)), 3, after=1)
