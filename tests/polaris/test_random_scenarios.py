"""Random scenarios from the file to the verdict: they are proved or refused in one message, and proofs verify."""

from collections import Counter

import pytest

pytest.importorskip("flint")

from polaris.certificate.checker import verify
from polaris.errors import PolarisError
from polaris.runfolder import write_run
from polaris.scenario import load_scenario

from .random_scenarios import random_scenario, synthesised

FEW = (9, 11, 14, 34, 60, 135)
"""A share of everything: late limits, nothing claimed after T, a tail shorter than the memory, a clipped law."""

MANY = 160
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
        yield seed, schedule, verify(write_run(folder / f"run-{seed}", scenario, schedule, figures=False).path)


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
        seen.update([f"system {model.system.kind}", f"start {model.initial_set.kind}", f"goal {model.goal.kind}"])
        seen.update([model.feedback.kind, model.recoverable.kind, model.schedule.strategy])
        seen.update(f"unsafe {part.kind}" for part in (*model.obstacles, *model.keep_in))
        seen.update(f"law {part.kind}" for part in model.experimental)
    assert len(seen) >= 22 and min(seen.values()) >= 1, seen


def test_a_few_random_proofs_verify(tmp_path):
    found = list(verdicts(FEW, tmp_path))
    assert sum(schedule is not None and schedule.guarantee == "proved" for _, schedule, _ in found) >= 5
    judge(found)


@pytest.mark.slow
def test_a_hundred_random_proofs_verify(tmp_path):
    found = list(verdicts(range(MANY), tmp_path))
    judge(found)
    proved = [schedule for _, schedule, _ in found if schedule and schedule.guarantee == "proved"]
    assert len(proved) >= 100
    mixed = sum(0 < schedule.share() < 1 for schedule in proved)
    assert mixed >= len(proved) / 3, "U flies a part of the time in many of them"
    plants = Counter(schedule.safety.problem.system.n for schedule in proved)
    ends = Counter(schedule.safety.end.horizon for schedule in proved)
    kinds = Counter(schedule.safety.recoverable.kind for schedule in proved)
    assert len(plants) >= 6 and set(ends) == {"infinite", "one_period", "none"} and len(kinds) == 3
