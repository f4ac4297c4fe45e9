"""Random scenarios from the file to the verdict: proved, or refused in one message; proofs verify."""

import json
import tomllib
from collections import Counter
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

pytest.importorskip("flint")

import flint

from polaris.certificate.checker import verify, verify_document
from polaris.certificate.claims.argument import ORDER, Argument
from polaris.certificate.claims.coasting import check_end
from polaris.certificate.files.artefacts import FileClaims
from polaris.certificate.files.document import Document, digest
from polaris.certificate.kernel.balls import PRECISION
from polaris.certificate.kernel.verdict import Record, Rejected
from polaris.certificate.kernel.zonotopes import Merging
from polaris.model.errors import PolarisError
from polaris.runs.certificate import certificate
from polaris.runs.schedule import write_run
from polaris.scenario.reading import write_toml
from polaris.scenario.scenario import load_scenario
from polaris.synthesis.schedule.synthesize import synthesize
from tests.kept import CHOSEN, printed
from tests.polaris.corruptions import restate
from tests.polaris.random_scenarios import random_scenario, synthesised
from tests.polaris.synthesis.tracker.test_margins import worst_share
from tests.polaris.tiny import synthesised as tiny
from tests.sizes import fewer

FEW = (2, 2001, 5006, 5034)
MERGED = 3015
"""Among them: a tail shorter than the memory, clipped laws, balls; nothing is claimed after T in 36, below.

2001 has a clipped step whose enclosures with other slopes do not contain one another, the slow one many
generators to merge.
"""

MANY = fewer(160, 60)
"""Scenes of the slow test."""


def verdicts(seeds, folder):
    """Seed, schedule and verdict of every scene that ends in a run folder; refusals are counted."""
    for seed in seeds:
        try:
            scenario, schedule = synthesised(seed, folder)
        except PolarisError as error:
            assert error.exit_code in (2, 3, 4), seed
            yield seed, None, error
            continue
        yield (seed, schedule, verify(write_run(folder / f"run-{seed}", scenario, schedule).path))


def judge(found):
    """Every proved run is verified."""
    refused = {seed: verdict.text() for seed, schedule, verdict in found if schedule and verdict.exit_code}
    assert not refused, "\n".join(f"random-{seed}:\n{text}" for seed, text in refused.items())


def test_a_seed_gives_one_scene():
    assert random_scenario(5) == random_scenario(5) != random_scenario(6)


def test_random_scenes_are_valid_files(tmp_path):
    seen = Counter()
    for seed in range(40):
        path = tmp_path / "scene.toml"
        path.write_text(random_scenario(seed), encoding="utf-8")
        model = load_scenario(path).model
        seen.update(
            [f"system {model.system.kind}", f"start {model.initial_set.kind}", f"goal {model.goal.kind}"]
        )
        seen.update(
            [f"period {model.feedback.period_s is not None}", model.recoverable.kind, model.schedule.strategy]
        )
        seen.update(f"unsafe {part.kind}" for part in (*model.obstacles, *model.keep_in))
        seen.update(f"law {part.kind}" for part in model.experimental)
    assert len(seen) >= 22 and min(seen.values()) >= 1, seen


def altered(data, change):
    """A copy of a certificate, changed in place by a function, with its digest."""
    copy = json.loads(json.dumps(data))
    change(copy)
    copy["digest"] = digest(copy)
    return copy


def changed(data, change):
    """Verdict on such a copy."""
    return verify_document(altered(data, change))


def end_of(data):
    """Let the checker judge the end alone; raises as it does."""
    with flint.ctx.workprec(PRECISION):
        argument = Argument(Document(data), Record())
        check_end(argument.document, argument.reference())


@cache
def document(seed):
    """(schedule, certificate) of a random scene."""
    with TemporaryDirectory() as folder:
        scenario, schedule = synthesised(seed, Path(folder))
    return schedule, certificate(schedule, scenario.name)


@pytest.mark.slow
def test_a_tolerance_that_both_sides_bound_differently_is_no_reason_to_refuse(tmp_path):
    """The synthesis bounds what S needs for ever 1.24 times as high as the checker here."""
    errors = ["thrusters.magnitude_error=0.00462", "thrusters.mass_error=0.00549"]
    errors += ["thrusters.impulse_bit_N_s=0.0039", "thrusters.remainder=carried"]
    errors += ["navigation.state_error=[0.003353,0.000428,0.000586]", "tracking.thrust_share=0.908"]
    rest = ["recoverable.recourse=none", "schedule.bound_programs=0"]
    scenario, schedule = synthesised(430, tmp_path, *errors, *rest)
    verdict = verify(write_run(tmp_path / "run", scenario, schedule).path)
    assert verdict.outcome == "VERIFIED", verdict.text()


@pytest.mark.slow
def test_a_reference_at_rest_may_end_sooner_than_the_loop_forgets_but_must_rest():
    schedule, data = document(38)
    assert schedule.safety.end.horizon == "infinite"
    K = schedule.safety.problem.K

    def cut(tail):
        def change(copy):
            copy["reference"]["states"] = copy["reference"]["states"][: K + tail + 1]
            copy["reference"]["inputs"] = copy["reference"]["inputs"][: K + tail]
            copy["facets"], copy["weights"] = copy["facets"][: K + tail], copy["weights"][: K + tail]
            for item in copy["unsafe_sets"]:
                item["offsets"] = item["offsets"][: K + tail]

        return altered(data, change)

    assert verify_document(cut(1)).outcome == "VERIFIED"
    with pytest.raises(Rejected, match="come to rest") as refused:
        end_of(cut(0))
    assert refused.value.claim == "end"


