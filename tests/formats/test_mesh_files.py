"""GLB and OBJ of floors: trimesh and Recast read them as the floor that they are."""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
import trimesh

import navbake
from grid_maps import house_from, level_from
from navbake.errors import QueryError
from project_paths import GOLDEN

SAMPLES = ("apartment", "clutter", "house", "terrain", "warehouse")
HEADERS = Path("/usr/include/recastnavigation")
PARTS = 3  # columns of Recast along a cell: the middle one lies inside of it
HEIGHT_STEP = 0.005  # of Recast's spans [m]


def load_sample(name):
    return navbake.load(GOLDEN / f"{name}.grid.json.gz")


def area_of(grid):
    return sum(level.free.sum() * level.lattice.cell_size**2 for level in grid.levels)


def projected_area(triangles, up):
    a, b, c = np.moveaxis(np.delete(triangles, up, axis=2), 1, 0)
    (x, y), (u, v) = (b - a).T, (c - a).T
    return np.abs(x * v - y * u).sum() / 2


def heights_under(mesh, positions):
    """World z of a mesh that is y up, under or over world positions; NaN beside it."""
    a, b, c = np.moveaxis(mesh.triangles[:, :, [0, 2, 1]] * [1, -1, 1], 1, 0)
    found = np.full(len(positions), np.nan)
    for k, (x, y, z) in enumerate(positions):
        p = np.array([x, y])
        wide = ((b - a)[:, :2], (c - a)[:, :2], p - a[:, :2])
        area = wide[0][:, 0] * wide[1][:, 1] - wide[0][:, 1] * wide[1][:, 0]
        u = (wide[2][:, 0] * wide[1][:, 1] - wide[2][:, 1] * wide[1][:, 0]) / area
        v = (wide[0][:, 0] * wide[2][:, 1] - wide[0][:, 1] * wide[2][:, 0]) / area
        inside = (u >= -1e-6) & (v >= -1e-6) & (u + v <= 1 + 1e-6)
        near = (a[:, 2] + u * (b - a)[:, 2] + v * (c - a)[:, 2])[inside]
        if len(near):
            found[k] = near[np.argmin(np.abs(near - z))]
    return found


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.parametrize("ending", ["glb", "obj"])
def test_trimesh_reads_the_floor(tmp_path, name, ending):
    grid = load_sample(name)
    (path,) = grid.convert(tmp_path / f"floor.{ending}")
    mesh = trimesh.load(path, force="mesh", process=False)
    assert projected_area(mesh.triangles, up=1) == pytest.approx(area_of(grid), rel=1e-5)
    assert (mesh.face_normals[:, 1] > 0.7).all()  # upwards
    rng = np.random.default_rng(0)
    for number, level in enumerate(grid.levels):
        rows, cols = np.nonzero(level.free)
        some = rng.choice(len(rows), size=min(len(rows), 200), replace=False)
        cells = (np.full(len(some), number), rows[some], cols[some])
        positions = grid.position_of(cells)
        assert np.abs(heights_under(mesh, positions) - positions[:, 2]).max() < 0.00101


