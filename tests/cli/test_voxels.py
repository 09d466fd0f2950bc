"""The commands `voxelize` and `mdf`."""

import json

import numpy as np
import pytest

import navbake
from navbake.cli.main import main

ARENA = """
<mujoco>
  <worldbody>
    <geom name="floor" type="box" size=".75 1 .05" pos=".75 1 -.05"/>
    <geom name="block" type="box" size=".1 .05 .2" pos="1.2 .25 .2"/>
    <body name="cart" pos=".3 1.6 .3"><geom type="sphere" size=".15"/></body>
  </worldbody>
</mujoco>
"""
P1 = "FFC07F80FF01FE03FFFFFFF3FFE7FFCFFF9C7F38FE71FCE3F87FF0FFE1FFC3FF87FF0E0E1C1F"
P2 = "00000100001C80000000001C0000080000060001C00000080000"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "arena.xml").write_text(ARENA)
    (tmp_path / "arena.yaml").write_text(
        "scene: {path: arena.xml}\nagent: {height: 0.4, traversable_floor_height: 0.05}\n"
        "floors: {min_area: 0.1, shrink: 0.1}\n"
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def run(capsys):
    """Returns a function that runs a command: its status, stdout and stderr."""

    def call(*arguments):
        with pytest.raises(SystemExit) as caught:
            main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return caught.value.code or 0, out, err

    return call


CENTRED = ("--center", 0.75, 1, 0.5, "--cells", 15, 20, 12)


def test_voxelizes_a_scene_into_several_files(folder, run):
    files = ["a.binvox", "a.bt", "a.ot", "a.npz"]
    status, out, err = run(
        "voxelize", "arena.xml", *CENTRED, *(w for f in files for w in ("-o", f))
    )
    assert (status, err) == (0, "")
    assert out.split("\n")[:4] == files
    assert "15 × 20 × 12 voxels of 0.1 m, (0, 0, -0.1) to (1.5, 2, 1.1) m" in out
    grids = [navbake.load_voxels(name) for name in files]
    for grid in grids[1:]:
        np.testing.assert_allclose(
            sorted(map(tuple, grid.centers())), sorted(map(tuple, grids[0].centers())), atol=1e-9
        )
    assert grids[0].at([1.2, 0.25, 0.2]) and not grids[0].at([0.75, 1, 0.2])


def test_takes_a_size_settings_and_what_to_ignore(folder, run):
    status, _, _ = run(
        "voxelize", "arena.yaml", "--center", -1, 1, 0.3, "--size", 1, 1, 0.5, "--res", 0.05,
        "-o", "a.npz", "--set", "scene.exclude.geoms=[floor]",
    )  # fmt: skip
    grid = navbake.load_voxels("a.npz")
    assert status == 0 and grid.shape == (20, 20, 10) and not grid.values.any()
    run("voxelize", "arena.xml", "-o", "a.npz", "--ignore", "cart")
    grid = navbake.load_voxels("a.npz")
    np.testing.assert_allclose(grid.bounds, [[0, 0, -0.1], [1.5, 2, 0.4]], atol=1e-9)
    assert not grid.values[:, 10:, 1:].any()


def test_segments_with_a_table_and_a_twin(folder, run):
    status, out, _ = run(
        "voxelize", "arena.xml", *CENTRED, "-o", "a.binvox", "--segment", "block=40",
        "--segment", "cart=7", "--twin",
    )  # fmt: skip
    assert status == 0
    assert out.split("\n")[:3] == ["a.binvox", "a.binvox.names.json", "a.occupied.binvox"]
    grid = navbake.load_voxels("a.binvox")
    assert grid.names == {7: "cart", 40: "block", 41: "other"}
    assert [int(n) for n in grid.at([[1.2, 0.25, 0.2], [0.3, 1.6, 0.3], [1, 1, -0.05]])] == [
        40, 7, 41,
    ]  # fmt: skip
    twin = navbake.load_voxels("a.occupied.binvox")
    np.testing.assert_array_equal(twin.values, grid.occupied)
    status, _, err = run("voxelize", "arena.xml", *CENTRED, "-o", "b.binvox", "--segment", "x=700")
    assert status == 1 and "--compact" in err.split("\n")[-2]
    status, _, err = run(
        "voxelize", "arena.xml", *CENTRED, "-o", "b.binvox", "--segment", "x=700", "--compact"
    )
    assert status == 0 and "x" in err
    assert navbake.load_voxels("b.binvox").names == {1: "other"}


def test_writes_airsims_layout_when_asked(folder, run):
    run("voxelize", "arena.xml", *CENTRED, "-o", "a.binvox", "--airsim")
    assert b"scale 0.6666" in (folder / "a.binvox").read_bytes()
    assert "AirSim" in navbake.load_voxels("a.binvox").notes[0]


def test_free_space_in_octrees(folder, run):
    run("voxelize", "arena.xml", *CENTRED, "-o", "a.bt", "--free")
    assert navbake.load_voxels("a.bt").shape == (15, 20, 12)


@pytest.mark.parametrize(
    ("arguments", "status", "culprit"),
    [
        (("-o", "a.vox"), 2, ".binvox, .bt, .ot, .npz"),
        (("-o", "no/a.bt"), 1, "cannot write no/a.bt"),
        (("-o", "a.npz", "--segment", "a=b"), 2, "PATTERN=ID"),
        (("-o", "a.bt", "--segment", "top"), 2, "octrees hold no IDs"),
        (("-o", "a.bt", "--center", 0, 0, 0), 1, "beside the centre"),
        (("-o", "a.bt", "--cells", 0, 1, 1), 1, "whole numbers >= 1"),
        (("-o", "a.bt", "--res", 0), 1, "`res`"),
        (("-o", "a.bt", "--res", 1e-5), 1, "GiB of memory are free"),
    ],
)
def test_wrong_arguments_say_what_is_wrong(folder, run, arguments, status, culprit):
    found, _, err = run("voxelize", "arena.xml", *arguments)
    assert found == status and culprit in " ".join(err.split())


# ---------------------------------------------------------------- map descriptors


def test_a_baked_arena_as_a_descriptor(folder, run):
    run("bake", "arena.yaml", "-q")
    status, out, err = run("mdf", "arena.grid.json")
    assert (status, err) == (0, "")
    part1, part2, *drawing = out.strip().split("\n")
    assert part1 == "F" * 76 and len(part2) == 76
    assert len(drawing) == 20 and {len(row) for row in drawing} == {15}
    assert drawing[17] == "...........##.." and drawing[3] == ".####.........."
    status, again, _ = run("mdf", "--decode", part1, part2)
    assert again.strip().split("\n") == drawing


def test_part_of_a_level_with_a_mask(folder, run):
    run("bake", "arena.yaml", "-q", "--set", "grid.cell_size=0.05")
    mask = np.zeros((4, 5), dtype=bool)
    mask[3, 3:] = True
    np.save("seen.npy", mask)
    status, out, _ = run(
        "mdf", "arena.grid.json", "--corner", 0.8, 0.2, "--rows", 4, "--cols", 5,
        "--explored", "seen.npy", "--json",
    )  # fmt: skip
    facts = json.loads(out)
    assert status == 0 and facts["map"] == ["?????", "?????", "?????", "???##"]
    assert (facts["rows"], facts["cols"]) == (4, 5)


def test_decodes_the_canonical_descriptor(run):
    status, out, _ = run("mdf", "--decode", P1, P2)
    assert status == 0 and out.count("?") == 92 and out.count("#") == 15


@pytest.mark.parametrize(
    ("arguments", "status", "culprit"),
    [
        ((), 2, "expected a GRID, or --decode"),
        (("arena.grid.json", "--rows", 3), 2, "both or none"),
        (("arena.grid.json", "--level", 4), 1, "no level 4 in arena.grid.json: it has 1"),
        (("arena.grid.json", "--explored", "no.npy"), 1, "no.npy can't be read"),
        (("arena.grid.json", "--explored", "several.npz"), 1, "got several in several.npz"),
        (("arena.grid.json", "--square", 1e-7), 1, "larger squares"),
        (("--decode", P1, P2 + "0"), 1, "in part 2"),
        (("none.json",), 1, "none.json"),
    ],
)
def test_wrong_descriptors_say_what_is_wrong(folder, run, arguments, status, culprit):
    run("bake", "arena.yaml", "-q")
    np.savez("several.npz", np.ones((3, 3)))
    found, _, err = run("mdf", *arguments)
    assert found == status and culprit in " ".join(err.split())
