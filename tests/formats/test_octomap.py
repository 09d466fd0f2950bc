"""Octrees against OctoMap's own: its `binvox2bt`, and its library through octomap-python.

`binvox2bt` is in Debian's octomap-tools, octomap-python on the package index; without them the
tests that need them are skipped, and say so.
"""

import shutil
import subprocess
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navbake.errors import FormatError, NavbakeError
from navbake.formats.octomap import encode_octomap, read_octomap
from navbake.formats.voxels import read_binvox, write_voxels
from navbake.voxels.grid import VoxelGrid

try:
    import octomap
except ImportError:
    octomap = None

needs_octomap = pytest.mark.skipif(
    octomap is None, reason="octomap-python is not installed: pip install octomap-python"
)
needs_tools = pytest.mark.skipif(
    shutil.which("binvox2bt") is None,
    reason="binvox2bt is not installed: apt-get install octomap-tools",
)

ASYMMETRIC = np.zeros((5, 7, 3), dtype=bool)
ASYMMETRIC[0, 1, 2] = ASYMMETRIC[4, 6, 0] = True
ASYMMETRIC[2, :, 1] = ASYMMETRIC[:3, 3, 0] = True


def grid_of(values, corner=(0, 0, 0), res=0.1, **more):
    """Voxels whose lower corner is given in voxels."""
    origin = tuple(float(c) * res for c in corner)
    return VoxelGrid(values=np.asarray(values), origin=origin, res=res, **more)