def test_a_glb_has_an_object_a_level_and_a_material_a_room(tmp_path):
    grid = load_sample("house")
    (path,) = grid.convert(tmp_path / "floor.glb")
    content = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content)) and length % 4 == 0
    size, kind = struct.unpack_from("<I4s", content, 12)
    gltf = json.loads(content[20 : 20 + size])
    assert kind == b"JSON" and size % 4 == 0
    assert [node["name"] for node in gltf["nodes"]] == ["level 0", "level 1"]
    rooms = [
        [gltf["materials"][p["material"]]["name"] for p in mesh["primitives"]]
        for mesh in gltf["meshes"]
    ]
    assert rooms == [["0:1", "0:2", "0:3", "0:4"], ["1:1", "1:2", "1:3", "1:4"]]
    colors = [m["pbrMetallicRoughness"]["baseColorFactor"] for m in gltf["materials"]]
    assert len({tuple(color) for color in colors}) >= 3  # as the pictures have them
    for accessor in gltf["accessors"]:
        view = gltf["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] % 4 == 0
        width = {"VEC3": 12, "SCALAR": 4}[accessor["type"]]
        assert view["byteLength"] == accessor["count"] * width
        start = 20 + size + 8 + view["byteOffset"]
        if accessor["type"] == "VEC3":
            found = np.frombuffer(content, "<f4", 3 * accessor["count"], start).reshape(-1, 3)
            assert found.min(axis=0).tolist() == accessor["min"]
            assert found.max(axis=0).tolist() == accessor["max"]
    assert gltf["buffers"][0]["byteLength"] == len(content) - (20 + size + 8)
    scene = trimesh.load(path)
    assert {g.visual.material.name for g in scene.geometry.values()} == {*rooms[0], *rooms[1]}


def test_far_from_the_origin_a_glb_is_as_exact(tmp_path):
    level = level_from("..\n..", x=5e5, y_max=4e6, ground=800.0)
    assert np.ptp(level.to_mesh().vertices[:, 0]) == pytest.approx(0.2, abs=1e-9)
    (path,) = level.convert(tmp_path / "floor.glb")
    scene = trimesh.load(path)
    (geometry,) = scene.geometry.values()
    assert geometry.area == pytest.approx(0.04, rel=1e-6)
    assert scene.bounds.mean(axis=0) == pytest.approx([5e5 + 0.1, 800.0, -(4e6 - 0.1)], abs=1e-6)


def test_an_obj_has_an_object_a_level_and_a_group_a_room(tmp_path):
    lower, upper = level_from("..."), level_from("..", ground=3.0)
    lower.attributes["roomIndex"] = np.array([[0, 1, 2]], dtype=np.uint16)
    names = ["my room #1", "my room 1\n"]
    rooms = [
        {"index": k, "id": f"0:{k}", "name": name, "level": 0, "area": 0.01,
         "centroid": [0, 0, 0], "neighbours": []}
        for k, name in enumerate(names, 1)
    ]  # fmt: skip
    grid = house_from([lower, upper], rooms=rooms)
    grid.metadata["navbake"]["levels"] = [{"name": "Küche unten"}, {}]
    (path,) = grid.convert(tmp_path / "floor.obj")
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0] == "# the walkable floor of a navbake grid, in metres, y up"
    assert [line for line in lines if line[0] in "og"] == [
        "o Küche_unten", "g no_room", "g my_room__1", "g my_room_1_", "o level_1", "g no_room_2",
    ]  # fmt: skip
    (path,) = grid.convert(tmp_path / "up.obj", up="z")
    turned = [line for line in path.read_text(encoding="utf-8").splitlines() if line[0] == "v"]
    for one, other in zip([line for line in lines if line[0] == "v"], turned, strict=True):
        x, y, z = map(float, other.split()[1:4])
        assert one.split()[1:4] == [f"{v:.10g}" for v in (x, z, 0.0 - y)]
        assert one.split()[4:] == other.split()[4:] and len(one.split()) == 7
    with pytest.raises(QueryError, match="expected y or z as up, got 'x'"):
        grid.convert(tmp_path / "other.obj", up="x")
    assert not (tmp_path / "other.obj").exists()


@pytest.mark.parametrize("ending", ["glb", "obj"])
def test_without_free_cells_there_is_an_object_without_faces(tmp_path, ending):
    (path,) = level_from("##").convert(tmp_path / f"floor.{ending}")
    if ending == "obj":
        assert path.read_text().splitlines()[1:] == ["o level_0"]
    else:
        content = path.read_bytes()
        gltf = json.loads(content[20:])
        assert "meshes" not in gltf and "buffers" not in gltf
        assert gltf["nodes"] == [{"name": "level 0", "translation": [0.0, 0.0, 0.0]}]
        assert len(trimesh.load(path).geometry) == 0


@pytest.fixture(scope="module")
def recast(tmp_path_factory):
    """Returns a function that rasterizes an OBJ by Recast: column, row and height of spans."""
    if shutil.which("g++") is None or not HEADERS.is_dir():
        pytest.skip("needs g++ and librecast-dev")
    program = tmp_path_factory.mktemp("recast") / "read_obj"
    source = Path(__file__).with_name("read_obj.cpp")
    flags = ["-std=c++17", f"-I{HEADERS}", str(source), "-o", str(program), "-lRecast"]
    subprocess.run(["g++", *flags], check=True)

    def rasterize(path, lattice):
        cell = lattice.cell_size / PARTS
        field = [cell, lattice.x_min, -lattice.y_max]
        sizes = [PARTS * lattice.width, PARTS * lattice.height, HEIGHT_STEP]
        command = [str(program), str(path), *map(str, field), *map(str, sizes)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        spans = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
        return spans.reshape(-1, 3)

    return rasterize


@pytest.mark.parametrize("name", SAMPLES)
def test_recast_finds_the_free_cells(tmp_path, recast, name):
    grid = load_sample(name)
    for number, level in enumerate(grid.levels):
        (path,) = level.convert(tmp_path / f"floor_{number}.obj")
        col, row, z = recast(path, level.lattice).T
        # the column round a cell's centre
        is_middle = (col % PARTS == 1) & (row % PARTS == 1)
        rows, cols = (v[is_middle].astype(int) // PARTS for v in (row, col))
        found = np.zeros(level.shape, dtype=int)
        np.add.at(found, (rows, cols), 1)
        np.testing.assert_array_equal(found, level.free)
        # a sloped quad rises by at most a third of a cell from the column's centre to its corner
        rise = level.lattice.cell_size / PARTS
        off = z[is_middle] - level.floor[rows, cols]
        assert off.min() > -HEIGHT_STEP - 0.001 and off.max() < HEIGHT_STEP + rise + 0.001
