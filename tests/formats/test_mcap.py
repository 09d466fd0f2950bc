"""MCAP: what `mcap` and `rosbags`, which know ROS' messages by themselves, read in it."""

import math
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import navbake
from command_line import run_command
from map_grids import sample, small
from navbake.errors import FormatError, MissingDependencyError
from navbake.formats.mcap import MESSAGES, define_message, find_headings
from navbake.formats.occupancy import compute_occupancy_values
from project_paths import GOLDEN

pytest.importorskip("mcap_ros2")


def read_by_mcap(path):
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return {
            channel.topic: (schema.name, message.log_time, decoded)
            for schema, channel, message, decoded in reader.iter_decoded_messages()
        }


def read_by_rosbags(path):
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)  # not the definitions in the file
    with AnyReader([Path(path)], default_typestore=store) as reader:
        return {
            connection.topic: (
                connection.msgtype,
                time,
                store.deserialize_cdr(raw, connection.msgtype),
            )
            for connection, time, raw in reader.messages()
        }


READERS = pytest.mark.parametrize("read", [read_by_mcap, read_by_rosbags])


def positions(points):
    return [[point.x, point.y, point.z] for point in points]


@READERS
def test_maps_paths_and_links_of_the_house(tmp_path, read):
    grid = sample("house")
    finder = navbake.PathFinder(grid)
    ways = [
        finder.find_path((0, -4.8, 0), (-2.2, -3.2, 3)),
        finder.find_path((1, -4.8, 0), (2, -3, 0)),
    ]
    grid.convert(tmp_path / "house.mcap", route=ways)
    found = read(tmp_path / "house.mcap")
    assert {*found} == {"/map_0", "/map_1", "/path_0", "/path_1", "/links"}
    for number, level in enumerate(grid.levels):
        kind, time, message = found[f"/map_{number}"]
        assert (kind, time, message.header.frame_id) == ("nav_msgs/msg/OccupancyGrid", 0, "map")
        info = message.info
        assert (info.width, info.height) == (level.width, level.height)
        assert info.resolution == pytest.approx(level.cell_size)
        place, turn = info.origin.position, info.origin.orientation
        assert [place.x, place.y, place.z] == [*level.lattice.bounds[:2], level.ground]
        assert (turn.x, turn.y, turn.z, turn.w) == (0, 0, 0, 1)
        data = np.array(message.data).reshape(info.height, info.width)
        np.testing.assert_array_equal(data[::-1], compute_occupancy_values(grid, number))
        rows, cols = np.nonzero(data == 0)
        x, y = place.x + (cols + 0.5) * info.resolution, place.y + (rows + 0.5) * info.resolution
        row, col = level.lattice.rows_cols(np.stack([x, y], axis=-1))
        assert level.free[row, col].all() and len(row) == level.free.sum()
    for number, way in enumerate(ways):
        kind, _, message = found[f"/path_{number}"]
        assert kind == "nav_msgs/msg/Path" and {pose.header.frame_id for pose in message.poses} == {
            "map"
        }
        points = positions(pose.pose.position for pose in message.poses)
        np.testing.assert_array_equal(points, way.positions)
        turns = [pose.pose.orientation for pose in message.poses]
        assert all(turn.x == turn.y == 0 for turn in turns)
        for turn, start, end in zip(turns, way.positions, way.positions[1:], strict=False):
            heading = 2 * math.atan2(turn.z, turn.w)
            x, y, _ = end - start
            assert math.hypot(x, y) * np.array([math.cos(heading), math.sin(heading)]) == (
                pytest.approx([x, y], abs=1e-9)
            )
        assert turns[-1] == turns[-2]
    kind, _, message = found["/links"]
    (marker,) = message.markers
    assert (kind, marker.type, marker.ns) == ("visualization_msgs/msg/MarkerArray", 5, "links")
    assert marker.scale.x > 0 and marker.color.a == 1 and marker.pose.orientation.w == 1
    expected = []
    for link in grid.steps:
        for number, cell in ((link.level, link.cell), (link.other_level, link.other_cell)):
            level = grid.levels[number]
            row, col = divmod(cell, level.width)
            expected.append([*level.lattice.positions(row, col), level.floor[row, col]])
    assert len(expected) > 2
    np.testing.assert_allclose(positions(marker.points), expected)


@pytest.mark.parametrize(
    ("points", "degrees"),
    [
        ([(0, 0, 0), (1, 0, 0), (1, 2, 0)], [0, 90, 90]),
        (
            [(0, 0, 0), (0, 0, 3), (-1, 0, 3), (-1, 0, 0)],
            [180, 180, 180, 180],
        ),  # a lift at each end
        ([(0, 0, 0), (0, -1, 0), (0, -1, 3), (1, 0, 3)], [-90, 45, 45, 45]),  # and one between
        ([(2, 2, 0)], [0]),
        ([(2, 2, 0), (2, 2, 3)], [0, 0]),
    ],
)
def test_poses_head_where_the_path_goes_next(points, degrees):
    headings = find_headings(np.array(points, dtype=float))
    assert np.degrees(headings).tolist() == pytest.approx(degrees)


