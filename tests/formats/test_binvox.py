"""binvox: round trips, the rules of the format, AirSim's layout, and what is wrong."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navbake.errors import FormatError, NavbakeError
from navbake.formats.voxels import (
    encode_binvox,
    find_airsim_position,
    id_table_path,
    read_binvox,
    read_voxels,
    write_voxels,
)
from navbake.voxels.grid import VoxelGrid, place_grid
from oracles.voxel_files import read_binvox_plainly, write_binvox_as_airsim

ASYMMETRIC = np.zeros((5, 7, 3), dtype=bool)
ASYMMETRIC[0, 1, 2] = ASYMMETRIC[4, 6, 0] = True
ASYMMETRIC[2, :, 1] = ASYMMETRIC[:3, 3, 0] = True
HEADER = b"#binvox 1\ndim 2 3 4\ntranslate 1 2 3\nscale 4\ndata\n"


def grid_of(values, origin=(-0.5, 2.0, 1.5), res=0.25, **more):
    return VoxelGrid(values=np.asarray(values), origin=origin, res=res, **more)


@st.composite
def grids(draw):
    shape = draw(st.tuples(*[st.integers(1, 9)] * 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    share = draw(st.sampled_from([0.0, 0.02, 0.5, 1.0]))
    values = rng.random(shape) < share
    if draw(st.booleans()):
        values = values * rng.integers(1, 256, shape).astype(np.uint8)
    res = draw(st.sampled_from([0.05, 0.1, 0.25, 1.0]))
    return grid_of(values, tuple(draw(st.integers(-999, 999)) * res for _ in range(3)), res)


def same(a, b):
    np.testing.assert_array_equal(a.values, b.values)
    np.testing.assert_allclose(a.origin, b.origin, atol=1e-9)
    assert a.res == pytest.approx(b.res, rel=1e-9)
    assert a.values.dtype == b.values.dtype


@settings(deadline=None)
@given(grids())
def test_what_is_written_is_read(grid):
    same(read_binvox(encode_binvox(grid)), grid)


@settings(deadline=None)
@given(grids())
def test_a_plain_reader_sees_the_same(grid):
    values, low, res = read_binvox_plainly(encode_binvox(grid))
    np.testing.assert_array_equal(values, grid.values)
    np.testing.assert_allclose(low, grid.origin, atol=1e-9)
    assert res == pytest.approx(grid.res)


def test_the_header_is_the_formats():
    header = encode_binvox(grid_of(ASYMMETRIC)).split(b"data\n")[0]
    assert header == b"#binvox 1\ndim 5 3 7\ntranslate -0.5 2.0 1.5\nscale 1.75\n"
    assert encode_binvox(grid_of(ASYMMETRIC.astype(np.uint8))).startswith(b"#binvox 2\n")


def test_runs_are_of_255_at_most():
    data = encode_binvox(grid_of(np.ones((10, 10, 10), dtype=bool))).split(b"data\n")[1]
    assert data == bytes([1, 255]) * 3 + bytes([1, 1000 - 3 * 255])


def test_empty_runs_comments_and_missing_lines_are_read():
    runs = bytes([0, 0, 1, 5, 0, 0, 0, 19, 1, 0])
    plain = read_binvox(HEADER + runs)
    assert plain.shape == (2, 4, 3) and plain.values.sum() == 5
    commented = HEADER.replace(b"dim", b"# made by somebody\n\ndim")
    commented = commented.replace(b"\nscale", b"\n#\nscale")
    same(read_binvox(commented + runs), plain)
    bare = read_binvox(b"#binvox 1\ndim 2 3 4\ndata\n" + runs)
    assert bare.origin == (0, 0, 0) and bare.res == 0.25


def test_windows_line_ends_are_read():
    runs = bytes([1, 24])
    same(read_binvox(HEADER.replace(b"\n", b"\r\n") + runs), read_binvox(HEADER + runs))


def test_ids_in_version_1_are_kept():
    grid = read_binvox(HEADER + bytes([7, 20, 0, 4]))
    assert set(np.unique(grid.values)) == {0, 7} and grid.values.dtype == np.uint8
    assert "the bytes given: version 1 with values above 1" in grid.notes[0]


@settings(deadline=None)
@given(grids(), st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), max_size=5))
def test_any_other_bytes_are_a_grid_or_an_error_of_ours(grid, changes):
    data = bytearray(encode_binvox(grid))
    for place, value in changes:
        data[place % len(data)] = value
    with suppress(NavbakeError):
        assert read_binvox(bytes(data)).values.size


# ---------------------------------------------------------------- IDs


def test_more_than_255_ids_need_a_mapping(tmp_path):
    values = np.zeros((3, 3, 3), dtype=np.uint16)
    values[0, 0, 0], values[1, 1, 1] = 300, 700
    grid = grid_of(values, names={300: "chair", 700: "table"})
    with pytest.raises(FormatError, match=r"IDs up to 255.*up to 700.*\.npz.*compact"):
        write_voxels(grid, tmp_path / "a.binvox")
    write_voxels(grid, tmp_path / "a.binvox", mapping="compact")
    back = read_voxels(tmp_path / "a.binvox")
    assert back.names == {1: "chair", 2: "table"}
    assert back.values[0, 0, 0] == 1 and back.values[1, 1, 1] == 2 and back.values.sum() == 3
    write_voxels(grid, tmp_path / "b.binvox", mapping={300: 9, 700: 0})
    back = read_voxels(tmp_path / "b.binvox")
    assert back.names == {9: "chair"} and back.values.sum() == 9
    with pytest.raises(FormatError, match="lacks ID 700"):
        write_voxels(grid, tmp_path / "b.binvox", mapping={300: 9})
    with pytest.raises(FormatError, match="values up to 255, and the mapping has 256"):
        write_voxels(grid, tmp_path / "b.binvox", mapping={300: 256, 700: 1})


def test_more_than_255_ids_that_occur_fit_no_binvox(tmp_path):
    grid = grid_of(np.arange(1, 301, dtype=np.uint16).reshape(3, 10, 10))
    with pytest.raises(FormatError, match=r"300 IDs occur; write \.npz"):
        write_voxels(grid, tmp_path / "a.binvox", mapping="compact")
    write_voxels(grid, tmp_path / "a.npz")
    same(read_voxels(tmp_path / "a.npz"), grid)


def test_the_table_lies_beside_the_file(tmp_path):
    grid = grid_of(ASYMMETRIC.astype(np.uint8) * 3, names={3: "Tür"})
    grid.save(tmp_path / "a.binvox")
    assert id_table_path(tmp_path / "a.binvox").name == "a.binvox.names.json"
    assert read_voxels(tmp_path / "a.binvox").names == {3: "Tür"}
    id_table_path(tmp_path / "a.binvox").write_text("[]")
    with pytest.raises(FormatError, match=r"table of IDs.*a\.binvox\.names\.json"):
        read_voxels(tmp_path / "a.binvox")


# ---------------------------------------------------------------- AirSim


@pytest.mark.parametrize("shape", [(4, 6, 2), (5, 7, 3), (4, 5, 6), (12, 13, 10)])
def test_airsims_files_are_recognised_and_placed(shape):
    """Written as AirSim does it: samples at (i - n // 2) * res along north, east and up."""
    rng = np.random.default_rng(0)
    filled = {tuple(p) for p in (rng.random((6, 3)) * shape).astype(int)}
    position, res = np.array([10.0, -4.0, 2.0]), 0.5
    data, samples = write_binvox_as_airsim(filled, shape, res)
    grid = read_binvox(data, position=position)
    assert grid.res == pytest.approx(res) and grid.shape == shape
    assert "AirSim" in grid.notes[0] and "the bytes given" in grid.notes[0]
    north_east_up = {tuple(np.round(p, 9)) for p in samples}
    expected = {tuple(np.round(position + np.array([n, -e, u]), 9)) for n, e, u in north_east_up}
    assert {tuple(np.round(c, 9)) for c in grid.centers()} == expected
    assert not read_binvox(data, layout="binvox").notes


def test_airsims_sizes_may_be_no_whole_multiples():
    header = b"#binvox 1\ndim 3 3 2\ntranslate -0.5 -0.35 -0.5\nscale 1\ndata\n"
    data = header + bytes([1, 18])  # 1 × 0.7 × 1 m at 0.3 m
    grid = read_binvox(data, layout="airsim")
    assert grid.res == pytest.approx(1 / 3) and "at most (give `voxel_edge`" in grid.notes[0]
    grid = read_binvox(data, layout="airsim", voxel_edge=0.3)
    assert grid.res == 0.3 and "at most" not in grid.notes[0]
    with pytest.raises(FormatError, match="negative `translate`"):
        read_binvox(data.replace(b"-0.5 -0.35", b"0.5 0.35"), layout="airsim")


@pytest.mark.parametrize("shape", [(4, 6, 2), (5, 7, 3), (8, 8, 8)])
def test_airsims_layout_is_written_when_asked(shape):
    rng = np.random.default_rng(1)
    grid = grid_of(rng.random(shape) < 0.5, (0, 0, 0), 0.5)
    data = encode_binvox(grid, "airsim")
    back = read_binvox(data)
    np.testing.assert_array_equal(back.values, grid.values)
    assert back.notes and back.res == pytest.approx(0.5)
    # its reader places voxel n // 2 at the position that it is told; y runs against east
    nx, ny, nz = shape
    middle = np.array([nx // 2, ny - 1 - ny // 2, nz // 2]) * 0.5
    np.testing.assert_allclose(back.origin, -middle - 0.25)


@pytest.mark.parametrize("shape", [(4, 6, 2), (5, 7, 3), (4, 5, 6), (1, 2, 3)])
def test_a_file_comes_back_in_place_at_the_position_that_its_note_states(tmp_path, shape):
    rng = np.random.default_rng(2)
    grid = grid_of(rng.random(shape) < 0.5, (-1.0, 3.25, 0.5), 0.5)
    grid.save(tmp_path / "a.binvox", layout="airsim")
    position = find_airsim_position(grid)
    back = read_binvox(tmp_path / "a.binvox", position=position, layout="airsim", voxel_edge=0.5)
    np.testing.assert_array_equal(back.values, grid.values)
    np.testing.assert_allclose(back.origin, grid.origin, atol=1e-12)
    (note,) = grid.notes
    assert f"({', '.join(repr(float(value)) for value in position)})" in note
    assert "x is north, -y is east" in note


@pytest.mark.parametrize("shape", [(4, 6, 2), (5, 7, 3), (4, 5, 6)])
def test_voxels_round_a_centre_are_where_airsim_samples_them(shape):
    """All of its samples, (i - n // 2) * res along north, east and up, are middles of voxels."""
    center, res = np.array([10.0, -4.0, 2.0]), 0.5
    place = place_grid(center, shape, None, res, None, layout="airsim")
    every = list(np.ndindex(shape))
    _, samples = write_binvox_as_airsim(every, shape, res)
    expected = {tuple(np.round(center + np.array([n, -e, u]), 9)) for n, e, u in samples}
    grid = grid_of(np.ones(shape, dtype=bool), tuple(place.origin), res)
    assert {tuple(np.round(middle, 9)) for middle in grid.centers()} == expected
    np.testing.assert_allclose(find_airsim_position(grid), center)
    assert place_grid(center, shape, None, res, None).alignment_shift == place.alignment_shift == 0


def test_a_centred_unit_cube_is_no_airsim_file():
    grid = grid_of(np.ones((10, 10, 10), dtype=bool), (-0.5, -0.5, -0.5), 0.1)
    assert read_binvox(encode_binvox(grid)).notes == []


@pytest.mark.parametrize("low", [(-0.5, 0.0, 0.0), (-0.5, -0.7, -0.1), (-0.5, -0.5, -0.5)])
def test_files_by_the_rules_whose_scale_is_one_are_no_airsim_files(low):
    """The longest side is 1 m, and x begins at -0.5 m: the scale fits AirSim's by chance."""
    grid = grid_of(np.random.default_rng(2).random((10, 20, 10)) < 0.4, low, 0.05)
    back = read_binvox(encode_binvox(grid))
    np.testing.assert_array_equal(back.values, grid.values)
    assert back.notes == [] and back.origin == low


@pytest.mark.parametrize(
    ("asked", "culprit"),
    [
        ({"position": "here"}, "position to be x, y, z"),
        ({"position": (1, 2)}, "position to be x, y, z"),
        ({"voxel_edge": float("nan")}, "`voxel_edge`.* > 0 m, got nan"),
        ({"voxel_edge": -0.1}, "`voxel_edge`.* > 0 m, got -0.1"),
    ],
)
def test_what_airsim_was_asked_for_may_be_wrong(asked, culprit):
    data, _ = write_binvox_as_airsim({(0, 0, 0)}, (3, 4, 5), 0.5)
    with pytest.raises(NavbakeError, match=culprit):
        read_binvox(data, **asked)


# ---------------------------------------------------------------- bad files


@pytest.mark.parametrize(
    ("data", "culprit"),
    [
        (b"", "begins with #binvox"),
        (b"#vox 1\n", "begins with #binvox"),
        (HEADER[:-6], "no line `data`"),
        (HEADER.replace(b"#binvox 1", b"#binvox 3"), "version 1 or 2, got 3"),
        (HEADER.replace(b"#binvox 1", b"#binvox x"), "at `#binvox`.*'x'"),
        (HEADER.replace(b"dim 2 3 4", b"dim 2 3"), "3 whole numbers at `dim`.*'2 3'"),
        (HEADER.replace(b"dim 2 3 4", b"dim 2 0 4"), r"`dim` of numbers >= 1, got \[2, 0, 4\]"),
        (HEADER.replace(b"dim 2 3 4\n", b""), "no line `dim`"),
        (HEADER.replace(b"1 2 3", b"1 nan 3"), "3 numbers at `translate`"),
        (HEADER.replace(b"scale 4", b"scale 0"), "`scale` > 0, got 0"),
        (HEADER.replace(b"scale", b"scald"), "unknown line 'scald'"),
        (HEADER + bytes([1, 23]), "runs of 24 voxels.*got 23 voxels: too few"),
        (HEADER + bytes([1, 25]), "got 25 voxels: too many"),
        (HEADER + bytes([1, 24, 1, 255]), "got 279 voxels: too many"),
        (HEADER + bytes([1, 24, 0]), "got half a run"),
        (HEADER.replace(b"2 3 4", b"999999 999999 9"), "runs of 8999982000009 voxels.*too few"),
        (HEADER.replace(b"2 3 4", b"9" * 30 + b" 3 4"), "runs of 11999.*got 0 voxels: too few"),
        (HEADER.replace(b"2 3 4", b"9" * 400 + b" 3 4"), "3 whole numbers at `dim`"),
        (HEADER.replace(b"#binvox 1", b"#binvox " + b"9" * 400), "1 whole number at `#binvox`"),
    ],
)
def test_broken_files_say_what_is_wrong(data, culprit):
    with pytest.raises(NavbakeError, match=culprit) as caught:
        read_binvox(data)
    assert "\n" not in str(caught.value)


def test_files_that_are_not_there(tmp_path):
    with pytest.raises(FormatError, match=r"cannot read .*none\.binvox"):
        read_binvox(tmp_path / "none.binvox")
    with pytest.raises(FormatError, match=r"cannot write .*there is no folder"):
        write_voxels(grid_of(ASYMMETRIC), tmp_path / "no" / "a.binvox")
    with pytest.raises(FormatError, match=r"ends in \.binvox, \.bt, \.ot, \.npz, got a\.vox"):
        grid_of(ASYMMETRIC).save("a.vox")
    with pytest.raises(FormatError, match="layout auto, binvox, airsim, got 'x'"):
        read_binvox("a.binvox", layout="x")
