"""Corrupted certificates, their digest recomputed: every one is rejected, and the right claim is named."""

from functools import cache

import pytest

from polaris.certificate.checker import verify_document
from polaris.runs.certificate import certificate
from polaris.runs.schedule import write_run
from polaris.scenario.scenario import load_scenario
from polaris.synthesis.schedule.synthesize import synthesize
from tests.polaris.corruptions import Corruptor, against_files, inner, malformed
from tests.polaris.forging import QUARTER
from tests.polaris.tiny import TINY


@cache
def soft():
    """The tiny scene with a softer tracker, which flies U in the middle too: (scenario, schedule)."""
    scenario = load_scenario(TINY).with_assignments(["tracking.R=[60, 60]", "simulation.runs=2", QUARTER])
    return scenario, synthesize(scenario)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_run(tmp_path_factory.mktemp("runs") / "soft", *soft()).path


@cache
def alone():
    """A certificate without the files of a run folder."""
    scenario, schedule = soft()
    return Corruptor(certificate(schedule, scenario.name))


def beside(folder):
    scenario, schedule = soft()
    files = [path for path in folder.iterdir() if path.name not in ("summary.json", "certificate.json")]
    return Corruptor(certificate(schedule, scenario.name, sorted(files)))


def judge(cases, folder=None):
    """Number of cases, all of which are rejected for one of the right claims."""
    wrong, labels = [], set()
    for label, data, claims in cases:
        verdict = verify_document(data, folder)
        labels.add(label)
        if verdict.outcome != "REJECTED" or verdict.claim not in claims:
            wrong.append(f"{label}: {verdict.outcome} {verdict.claim} {verdict.witness}")
    assert not wrong
    return len(labels)


PARTS = [0, *(pytest.param(part, marks=pytest.mark.slow) for part in range(1, 9))]


@pytest.mark.parametrize("part", PARTS)
def test_the_argument_notices(part):
    assert judge(list(inner(alone()))[part::9]) >= 19


def test_the_other_files_give_it_away(folder):
    assert judge(against_files(beside(folder)), folder) >= 70
    assert judge(malformed(alone())) >= 60


def test_blind_edits_are_refused_by_the_digest(folder):
    assert verify_document(alone().data).outcome == "VERIFIED"
    assert verify_document(beside(folder).data, folder).outcome == "VERIFIED"
    assert set(alone().data["modes"]) == {0, 1}
    data = alone().changed("reference", "inputs", 0, 0, to=(0.1).hex())
    verdict = verify_document(data | {"digest": alone().data["digest"]})
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "digest")


@pytest.mark.parametrize(
    "name", ["scenario.toml", "schedule.json", "reference.csv", "gains.json", "tubes.npz"]
)
def test_an_edited_file_is_noticed(folder, name):
    data, before = beside(folder).data, (folder / name).read_bytes()
    (folder / name).write_bytes(before + b"\n")
    try:
        verdict = verify_document(data, folder)
    finally:
        (folder / name).write_bytes(before)
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "artefacts")
