"""Corrupted certificates, their digest recomputed: every one is rejected, and the right claim is named."""

from functools import cache

import pytest

pytest.importorskip("flint")

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
    """Labels of the cases that are not rejected for one of the right claims."""
    wrong, count = [], 0
    for label, data, claims in cases:
        verdict = verify_document(data, folder)
        count += 1
        if verdict.outcome != "REJECTED" or verdict.claim not in claims:
            wrong.append(f"{label}: {verdict.outcome} {verdict.claim} {verdict.witness}")
    return count, wrong


def test_the_uncorrupted_ones_verify(folder):
    assert verify_document(alone().data).outcome == "VERIFIED"
    assert verify_document(beside(folder).data, folder).outcome == "VERIFIED"


def test_modes_of_both_kinds_are_flown():
    assert set(alone().data["modes"]) == {0, 1}


def part_of_inner(part):
    return [case for i, case in enumerate(inner(alone())) if i % 9 == part]


def test_the_argument_notices():
    count, wrong = judge(part_of_inner(0))
    assert not wrong
    assert count >= 19


@pytest.mark.slow
@pytest.mark.parametrize("part", range(9))
def test_the_argument_notices_the_rest(part):
    count, wrong = judge(part_of_inner(part))
    assert not wrong
    assert count >= 19


def test_they_are_more_than_two_hundred(folder):
    cases = [*inner(alone()), *against_files(beside(folder)), *malformed(alone())]
    assert len({label for label, _, _ in cases}) >= 200


def test_the_other_files_give_it_away(folder):
    count, wrong = judge(against_files(beside(folder)), folder)
    assert not wrong
    assert count >= 70


def test_what_is_malformed_is_rejected():
    count, wrong = judge(malformed(alone()))
    assert not wrong
    assert count >= 60


def test_blind_edits_are_refused_by_the_digest():
    data = alone().changed("reference", "inputs", 0, 0, to=(0.1).hex())
    data["digest"] = alone().data["digest"]
    verdict = verify_document(data)
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "digest")


@pytest.mark.parametrize(
    "name", ["scenario.toml", "schedule.json", "reference.csv", "gains.json", "tubes.npz"]
)
def test_an_edited_file_is_noticed(folder, name):
    before = (folder / name).read_bytes()
    (folder / name).write_bytes(before + b"\n")
    try:
        verdict = verify_document(beside_of(folder, name, before).data, folder)
    finally:
        (folder / name).write_bytes(before)
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "artefacts")


def beside_of(folder, name, before):
    """The certificate as it was before a file was edited."""
    edited = (folder / name).read_bytes()
    (folder / name).write_bytes(before)
    made = beside(folder)
    (folder / name).write_bytes(edited)
    return made
