"""The command `navbake voxelize`."""

import numpy as np

import navbake

CENTRED = ("--center", 0.75, 1, 0.5, "--cells", 15, 20, 12)


def test_voxelizes_a_scene_into_several_files(arena, run):
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


def test_takes_a_size_settings_and_what_to_ignore(arena, run):
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


def test_segments_with_a_table_and_a_twin(arena, run):
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


def test_writes_airsims_layout_when_asked(arena, run):
    _, _, err = run("voxelize", "arena.xml", *CENTRED, "-o", "a.binvox", "--airsim")
    assert "its readers find the voxels round x, y, z = " in err and "-y is east" in err
    assert b"scale 0.6666" in (arena / "a.binvox").read_bytes()
    assert "AirSim" in navbake.load_voxels("a.binvox").notes[0]


def test_free_space_in_octrees(arena, run):
    run("voxelize", "arena.xml", *CENTRED, "-o", "a.bt", "--free")
    assert navbake.load_voxels("a.bt").shape == (15, 20, 12)
