"""What a run claims beside safety, against what its scenario demands and against the rest of its folder."""

import pytest

pytest.importorskip("flint")

from polaris.certificate.checker import verify
from polaris.report import write_report
from polaris.report.figures import draw_run
from polaris.runs.run import run

from .forging import QUARTER
from .tiny import TINY

CORNER = (
    "initial_set.center=[1.0,1.0,0.0,0.0]",
    'obstacles=[{kind="polytope",name="wall",normals=[[2.0,0.0]],offsets_m=[0.0],unbounded=true},'
    '{kind="polytope",name="wedge",normals=[[1.0,-1.0],[-1.0,4.0]],offsets_m=[0.0,-0.0],unbounded=true}]',
    'keep_in=[{kind="polytope",name="quadrant",normals=[[0.0,-1.0],[-1.0,3e-9]],offsets_m=[0.0,0.0]},'
    '{kind="cone",name="cone",apex_m=[0.0,0.0],axis=[1.0,1.0],half_angle_deg=80.0}]',
)
"""Every set has its facets through the origin."""


def test_a_scene_of_walls_through_the_origin_is_proven_drawn_and_verified(tmp_path):
    assignments = [QUARTER, "simulation.runs=2", "schedule.bound_programs=0", *CORNER]
    made = run(TINY, tmp_path / "run", overrides=assignments, draw=draw_run)
    assert made.summary["guarantee"]["kind"] == "proved"
    write_report(made.path)
    verdict = verify(made.path)
    assert verdict.outcome == "VERIFIED", verdict.text()