def test_a_closed_orbit_is_safe_for_ever_only_after_a_whole_turn():
    scenario, schedule = printed("static", CHOSEN)
    assert schedule.safety.end.horizon == "infinite"

    def change(copy):
        copy["reference"]["states"], copy["reference"]["inputs"], copy["facets"] = (
            part[:-1] for part in (copy["reference"]["states"], copy["reference"]["inputs"], copy["facets"])
        )
        for item in copy["unsafe_sets"]:
            item["offsets"] = item["offsets"][:-1]

    data = certificate(schedule, scenario.name)
    end_of(data)
    with pytest.raises(Rejected, match="less than one turn") as refused:
        end_of(altered(data, change))
    assert refused.value.claim == "end"


def test_nothing_is_safe_for_ever_where_a_set_moves():
    scenario, schedule = tiny()
    data = certificate(schedule, scenario.name)
    assert data["horizon"] == "one_period"
    end_of(data)

    def change(copy):
        copy["horizon"] = "infinite"
        restate(copy)

    with pytest.raises(Rejected, match="unsafe sets move: trolley"):
        end_of(altered(data, change))


@pytest.mark.slow
def test_no_margin_beyond_what_is_left_is_accepted_however_late_its_limit():
    schedule, data = document(10)
    late = [k for k, step in enumerate(schedule.steps) if step.mode and is_late(schedule, k, step.margin)]
    assert late
    k = late[0]
    claimed, margins = worst_share(schedule, k, 1) + 0.03, [0.0] * len(schedule.steps)
    margins[k] = float(claimed)
    argument = Argument(Document(data), Record(), FileClaims(margins=margins))
    with pytest.raises(Rejected) as refused:
        argument.flights(argument.reference(), Merging(ORDER, argument.n, argument.craft.ahead))
    assert 0 < claimed < 1 and refused.value.claim == "margins"


def is_late(schedule, k, margin):
    """Return True if what limits a step lies beyond the settling horizon."""
    tracking = schedule.safety.tracking
    return margin.time > (k + 1) * tracking.delta + tracking.settling * tracking.flow.h


def test_a_few_random_proofs_verify(tmp_path):
    proofs = list(verdicts(FEW[:2], tmp_path))
    assert sum(schedule is not None and schedule.guarantee == "proved" for _, schedule, _ in proofs) == 2
    judge(proofs)


def clipped_verdicts(seeds, folder):
    """Seed and verdict of proved scenes whose thrusters may clip, their gains being far higher."""
    for seed in seeds:
        rng, model = np.random.default_rng(seed + 10**6), tomllib.loads(random_scenario(seed))
        for law in model["experimental"]:
            if law["kind"] == "any_thrust":
                law |= {key: model["tracking"][key] for key in ("Q", "R")}
            law["kind"] = "saturated_affine"
            if "R" in law:
                law["R"] = [weight / 10 ** rng.uniform(0, 2) for weight in law["R"]]
            else:
                law["gain"] = [[2 * x for x in row] for row in law["gain"]]
        model.setdefault("recoverable", {})["recourse"] = "none"  # with U in view it need not clip
        path = folder / "clipped.toml"
        path.write_text(write_toml(model), encoding="utf-8")
        try:
            scenario = load_scenario(path)
            schedule = synthesize(scenario)
        except PolarisError:
            continue
        if schedule.guarantee == "proved" and any(step.tube.slopes is not None for step in schedule.steps):
            yield seed, verify_document(certificate(schedule, scenario.name))


def test_clipped_proofs_verify(tmp_path):
    proofs = dict(clipped_verdicts((0,), tmp_path))
    assert len(proofs) == 1
    assert {seed: verdict.text() for seed, verdict in proofs.items() if verdict.exit_code} == {}


@pytest.mark.slow
def test_many_clipped_proofs_verify(tmp_path):
    seeds = range(fewer(250, 80))
    proofs = dict(clipped_verdicts(seeds, tmp_path))
    assert len(proofs) >= fewer(20, 0.03 * len(seeds))
    assert {seed: verdict.text() for seed, verdict in proofs.items() if verdict.exit_code} == {}


@pytest.mark.slow
def test_many_random_proofs_verify(tmp_path):
    proofs = list(verdicts((*range(MANY), *FEW[1:], MERGED), tmp_path))
    judge(proofs)
    proved = [schedule for _, schedule, _ in proofs if schedule and schedule.guarantee == "proved"]
    assert len(proved) >= fewer(100, MANY // 2)
    mixed = sum(0 < schedule.share() < 1 for schedule in proved)
    assert mixed >= len(proved) / 3, "U flies a part of the time in many of them"
    plants = Counter(schedule.safety.problem.system.n for schedule in proved)
    ends = Counter(schedule.safety.end.horizon for schedule in proved)
    kinds = Counter(schedule.safety.recoverable.kind for schedule in proved)
    assert len(plants) >= fewer(6, 4) and set(ends) == {"infinite", "one_period", "none"} and len(kinds) == 2
