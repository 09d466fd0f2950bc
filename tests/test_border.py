"""Small files of strangers that once had no end, filled the memory or ended in a traceback.

The small inputs are in `shared/data/reports/border`; tests of each reader make others of the same
kinds, so that they run where that folder is missing.
"""

from __future__ import annotations

import time

import pytest

import navbake
from command_line import run_command
from navbake.auditor.routes import audit_routes
from navbake.errors import NavbakeError
from navbake.formats.route_files import read_routes
from navbake.formats.scene_files import find_inputs
from project_paths import GOLDEN, SHARED_DATA

BORDER = SHARED_DATA / "reports" / "border"
pytestmark = pytest.mark.skipif(not BORDER.is_dir(), reason="no reports")

# a command, in which BORDER is the folder and OUT a file -> what stderr says; exit status 1
REFUSED = [
    ("bake BORDER/merge.building.yaml -o OUT.json", "aliases repeat more than 100,000 values"),
    ("bake BORDER/re_uri.sdf -o OUT.json", "line 1: expected </uri>, got </sdf>"),
    ("bake BORDER/matmul.usda -o OUT.json", "has coordinates that are no numbers"),
    ("batch BORDER/nul_min.txt -o OUT", r"a\x00/b.xml' at"),
    ("batch BORDER/nul_min.txt -o OUT --plan", r"a\x00/b.xml' at"),
    ("convert BORDER/alias_rmf.yaml OUT.json --from rmf --to lif", "aliases repeat more than"),
    ("convert BORDER/sur_min.yaml OUT.json --from rmf --to lif", "invalid Unicode character"),
    ("convert BORDER/cast_rmf.yaml OUT.json --from rmf --to lif", "coordinates within 1e+10 m"),
    (
        "convert BORDER/tiny_level.geojson OUT.json --from nav2-route --to lif",
        "a level from 0 to 999 of node '0'",
    ),
]


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(("command", "reason"), REFUSED, ids=[text for text, _ in REFUSED])
def test_it_is_one_line_within_a_second(tmp_path, capsys, command, reason):
    if "usda" in command:
        pytest.importorskip("pxr")
    words = [word.replace("BORDER", str(BORDER)) for word in command.split()]
    words = [word.replace("OUT", str(tmp_path / "out")) for word in words]
    begin = time.process_time()
    status, out, err = run_command(capsys, *words)
    took = time.process_time() - begin
    assert (status, out, len(err.splitlines())) == (1, "", 1)
    assert reason in err and took < 2  # a slow machine included
    assert not [*tmp_path.iterdir()]  # nothing is half-written


def test_of_a_batch_whose_scenes_are_equal_none_is_read_for_long(tmp_path):
    begin = time.process_time()
    assert find_inputs(BORDER / "re_uri.sdf") == [BORDER / "re_uri.sdf"]
    assert time.process_time() - begin < 1


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_huge_numbers_are_no_warning():
    level = navbake.from_grscenes(BORDER / "cast_grscenes.npy")
    assert (level.height, level.width) == (24, 26)
    grid = navbake.load(GOLDEN / "house.grid.json.gz")
    with pytest.raises(NavbakeError, match="coordinates within 1e\\+10 m, got 1e\\+30"):
        audit_routes(BORDER / "cast_rmf.yaml", grid)
    with pytest.raises(NavbakeError, match="expected a level from 0 to 999"):
        read_routes(BORDER / "tiny_level.geojson")


@pytest.mark.parametrize("name", ["tilt14.obj", "tilt_min.obj"])
def test_a_mesh_on_its_side_is_baked_with_the_direction_that_is_found(name):
    with pytest.warns(navbake.BakeWarning, match="the mesh lies on its side, and is taken with"):
        grid = navbake.bake({"scene": {"path": str(BORDER / name)}})
    assert grid.levels[0].free.any()


def test_a_scene_far_from_the_origin_has_its_own_size():
    (level,) = navbake.bake(BORDER / "far.xml").levels
    assert (level.height, level.width) == (1000, 1000)