@READERS
def test_links_are_lines_from_stop_to_stop(tmp_path, read):
    grid = sample("tower")
    grid.convert(tmp_path / "tower.mcap")
    steps, *named = read(tmp_path / "tower.mcap")["/links"][2].markers
    assert steps.ns == "links" and len(steps.points) == 2 * len(grid.steps)
    assert [marker.ns for marker in named] == [link.name for link in grid.links]
    assert [marker.id for marker in (steps, *named)] == [*range(len(named) + 1)]
    assert max(len(link.stops) for link in grid.links) > 2
    for marker, link in zip(named, grid.links, strict=True):
        places = [list(stop.position) for stop in link.stops]
        expected = [end for pair in pairwise(places) for end in pair]
        assert positions(marker.points) == expected and marker.type == steps.type
    navbake_ = {**grid.metadata["navbake"], "links": [link.to_json() for link in grid.links]}
    without_steps = grid.with_levels(grid.levels, {**grid.metadata, "navbake": navbake_})
    without_steps.convert(tmp_path / "links.mcap")
    markers = read(tmp_path / "links.mcap")["/links"][2].markers
    assert [marker.ns for marker in markers] == [link.name for link in grid.links]


@READERS
def test_a_level_by_itself(tmp_path, read):
    small().convert(tmp_path / "a.mcap", radius=0.06)
    found = read(tmp_path / "a.mcap")
    assert [*found] == ["/map"]
    np.testing.assert_array_equal(
        np.array(found["/map"][2].data).reshape(3, 5)[::-1],
        compute_occupancy_values(small().inflate(0.06), 0),
    )
    sample("house").convert(tmp_path / "b.mcap", level=1)
    assert [*read(tmp_path / "b.mcap")] == ["/map"]


def test_definitions_are_those_of_ros():
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for kind in MESSAGES:
        name = kind.replace("/", "/msg/")
        text, _ = store.generate_msgdef(name, ros_version=2)
        own = [line.split() for line in define_message(kind).splitlines()]
        theirs = [line.split() for line in text.splitlines() if line.strip()]
        wanted = {tuple(line[:2]) for line in theirs if line[0][0] != "=" and "=" not in line[1]}
        assert {tuple(line[:2]) for line in own if line[0][0] != "="} == wanted, kind


def test_the_same_grid_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        sample("house").convert(tmp_path / f"{name}.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_the_command_plans_the_routes(tmp_path, capsys):
    house, out = GOLDEN / "house.grid.json.gz", tmp_path / "house.mcap"
    routes = ("--route", "0,-4.8 -2.2,-3.2,L1", "--route", "0,-4.8 object:sofa")
    assert run_command(capsys, "convert", house, out, *routes)[0] == 0
    assert {"/path_0", "/path_1"} < {*read_by_mcap(out)}
    status, _, err = run_command(capsys, "convert", house, out, "--route", "0,-4.8 500,0,L0")
    assert status == 1 and "500" in err
    status, _, err = run_command(capsys, "convert", house, out, "--route", "0,-4.8")
    assert status == 2 and "--route" in err


def test_no_path_and_no_package(tmp_path, monkeypatch):
    with pytest.raises(FormatError, match="expected paths as `route`, got None"):
        small().convert(tmp_path / "a.mcap", route=[None])
    monkeypatch.setitem(sys.modules, "mcap_ros2.writer", None)
    with pytest.raises(MissingDependencyError, match=r'pip install "navbake\[mcap\]"$'):
        small().convert(tmp_path / "a.mcap")


@READERS
def test_a_flight_is_a_path_and_the_voxels_that_show(tmp_path, read):
    occupied = np.zeros((6, 5, 5), dtype=bool)
    occupied[3:, :3, :3] = True  # 27 voxels, of which the one in the middle shows no face
    voxels = navbake.VoxelGrid(values=occupied, origin=(1.0, 2.0, 3.0), res=0.5)
    finder = navbake.VoxelFinder(voxels, 0.2)
    flight = finder.find_path((1.3, 2.3, 3.3), (3.6, 4.2, 5.2))
    flight.save(tmp_path / "flight.mcap", voxels=voxels)
    found = read(tmp_path / "flight.mcap")
    assert {*found} == {"/path_0", "/voxels"}
    poses = found["/path_0"][2].poses
    assert positions(pose.pose.position for pose in poses) == flight.positions.tolist()
    (marker,) = found["/voxels"][2].markers
    assert marker.type == 6 and marker.scale.x == 0.5
    cubes = positions(marker.points)
    assert [2.75, 2.25, 3.25] in cubes and [3.25, 2.75, 3.75] not in cubes
    # faces on the grid's border count as covered, which leaves those at x, y and z
    assert len(cubes) == 27 - 2 * 2 * 2
    flight.save(tmp_path / "path.mcap")
    assert {*read(tmp_path / "path.mcap")} == {"/path_0"}