def noise(shape, share, seed=0):
    """Scattered voxels with solid blocks, so that some of the tree is pruned."""
    rng = np.random.default_rng(seed)
    values = rng.random(shape) < share
    values[: shape[0] // 2, : shape[1] // 2] = True
    values[shape[0] // 2 :, shape[1] // 2 :] = False
    return values


GRIDS = {
    "asymmetric": grid_of(ASYMMETRIC),
    "off-centre": grid_of(noise((33, 20, 11), 0.5), (-413, 52, -31)),
    "beyond 32 m": grid_of(noise((40, 9, 40), 0.3), (900, -1234, 3000)),
    "odd edge": grid_of(noise((16, 16, 16), 0.4), (-8, -8, -8), 0.17),
    "full": grid_of(np.ones((32, 32, 32), dtype=bool), (-16, 0, 16)),
    "empty": grid_of(np.zeros((3, 4, 5), dtype=bool), (7, 8, 9)),
}
each_grid = pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())


def keys_of(grid):
    """The voxels' numbers from the world's origin, of those that are occupied."""
    return {tuple(n) for n in np.floor(grid.centers() / grid.res).astype(int)}


@st.composite
def grids(draw):
    shape = draw(st.tuples(*[st.integers(1, 12)] * 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    values = rng.random(shape) < draw(st.sampled_from([0.0, 0.05, 0.5, 0.95, 1.0]))
    corner = tuple(draw(st.integers(-40, 40)) for _ in range(3))
    known = (rng.random(shape) < 0.8) | values if draw(st.booleans()) else None
    return grid_of(values, corner, draw(st.sampled_from([0.05, 0.1, 1 / 3])), known=known)


# ---------------------------------------------------------------- round trips


@settings(deadline=None, max_examples=60)
@given(grids(), st.sampled_from(["bt", "ot"]), st.booleans())
def test_what_is_written_is_read(grid, kind, free):
    back = read_octomap(encode_octomap(grid, kind, free=free))
    assert keys_of(back) == keys_of(grid)
    assert back.res == pytest.approx(grid.res, rel=1e-12)
    seen = (
        grid.occupied | (grid.known if grid.known is not None else True) if free else grid.occupied
    )
    known = np.ones(back.shape, bool) if back.known is None else back.known
    assert keys_of(grid_like(back, known)) == keys_of(grid_like(grid, seen)) or not seen.any()


def grid_like(grid, values):
    shaped = np.broadcast_to(values, grid.shape).copy()
    return VoxelGrid(values=shaped, origin=grid.origin, res=grid.res)


def test_only_a_box_is_read_when_asked():
    grid = GRIDS["off-centre"]
    low, high = grid.bounds
    part = read_octomap(
        encode_octomap(grid, "bt"), bounds=(low + 0.5, np.array(high) - [1.3, 0.8, 0.1])
    )
    assert part.shape == (15, 7, 5)
    np.testing.assert_array_equal(part.values, grid.values[5:20, 5:12, 5:10])
    for bounds in ((high, low), "here", None):
        with pytest.raises(FormatError, match="expected bounds as"):
            read_octomap(encode_octomap(grid, "bt"), bounds=bounds or [[0, 0, 0]])


def test_a_box_reaches_as_far_as_the_tree_and_not_beside_it():
    data = encode_octomap(grid_of(np.ones((2, 2, 2), dtype=bool), (32766, 0, 0), 0.1), "bt")
    part = read_octomap(data, bounds=((3276.6, 0, 0), (1e300, 0.1, 0.1)))
    assert part.shape == (2, 1, 1) and part.values.all()
    assert part.origin == pytest.approx((3276.6, 0, 0))
    for low, high in ((4000, 5000), (-5000, -4000), (1e299, 1e300)):
        with pytest.raises(FormatError, match=r"within 3276\.8 m of the origin"):
            read_octomap(data, bounds=((low, 0, 0), (high, 1, 1)))


def test_ids_count_as_occupied():
    labelled = grid_of(ASYMMETRIC.astype(np.uint16) * 700)
    assert encode_octomap(labelled, "bt") == encode_octomap(grid_of(ASYMMETRIC), "bt")


# ---------------------------------------------------------------- OctoMap's own


@needs_tools
@each_grid
@pytest.mark.parametrize("free", [False, True], ids=["unknown", "free"])
def test_bt_is_byte_for_byte_that_of_binvox2bt(grid, free, tmp_path):
    write_voxels(grid, tmp_path / "a.binvox")
    half = repr(grid.res / 2)
    mark = ["--mark-free"] if free else []
    command = ["binvox2bt", *mark, "--offset", half, half, half, "-o", "b.bt", "a.binvox"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    write_voxels(grid, tmp_path / "a.bt", free=free)
    assert (tmp_path / "a.bt").read_bytes() == (tmp_path / "b.bt").read_bytes()


@needs_tools
def test_more_than_2_to_the_24_voxels_have_no_holes(tmp_path):
    """Where an index of 32 bits in a float can't tell neighbours apart."""
    values = np.random.default_rng(0).random((52, 52, 52)) < 0.02
    values = np.kron(values, np.ones((5, 5, 5), dtype=bool))
    assert values.size > 2**24
    grid = grid_of(values, (-100, 3, -7))
    write_voxels(grid, tmp_path / "a.binvox")
    np.testing.assert_array_equal(read_binvox(tmp_path / "a.binvox").values, values)
    command = ["binvox2bt", "--offset", ".05", ".05", ".05", "-o", "b.bt", "a.binvox"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    assert (tmp_path / "b.bt").read_bytes() == encode_octomap(grid, "bt")


@needs_tools
def test_binvox2bt_reads_a_twin_of_labelled_voxels(tmp_path):
    labels = ASYMMETRIC * np.arange(1, 4, dtype=np.uint8)
    write_voxels(grid_of(labels).without_ids(), tmp_path / "a.binvox")
    command = ["binvox2bt", "--offset", ".05", ".05", ".05", "-o", "b.bt", "a.binvox"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    assert keys_of(read_octomap(tmp_path / "b.bt")) == keys_of(grid_of(ASYMMETRIC))


@needs_octomap
@each_grid
@pytest.mark.parametrize("kind", ["bt", "ot"])
def test_octomap_holds_exactly_our_voxels(grid, kind):
    data = encode_octomap(grid, kind)
    if kind == "bt":
        tree = octomap.OcTree(grid.res)
        assert tree.readBinary(data)
    else:
        tree = octomap.OcTree.read(data)
    found = set()
    for leaf in tree.begin_leafs():
        assert tree.isNodeOccupied(leaf)
        count = round(leaf.getSize() / grid.res)
        first = np.round(np.array(leaf.getCoordinate()) / grid.res - count / 2).astype(int)
        found |= {tuple(first + offset) for offset in np.ndindex(count, count, count)}
    assert found == keys_of(grid)


@needs_octomap
@each_grid
@pytest.mark.parametrize("free", [False, True], ids=["unknown", "free"])
def test_both_kinds_are_octomaps_bytes(grid, free):
    tree = octomap.OcTree(grid.res)
    binary = encode_octomap(grid, "bt", free=free)
    tree.readBinary(binary)
    assert tree.writeBinary() == binary
    tree.updateInnerOccupancy()  # reading leaves the root as occupied
    assert tree.write() == encode_octomap(grid, "ot", free=free)


@needs_octomap
def test_a_tree_that_octomap_built_is_read():
    tree = octomap.OcTree(0.25)
    hit = np.array([[1.1, -2.2, 3.3], [40.0, 0.1, 0.1]])
    tree.updateNodes(hit, True)
    tree.updateNodes(np.array([[1.1, -2.2, 3.6]]), False)
    for data in (tree.write(), tree.writeBinary()):
        back = read_octomap(data)
        assert keys_of(back) == {tuple(n) for n in np.floor(hit / 0.25).astype(int)}
        assert back.known is not None and np.count_nonzero(back.known) == 3


# ---------------------------------------------------------------- what can't be, and bad files


def test_a_grid_off_the_lattice_is_refused():
    grid = grid_of(ASYMMETRIC, (0.5, 0, 0))
    with pytest.raises(FormatError, match=r"whole multiples.*0\.05 m off.*align=True"):
        encode_octomap(grid, "bt")


def test_a_grid_beyond_the_tree_is_refused():
    encode_octomap(grid_of(ASYMMETRIC, (32768 - 5, -32768, 0)), "bt")
    for corner in ((32768 - 4, 0, 0), (0, -32769, 0)):
        with pytest.raises(FormatError, match=r"octree reaches 3276\.8 m.*goes beyond"):
            encode_octomap(grid_of(ASYMMETRIC, corner), "bt")


BT = encode_octomap(grid_of(ASYMMETRIC), "bt")
OT = encode_octomap(grid_of(ASYMMETRIC), "ot")


@pytest.mark.parametrize(
    ("data", "culprit"),
    [
        (b"", "expected an OctoMap file"),
        (BT.replace(b"binary", b"bimary", 1), "expected an OctoMap file"),
        (BT.replace(b"id OcTree", b"id OcTreeStamped"), "id OcTree.*'OcTreeStamped'"),
        (BT.replace(b"res 0.1", b"res 0"), "numbers > 0 as .*`res`.* and 0"),
        (BT.replace(b"size", b"sise"), "no line `size`"),
        (BT.replace(b"\ndata\n", b"\n"), "no line `data`"),
        (BT[:-1], "an end within the tree"),
        (BT + b"x", "data run over"),
        (OT[:-1], "an end within the tree"),
        (OT + b"12345", "data run over"),
        (BT.split(b"data\n")[0] + b"data\n" + b"\xff\xff" * 400, "deeper than 16"),
    ],
)
def test_broken_files_say_what_is_wrong(data, culprit):
    with pytest.raises(FormatError, match=culprit) as caught:
        read_octomap(data)
    assert "\n" not in str(caught.value)


@settings(deadline=None)
@given(
    st.sampled_from([BT, OT]),
    st.lists(st.tuples(st.integers(0, 2000), st.integers(0, 255)), max_size=5),
)
def test_any_other_bytes_are_a_grid_or_an_error_of_ours(data, changes):
    changed = bytearray(data)
    for place, value in changes:
        changed[place % len(changed)] = value
    with suppress(NavbakeError):
        assert read_octomap(bytes(changed), bounds=((-1, -1, -1), (1, 1, 1))).values.size


def test_a_leaf_too_large_for_memory_is_refused():
    header = BT.split(b"data\n")[0] + b"data\n"
    eighth = header + b"\x02\x00"  # an eighth of all space is occupied
    with pytest.raises(FormatError, match=r"too many voxels \(32768 × 32768"):
        read_octomap(eighth)
    with pytest.raises(FormatError, match="GiB of memory are free"):
        read_octomap(eighth, max_voxels=2**48)
    small = read_octomap(header + b"\x02\x00", bounds=((-1, -1, -1), (0, 0, 0.5)))
    assert small.shape == (10, 10, 15) and small.values[:, :, :10].all()
    assert small.values.sum() == 1000 and "says" in small.notes[0]
