"""Unsafe certificates made to look safe, with hashes and digest right: none is verified."""

import hashlib
import json
import shutil
from types import SimpleNamespace

import pytest

import polaris
from polaris.certificate.checker import verify, verify_document
from polaris.certificate.files.document import canonical, digest
from polaris.certificate.kernel.verdict import Rejected, Undecided
from polaris.certificate.model.perception import _check_cone, _check_keep_in
from polaris.runs.certificate import certificate
from tests.kept import CHOSEN
from tests.polaris.conftest import synthesised as bundled
from tests.polaris.corruptions import scaled
from tests.polaris.tiny import TINY


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out, variant = tmp_path_factory.mktemp("runs") / "forged", ["tracking.R=[60, 60]", "simulation.runs=2"]
    return polaris.run(TINY, out, overrides=variant).path


@pytest.fixture
def forge(run, tmp_path):
    """Copy of the run folder and its certificate; the second function writes it with all hashes right."""
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    data = json.loads((folder / "certificate.json").read_text())

    def finish(rehash=True):
        for name in data["artefacts"] if rehash else ():
            data["artefacts"][name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
        data["digest"] = digest(data)
        (folder / "certificate.json").write_text(canonical(data))
        return verify(folder)

    return folder, data, finish


@pytest.mark.parametrize("factor", [0.0, 2.0**30, 2.0**-50, 1 + 1e-6])
def test_facets_without_unit_normals_are_refused(forge, factor):
    _, data, finish = forge
    item = data["unsafe_sets"][0]
    item["normals"][0] = scaled(item["normals"][0], factor)
    for row in (row for pair in item["offsets"] for row in pair):
        row[0] = scaled(row[0], factor)
    for row in data["facets"]:
        row[0] = 0
    verdict = finish()
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "unsafe_sets")


@pytest.mark.parametrize("named", [{}, {"nowhere.txt": "00"}])
def test_a_run_folder_is_compared_whatever_the_certificate_names(forge, named):
    _, data, finish = forge
    data["artefacts"] = named
    verdict = finish(rehash=False)
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "artefacts")


@pytest.mark.parametrize("value", [-1.2e-3, 0.0])
def test_a_mean_motion_that_is_not_positive_is_refused(value):
    scenario, schedule = bundled("static", CHOSEN)
    data = json.loads(canonical(certificate(schedule, scenario.name)))
    data["system"]["mean_motion"] = float(value).hex()
    data["digest"] = digest(data)
    verdict = verify_document(data)
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "format")


@pytest.mark.parametrize("name", ["a\nVERIFIED in 1.0 s", "\udc80", "\x1b[2J", 7])
def test_names_that_do_not_print_are_refused(forge, name):
    data = forge[1]
    data["scenario"]["name"] = name
    data["digest"] = digest(data)
    assert verify_document(data).claim == "format"


@pytest.mark.parametrize("text", ["NaN", "Infinity", "1e999"])
def test_numbers_and_versions_that_are_none_are_refused(forge, text):
    folder, data, _ = forge
    (folder / "certificate.json").write_text(canonical(data)[:-1] + f',"more":{text}}}')
    assert (verify(folder).outcome, verify(folder).claim) == ("REJECTED", "format")
    for version in (True, 2.0, "2"):
        data["schema_version"] = version
        data["digest"] = digest(data)
        assert verify_document(data).outcome == "UNKNOWN"


CONE = {"name": "cone", "axis": [1.0, 0.0, 0.0], "apex_m": [0.0, 0.0, 0.0], "half_angle_deg": 30.0}


def cone_rows(angle_deg, facets=12, turns=1):
    """Outward normals of a pyramid inside a circular cone about x."""
    from math import atan, cos, pi, radians, sin, tan

    half = atan(tan(radians(angle_deg)) * cos(pi * turns / facets))
    around = [2 * pi * turns * f / facets for f in range(facets)]
    return [[-sin(half), cos(half) * cos(a), cos(half) * sin(a)] for a in around]


FLAT = {"name": "wedge", "axis": [1.0, 0.0], "apex_m": [0.0, 0.0], "half_angle_deg": 30.0}


def test_pyramids_inside_a_cone_are_accepted():
    for rows in (cone_rows(30.0), cone_rows(20.0), cone_rows(30.0, 3), cone_rows(30.0)[::-1]):
        _check_cone(rows, [0.0] * len(rows), CONE)
    _check_cone([[-0.5, 0.75**0.5], [-0.5, -(0.75**0.5)]], [0.0, 0.0], FLAT)


@pytest.mark.parametrize(
    ("rows", "cone"),
    [
        (cone_rows(31.0), CONE),  # wide
        (cone_rows(30.0, 7, turns=2), CONE),  # a star
        (cone_rows(30.0)[:5], CONE),  # open
        ([cone_rows(30.0)[f] for f in (0, 2, 1, *range(3, 12))], CONE),  # in disorder
        ([[-4e-10, 1.0, 0.0], [4e-10, 0.9, 0.19**0.5], [4e-10, 0.9, -(0.19**0.5)]] * 4, CONE),  # a pencil
        ([[-1.0, 0.0, 0.0]] * 12, CONE),  # repeated
        ([[0.0, -1.0]] * 2, FLAT),
        ([[-0.5, 0.75**0.5]] * 2, FLAT),
    ],
    ids=range(8),
)
def test_pyramids_that_leave_the_cone_are_not(rows, cone):
    with pytest.raises((Rejected, Undecided)):
        _check_cone(rows, [0.0] * len(rows), cone)


def test_rounding_of_a_normal_never_widens_a_keep_in_set():
    def check(row, offset):
        item = SimpleNamespace(name="room[0]", normals=[[-x for x in row]], start=[[-offset]])
        _check_keep_in(SimpleNamespace(C=((1.0, 0.0), (0.0, 1.0))), [item], spec)

    spec = {"name": "clearance", "kind": "polytope", "normals": [[0.0, 1.0]], "offsets_m": [-5000.0]}
    with pytest.raises(Rejected):
        check([5e-10, 1.0], 1e6)
    check([0.0, 1.0], -5000.0)
