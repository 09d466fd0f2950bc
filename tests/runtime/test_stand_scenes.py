"""Poses of a base by MuJoCo: it meets nothing, its object is in reach, and a ray meets it first.

``python scripts/sweep_stand.py`` does the same for thousands of poses.
"""

from __future__ import annotations

import pytest

import navbake
from kitchens import make_kitchen
from project_paths import GOLDEN, ROOT
from stand_truth import BaseInScene

OUTLINE = [(0.25, 0.2), (-0.25, 0.2), (-0.25, -0.2), (0.25, -0.2)]
SLACK = 1e-3  # by which MuJoCo's distances may be off [m]


@pytest.mark.parametrize("scene", ["apartment", "kitchen"])
def test_bases_meet_nothing_and_reach_what_they_see(scene, tmp_path):
    path = ROOT / "configs" / "scenes" / "apartment.xml"
    if scene == "kitchen":
        path = tmp_path / "kitchen.xml"
        path.write_text(make_kitchen(2))
        grid = navbake.bake(path, agent={"height": 1.14})
    else:
        grid = navbake.load(GOLDEN / "apartment.grid.json.gz")
    base = BaseInScene(str(path), (0.5, 0.4), grid.agent_height)
    finder = navbake.PathFinder(grid.inflate(0.2))
    names = [name for name in finder.search.names.list_objects() if name in base.geoms_of]
    targets = [f"object:{name}" for name in names]
    poses = finder.stand_poses(targets, count=3, footprint=OUTLINE)
    assert len(poses) > 50
    for index, target_index in enumerate(poses.target_index.tolist()):
        name = names[target_index]
        judgement = base.judge(poses.positions[index], poses.headings[index], name)
        assert judgement.met == [], name
        assert 0.3 - SLACK <= judgement.distance <= 0.8 + SLACK, name
        assert judgement.is_seen, name
