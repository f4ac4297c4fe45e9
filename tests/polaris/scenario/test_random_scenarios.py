"""Random scenarios from the file to the verdict: proved, or refused in one message; proofs verify."""

import json
import tomllib
from collections import Counter
from contextlib import nullcontext

import numpy as np
import pytest

pytest.importorskip("flint")

import flint

from polaris.certificate.checker import verify, verify_document
from polaris.certificate.claims.argument import Argument
from polaris.certificate.claims.coasting import check_end
from polaris.certificate.files.document import Document, digest
from polaris.certificate.kernel.balls import PRECISION
from polaris.certificate.kernel.verdict import Record, Rejected
from polaris.model.errors import PolarisError
from polaris.runs.certificate import certificate
from polaris.runs.schedule import write_run
from polaris.scenario.reading import write_toml
from polaris.scenario.scenario import load_scenario
from polaris.synthesis.schedule.synthesize import synthesize
from tests.kept import CHOSEN, printed
from tests.polaris.corruptions import restate
from tests.polaris.random_scenarios import random_scenario, synthesised
from tests.polaris.tiny import synthesised as tiny
from tests.sizes import fewer

FEW = (2, 2001, 5006, 5034)
MERGED = 3015
"""Among them: a tail shorter than the memory, clipped laws, balls; nothing is claimed after T in 36, below.

2001 has a clipped step whose enclosures with other slopes do not contain one another, the slow one many
generators to merge.
"""

MANY = fewer(160, 40)
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


def test_random_scenes_are_valid_files(tmp_path):
    counts, path = Counter(), tmp_path / "scene.toml"
    for seed in range(40):
        path.write_text(random_scenario(seed), encoding="utf-8")
        model = load_scenario(path).model
        counts.update(
            [f"system {model.system.kind}", f"start {model.initial_set.kind}", f"goal {model.goal.kind}"]
        )
        counts.update([f"period {model.feedback.period_s is not None}", model.recoverable.kind])
        counts.update(f"unsafe {part.kind}" for part in (*model.obstacles, *model.keep_in))
        counts.update([model.schedule.strategy, *(f"law {part.kind}" for part in model.experimental)])
    assert len(counts) >= 22, counts


def cut(data, cells=None):
    """A copy of a certificate with its digest, its reference and sets cut to a number of cells."""
    copy = json.loads(json.dumps(data))
    copy["reference"]["states"] = copy["reference"]["states"][: None if cells is None else cells + 1]
    for table, key in ((copy["reference"], "inputs"), (copy, "facets"), (copy, "weights")):
        table[key] = table[key][:cells]
    for item in copy["unsafe_sets"]:
        item["offsets"] = item["offsets"][:cells]
    copy["digest"] = digest(copy)
    return copy


def judge_end(data, reason=""):
    """Let the checker judge the end alone: it passes, or is refused for a reason."""
    with (
        flint.ctx.workprec(PRECISION),
        pytest.raises(Rejected, match=reason) if reason else nullcontext() as no,
    ):
        argument = Argument(Document(data), Record())
        check_end(argument.document, argument.reference())
    assert not reason or no.value.claim == "end"


@pytest.mark.slow
def test_a_reference_at_rest_may_end_sooner_than_the_loop_forgets_but_must_rest(tmp_path):
    scenario, schedule = synthesised(38, tmp_path)
    data, K = certificate(schedule, scenario.name), schedule.safety.problem.K
    assert schedule.safety.end.horizon == "infinite"
    assert verify_document(cut(data, K + 1)).outcome == "VERIFIED"
    judge_end(cut(data, K), "come to rest")


def test_a_closed_orbit_is_safe_for_ever_only_after_a_whole_turn():
    scenario, schedule = printed("static", CHOSEN)
    data = certificate(schedule, scenario.name)
    assert schedule.safety.end.horizon == "infinite"
    judge_end(data)
    judge_end(cut(data, len(data["facets"]) - 1), "less than one turn")


def test_nothing_is_safe_for_ever_where_a_set_moves():
    scenario, schedule = tiny()
    data = certificate(schedule, scenario.name)
    assert data["horizon"] == "one_period"
    judge_end(data)
    data["horizon"] = "infinite"
    restate(data)
    judge_end(cut(data), "unsafe sets move: trolley")


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


@pytest.mark.parametrize("seeds", [(0,), pytest.param(range(1, fewer(250, 40)), marks=pytest.mark.slow)])
def test_clipped_proofs_verify(seeds, tmp_path):
    proofs = dict(clipped_verdicts(seeds, tmp_path))
    assert proofs
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
