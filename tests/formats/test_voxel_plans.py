"""Voxel files as grids: the floor plan between two heights, and what is unknown."""

from __future__ import annotations

import numpy as np
import pytest

import navbake
from command_line import run_command
from navbake.errors import FormatError
from navbake.formats.convert import read_as
from navbake.formats.octomap import encode_octomap, read_octomap
from navbake.voxels.grid import VoxelGrid

# columns along x: occupied in the band, over it, free, unknown
OCCUPIED = np.zeros((4, 1, 4), dtype=bool)
OCCUPIED[0, 0, 1] = OCCUPIED[1, 0, 3] = True
KNOWN = np.ones((4, 1, 4), dtype=bool)
KNOWN[3, 0, :3] = False
VOXELS = VoxelGrid(values=OCCUPIED, origin=(0.0, 0.0, 0.0), res=0.5, known=KNOWN)
KINDS = {"unknown": "#..?", "free": "#...", "occupied": "#..#"}


def shown(level):
    """Row 0 of a level: . free, # occupied, ? no floor."""
    blocked = np.where(np.isnan(level.floor), "?", "#")
    return "".join(np.where(level.free, ".", blocked)[0])


@pytest.mark.parametrize("ending", ["bt", "ot"])
@pytest.mark.parametrize(("unknown", "expected"), KINDS.items())
def test_a_tree_is_cut_and_unknown_columns_are_as_asked(
    tmp_path, capsys, ending, unknown, expected
):
    VOXELS.save(tmp_path / f"a.{ending}", free=True)
    level = read_as(tmp_path / f"a.{ending}", height=(0.1, 1.2), unknown=unknown)
    assert shown(level) == expected
    assert level.cell_size == 0.5 and level.lattice.bounds == (0.0, 0.0, 2.0, 0.5)
    out = tmp_path / "a.json"
    options = ["--height", "0.1:1.2", "--unknown", unknown]
    source = str(tmp_path / f"a.{ending}")
    assert run_command(capsys, "convert", source, str(out), *options)[0] == 0
    status, _, err = run_command(capsys, "convert", source, str(out), "--height", "1.2")
    assert status == 2 and "expected LOW:HIGH of voxels" in err
    assert shown(navbake.load(out)) == expected


def test_a_plan_without_a_free_cell_says_that_nothing_is_known(tmp_path, capsys, caplog):
    VOXELS.save(tmp_path / "a.bt")  # all that isn't occupied is unknown
    command = ("convert", str(tmp_path / "a.bt"), str(tmp_path / "a.json"), "--height", "0.1:1.2")
    assert run_command(capsys, *command)[0] == 0
    [message] = caplog.messages
    assert "is free from 0.1 to 1.2 m: 50 % of the columns are unknown" in message
    assert "`--unknown free`" in message and "`voxelize --free`" in message
    caplog.clear()
    assert run_command(capsys, *command, "--unknown", "free")[0] == 0
    assert caplog.messages == []


def test_binvox_knows_all_of_its_voxels(tmp_path):
    VOXELS.save(tmp_path / "a.binvox")
    assert shown(read_as(tmp_path / "a.binvox", height=(0.1, 1.2))) == "#..."
    assert shown(read_as(tmp_path / "a.binvox", height=(0.1, 1.6))) == "##.."


def test_heights_are_needed_and_words_are_checked(tmp_path):
    VOXELS.save(tmp_path / "a.bt")
    with pytest.raises(FormatError, match=r"--height 0\.1:1\.2"):
        read_as(tmp_path / "a.bt")
    with pytest.raises(FormatError, match="expected free or occupied or unknown as unknown"):
        read_as(tmp_path / "a.bt", height=(0.1, 1.2), unknown="red")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "height", [(1e300, 1e301), (2.0, 3.0), (-1.0, 0.0), (-np.inf, 1.0), (-1e301, -1e300)]
)
def test_heights_without_voxels_are_refused(tmp_path, height):
    VOXELS.save(tmp_path / "a.bt", free=True)
    with pytest.raises(FormatError, match="expected heights in those of the voxels, 0 to 2 m, got"):
        read_as(tmp_path / "a.bt", height=height)
    assert shown(read_as(tmp_path / "a.bt", height=(0.1, np.inf))) == "##.."


def test_a_coloured_tree_is_read_by_its_occupancy():
    plain = encode_octomap(VOXELS, "ot", free=True)
    head, _, nodes = plain.partition(b"data\n")
    records = np.frombuffer(nodes, dtype=np.uint8).reshape(-1, 5)
    colors = np.full((len(records), 3), 200, dtype=np.uint8)
    colored = np.concatenate([records[:, :4], colors, records[:, 4:]], axis=1)
    head = head.replace(b"id OcTree", b"id ColorOcTree") + b"data\n"
    back = read_octomap(head + colored.tobytes())
    np.testing.assert_array_equal(back.values, OCCUPIED)
    np.testing.assert_array_equal(back.known, KNOWN)
    with pytest.raises(FormatError):
        read_octomap(head + colored.tobytes()[:-1])
