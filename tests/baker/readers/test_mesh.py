"""Mesh files as named parts in the world frame."""

from __future__ import annotations

import json
import os
import struct
import time

import numpy as np
import pytest
import trimesh
from PIL import Image

from navbake.baker.readers import mesh as mesh_scene
from navbake.baker.readers.mesh import read_named_meshes, read_plain_file
from navbake.config.settings import SceneSettings
from navbake.errors import SceneError
from project_paths import SHARED_DATA
from scene_files import WEDGE, write_dae
from scenes_alone import load_alone

IN_Z_UP = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # (x, y, z) of y up to (x, -z, y)


def triangles(part):
    return part.vertices[part.faces]


def volume(part):
    a, b, c = np.swapaxes(triangles(part), 0, 1)
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6


def same_triangles(part, expected):
    """The same triangles in the same order, each from the same corner, or turned."""
    found = triangles(part)
    assert found.shape == expected.shape
    for one, other in zip(found, expected, strict=True):
        assert any(np.allclose(one, np.roll(other, k, axis=0), atol=1e-6) for k in range(3))


# ---------------------------------------------------------------- every format


def write(path, mesh):
    """Write a mesh as the suffix says."""
    if path.suffix == ".dae":
        write_dae(path, mesh)
    elif path.stem.endswith("ascii"):
        path.write_text(trimesh.exchange.stl.export_stl_ascii(mesh))
    else:
        mesh.export(path)
    return path


@pytest.mark.parametrize(
    "name", ["w.obj", "w.ply", "w.stl", "w_ascii.stl", "w.glb", "w.gltf", "w.dae", "W.STL"]
)
def test_every_format_in_every_frame(tmp_path, name):
    path = write(tmp_path / name, WEDGE)
    (part,) = read_named_meshes(path)
    same_triangles(part, WEDGE.triangles)
    (part,) = read_named_meshes(path, up="y", unit=0.01)
    same_triangles(part, WEDGE.triangles @ IN_Z_UP.T * 0.01)
    assert volume(part) == pytest.approx(1e-6 * WEDGE.volume)  # not mirrored
    scene = load_alone(SceneSettings(path=path, up="y", unit=0.01))
    np.testing.assert_allclose(scene.bounds, [[0, -0.01, 0], [0.03, 0, 0.02]], atol=1e-9)
    assert [geom.shape for geom in scene.geoms] == ["closed surface"]


def test_exact_and_not_compiled(tmp_path):
    """Walls that share an edge still share it, and floors stay level; MuJoCo has names alone."""
    mesh = trimesh.creation.box(bounds=[[0.1, 0.2, 0.3], [40.7, 30.1, 3.3]])
    path = tmp_path / "hall.obj"
    mesh.export(path, digits=15)
    scene = load_alone(SceneSettings(path=path))
    np.testing.assert_array_equal(scene.bounds, mesh.bounds)
    top = scene.shapes.triangles.corners[:, :, 2].max(axis=1)
    assert set(top) == {0.3, 3.3}
    assert (scene.model.ngeom, scene.model.nmeshface) == (1, 4)


# ---------------------------------------------------------------- names and parts


def test_names_are_unique_and_those_of_geoms_and_bodies(tmp_path):
    vertices = "v 0 0 0\nv 9 0 0\nv 0 9 0\n"
    groups = ("roof", "world", "world", "g#2", "g", "a\tb")
    faces = "".join(f"o {name}\nf 1 2 3\n" for name in groups)
    (tmp_path / "house.obj").write_text(f"{vertices}f 1 2 3\n{faces}g roof\nf 1 2 3\n")
    scene = load_alone(SceneSettings(path=tmp_path / "house.obj"))
    names = [geom.name for geom in scene.geoms]
    assert len(set(names)) == len(names) >= 6
    assert {"house", "roof", "g"} <= set(names)
    assert "world" not in names  # MuJoCo's own body
    assert [geom.body for geom in scene.geoms] == names
    assert all(geom.reason == "no geom can collide, so all count" for geom in scene.geoms)


def test_no_part_is_named_twice(tmp_path):
    mesh = tmp_path / "two.stl"
    text = trimesh.exchange.stl.export_stl_ascii(WEDGE).replace("solid", "solid a", 1)
    mesh.write_text("\n".join([text, text.replace("solid a", "solid world"), text]))
    names = [part.name for part in read_named_meshes(mesh)]
    assert len(set(names)) == 3
    assert "a" in names
    assert "world" not in names


def test_patterns_choose_parts(tmp_path):
    scene = trimesh.Scene({"wall_a": WEDGE, "wall_b": WEDGE, "lamp": WEDGE})
    scene.export(tmp_path / "house.glb")
    settings = SceneSettings(
        path=tmp_path / "house.glb", exclude={"geoms": ["lamp*"]}, meshes={"*_a": "hull"}
    )
    geoms = {geom.name: geom for geom in load_alone(settings).geoms}
    assert {name: geom.shape for name, geom in geoms.items()} == {
        "wall_a": "hull",
        "wall_b": "closed surface",
        "lamp": "",
    }
    assert geoms["lamp"].reason == "excluded: matches 'lamp*'"


# ---------------------------------------------------------------- glTF


def place(turn=0.0, move=(0, 0, 0), scale=(1, 1, 1)):
    matrix = trimesh.transformations.rotation_matrix(turn, [1, 2, 3])
    matrix[:3, :3] *= scale
    matrix[:3, 3] = move
    return matrix


def test_nodes_move_turn_and_mirror(tmp_path):
    outer, inner = place(0.5, (1, 2, 3)), place(-1.1, (4, 5, 6), (2, -1, 1))
    scene = trimesh.Scene()
    scene.graph.update(frame_to="outer", matrix=outer)
    scene.add_geometry(WEDGE, "inner", "wedge", parent_node_name="outer", transform=inner)
    scene.add_geometry(WEDGE, "plain", "wedge")
    scene.export(tmp_path / "nodes.glb")
    parts = {part.name: part for part in read_named_meshes(tmp_path / "nodes.glb")}
    assert set(parts) == {"inner", "plain"}
    same_triangles(parts["plain"], WEDGE.triangles)
    moved = trimesh.transform_points(WEDGE.vertices, outer @ inner)
    same_triangles(parts["inner"], moved[WEDGE.faces][:, ::-1])  # a mirror turns them over
    assert volume(parts["inner"]) == pytest.approx(2 * WEDGE.volume)


def make_glb(changes=None, node=None, primitive=None, count=1, padding=0):
    """A GLB of one triangle, by hand, with something else about it."""
    data = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    data += np.array([0, 1, 2], "<u4").tobytes()
    primitive = {"attributes": {"POSITION": 0}, "indices": 1, **(primitive or {})}
    header = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "tri", **(node or {})}],
        "meshes": [{"primitives": [primitive] * count}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 12},
        ],
        "buffers": [{"byteLength": len(data)}],
    }
    header.update(changes or {})
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4 + padding)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text
    body += struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


ACCESSOR = {"count": 3, "componentType": 5126, "type": "VEC3"}


def test_primitives_are_named_by_their_node_and_the_same_each_time(tmp_path):
    path = tmp_path / "prims.glb"
    path.write_bytes(make_glb(count=3))
    for _ in range(2):
        assert [part.name for part in read_named_meshes(path)] == ["tri", "tri#2", "tri#3"]
    digests = {load_alone(SceneSettings(path=path)).digest for _ in range(2)}
    assert len(digests) == 1


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int16, np.uint16])
@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_positions_may_be_normalized_integers(tmp_path, dtype, suffix):
    """A sheet of 1 x 1 m, which its node makes 8 m wide, as gltfpack quantizes meshes."""
    number = {np.int8: 5120, np.uint8: 5121, np.int16: 5122, np.uint16: 5123}[dtype]
    corners = np.zeros((4, 4), dtype)  # rows of four: a vertex begins at a multiple of four bytes
    corners[[1, 2], 0] = corners[[2, 3], 2] = np.iinfo(dtype).max
    positions = corners.tobytes()
    data = positions + np.array([0, 2, 1, 0, 3, 2], "<u4").tobytes()
    header = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_mesh_quantization"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "floor", "scale": [8, 8, 8]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {
                "bufferView": 0, "componentType": number, "count": 4, "type": "VEC3",
                "normalized": True, "min": [0, 0, 0], "max": [1, 0, 1],
            },
            {"bufferView": 1, "componentType": 5125, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": len(positions), "byteStride": corners.strides[0]},
            {"buffer": 0, "byteOffset": len(positions), "byteLength": 24},
        ],
        "buffers": [{"byteLength": len(data)}],
    }  # fmt: skip
    path = tmp_path / f"sheet{suffix}"
    if suffix == ".gltf":
        header["buffers"][0]["uri"] = "sheet.bin"
        (tmp_path / "sheet.bin").write_bytes(data)
        path.write_text(json.dumps(header))
    else:
        text = json.dumps(header).encode()
        text += b" " * (-len(text) % 4)
        body = struct.pack("<II", len(text), 0x4E4F534A) + text
        body += struct.pack("<II", len(data), 0x004E4942) + data
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
    (mesh,) = read_named_meshes(path)
    assert mesh.name == "floor"
    size = mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)
    np.testing.assert_allclose(np.sort(size), [0, 8, 8], atol=1e-6)


def test_nodes_without_a_name(tmp_path):
    path = tmp_path / "plain.glb"
    path.write_bytes(make_glb({"nodes": [{"children": [1]}, {"mesh": 0}]}))
    assert [part.name for part in read_named_meshes(path)] == ["1"]


def test_a_cycle_of_nodes_ends(tmp_path):
    path = tmp_path / "cycle.glb"
    path.write_bytes(make_glb({"nodes": [{"children": [1]}, {"mesh": 0, "children": [0]}]}))
    with pytest.raises(SceneError, match=r"cycle\.glb"):
        read_named_meshes(path)


def test_textures_do_not_matter(tmp_path):
    textured = WEDGE.copy()
    image = Image.new("RGB", (4, 4), "red")
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=image)
    textured.visual = trimesh.visual.TextureVisuals(uv=np.zeros((4, 2)), material=material)
    textured.export(tmp_path / "t.glb")
    assert b"image/png" in (tmp_path / "t.glb").read_bytes()
    (part,) = read_named_meshes(tmp_path / "t.glb")
    same_triangles(part, WEDGE.triangles)
    broken = (tmp_path / "t.glb").read_bytes().replace(b"\x89PNG", b"\x89GNP")
    (tmp_path / "broken.glb").write_bytes(broken)
    (part,) = read_named_meshes(tmp_path / "broken.glb")
    same_triangles(part, WEDGE.triangles)
    textured.export(tmp_path / "t.obj")
    for extra in (*tmp_path.glob("*.mtl"), *tmp_path.glob("*.png")):
        extra.unlink()
    (part,) = read_named_meshes(tmp_path / "t.obj")
    same_triangles(part, WEDGE.triangles)


def test_lines_and_points_have_no_surface(tmp_path):
    path = tmp_path / "l.glb"
    changes = {
        "nodes": [{"mesh": 0, "name": "tri"}, {"mesh": 1, "name": "line"}],
        "scenes": [{"nodes": [0, 1]}],
    }
    meshes = [{"primitives": [{"attributes": {"POSITION": 0}, "mode": m}]} for m in (4, 1)]
    path.write_bytes(make_glb({**changes, "meshes": meshes}))
    assert [part.name for part in read_named_meshes(path)] == ["tri"]


@pytest.mark.parametrize(
    ("data", "culprit"),
    [
        (make_glb({"extensionsUsed": ["EXT_meshopt_compression"]}), "gltfpack -i FILE -o"),
        (make_glb({"extensionsUsed": ["EXT_mesh_gpu_instancing"]}), "EXT_mesh_gpu_instancing"),
        (make_glb(primitive={"mode": 6}), "triangle fans"),
        (make_glb(primitive={"indices": 7}), "broken"),
        (make_glb(node={"mesh": 7}), "no triangles"),
        (make_glb({"meshes": []}), "no triangles"),
        (make_glb({"accessors": [{**ACCESSOR, "count": 10**13}] * 2}), "without data"),
        (make_glb({"accessors": [{**ACCESSOR, "sparse": {}}] * 2}), "sparse"),
        (make_glb({"accessors": [{**ACCESSOR, "normalized": True}] * 2}), "normalized"),
        (make_glb({"bufferViews": [{"buffer": 0, "byteLength": 10**12}] * 2}), "cannot read"),
        (make_glb({"buffers": []}), ""),
        (make_glb()[:-9], "cut off: expected 552 bytes, got 543"),
        (make_glb()[:16], "no GLB header"),
        (make_glb().replace(b"glTF", b"glUE", 1), "no GLB header"),
        (make_glb().replace(b'"asset"', b'"asset,', 1), "broken glTF"),
        (make_glb().replace(b"\x02", b"\x01", 1), "expected version 2, got 1"),
        (b"", "no GLB header"),
    ],
)  # fmt: skip
def test_what_trimesh_would_get_wrong_is_refused(tmp_path, data, culprit):
    path = tmp_path / "bad.glb"
    path.write_bytes(data)
    if b'"buffers": []' in data:  # trimesh reads the chunk all the same
        assert len(read_named_meshes(path)) == 1
        return
    with pytest.raises(SceneError, match=f"{culprit}.*") as caught:
        read_named_meshes(path)
    assert "bad.glb" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["{", "[]", "[" * 100_000, '{"meshes": [{}]}', '{"meshes": 3}'])
def test_broken_gltf(tmp_path, text):
    (tmp_path / "bad.gltf").write_text(text)
    with pytest.raises(SceneError, match=r"bad\.gltf"):
        read_named_meshes(tmp_path / "bad.gltf")


def test_gltf_without_its_buffer(tmp_path):
    WEDGE.export(tmp_path / "w.gltf")
    for extra in tmp_path.glob("*.bin"):
        extra.unlink()
    with pytest.raises(SceneError, match=r"w\.gltf"):
        read_named_meshes(tmp_path / "w.gltf")


# ---------------------------------------------------------------- OBJ, STL, PLY

VERTICES = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


@pytest.fixture
def read(tmp_path):
    """Returns a function that reads a file with this name and content."""

    def call(name, content):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_named_meshes(path)

    return call


def test_all_objects_and_groups_of_an_obj(read):
    parts = read(
        "house.obj",
        f"# a house\nmtllib none.mtl\n{VERTICES}"
        "o house\ng walls\nusemtl a\nf 1 2 3\nusemtl b\nf 1 2 4\ng floor of it\nf 2 3 4\n"
        "o shed\ng roof\nf 1 3 4\no house\ng walls\nf 2 3 4\n",
    )
    assert {part.name: len(part.faces) for part in parts} == {
        "house_walls": 3,
        "house_floor of it": 1,
        "shed_roof": 1,
    }


@pytest.mark.parametrize(
    "content",
    [
        VERTICES.replace("\n", "\r\n") + "f 1 2 3\r\n",
        VERTICES.replace("\n", "\r") + "f 1 2 3\r",
        VERTICES.replace(" ", "\t") + "f\t1\t2\t3",
        VERTICES.replace("v", "  v") + "  f 1 2 3  # the one",
        VERTICES.replace("\n", " 1.0\n") + "f 1 2 3",
        VERTICES.replace("\n", " .5 .5 .5\n") + "f 1 \\\n 2 3",
        b"# r\xe9sum\xe9\n" + VERTICES.encode() + b"f 1/1/1 2/1/1 3/1/1\n",
        "\ufeff" + VERTICES + "vn 0 0 1\nvt 0 0\nl 1 2\np 1\nf 1//1 2//1 3//1\nf 1 2\ncurv 1",
        VERTICES + "f -4 -3 -2",
        VERTICES + "f -4/-1 2 -2/-1/-1",
        "f 1 2 3\n" + VERTICES,
    ],
)
def test_ways_to_write_an_obj(read, content):
    (part,) = read("house.obj", content)
    assert part.name == "house"
    assert triangles(part).tolist() == [[[0, 0, 0], [1, 0, 0], [1, 1, 0]]]


def test_relative_indices_count_from_where_they_stand(read):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 5\nv 1 0 5\nv 0 1 5\nf -3 -2 -1\n"
    (part,) = read("house.obj", text)
    assert triangles(part)[:, :, 2].tolist() == [[0, 0, 0], [5, 5, 5]]


STL = WEDGE.export(file_type="stl")
STL_TEXT = WEDGE.export(file_type="stl_ascii")
PLY = WEDGE.export(file_type="ply")
PLY_TEXT = WEDGE.export(file_type="ply", encoding="ascii")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("w.stl", b"solid" + STL[5:]),  # some writers do that
        ("w.stl", STL + b"more"),
        ("w.stl", STL_TEXT.replace("\n", "\r\n")),
        ("w.stl", b"solid caf\xe9\n" + STL_TEXT.split("\n", 1)[1].encode()),
        ("w.ply", PLY_TEXT.replace(b"comment", b"comment caf\xe9")),
    ],
)
def test_ways_to_write_stl_and_ply(read, name, content):
    (part,) = read(name, content)
    same_triangles(part, WEDGE.triangles)


def ply(format_="binary_little_endian", kinds=("<f4", "<i4"), extra=(), corners=3, tail=b""):
    """The wedge as a binary PLY with these types of coordinates and indices."""
    names = {"f4": "float", "f8": "double", "i4": "int", "u4": "uint"}
    coordinate, index = (names[kind[1:]] for kind in kinds)
    vertex = np.dtype([*((axis, kinds[0]) for axis in "xyz"), *((name, "u1") for name in extra)])
    face = np.dtype([("count", "u1"), ("index", kinds[1], 3)])
    vertices, faces = np.zeros(len(WEDGE.vertices), vertex), np.zeros(len(WEDGE.faces), face)
    for number, axis in enumerate("xyz"):
        vertices[axis] = WEDGE.vertices[:, number]
    faces["count"], faces["index"] = corners, WEDGE.faces
    properties = [f"property {coordinate} {axis}\n" for axis in "xyz"]
    properties += [f"property uchar {name}\n" for name in extra]
    header = (
        f"ply\nformat {format_} 1.0\ncomment of a wedge\nelement vertex {len(vertices)}\n"
        f"{''.join(properties)}element face {len(faces)}\n"
        f"property list uchar {index} vertex_indices\nend_header\n"
    )
    return header.encode() + vertices.tobytes() + faces.tobytes() + tail


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("w.stl", STL),
        ("w.ply", PLY),
        ("w.ply", ply()),
        ("w.ply", ply(kinds=("<f8", "<u4"), extra=("red", "green", "blue"))),
        ("w.ply", ply("binary_big_endian", (">f4", ">i4"))),
    ],
)
def test_plain_files_are_read_as_trimesh_reads_them(read, name, content, monkeypatch):
    (by_trimesh,) = unplain(monkeypatch, lambda: read(name, content))
    monkeypatch.setattr("navbake.baker.readers.mesh.trimesh", None)
    (part,) = read(name, content)
    for one, other in zip(part, by_trimesh, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("w.ply", PLY_TEXT),
        ("w.ply", ply(extra=("s", "t"))),  # texture coordinates
        ("w.ply", ply(tail=b"more")),
        ("w.ply", ply(corners=4)),
        ("w.ply", ply().replace(b"vertex 4", b"vertex 3")),
        ("w.ply", ply()[:-1]),
        ("w.ply", ply().replace(b"uchar int", b"uchar half")),
        ("w.stl", STL_TEXT.encode()),
        ("w.stl", STL[:-1]),
        ("w.stl", b"solid" + STL[5:]),
        ("w.stl", STL[:80] + bytes(4)),
    ],
)
def test_what_is_not_plain_is_left_to_trimesh(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    assert read_plain_file(path) is None


def unplain(monkeypatch, function):
    """What a function gives where no file is read as a plain one."""
    with monkeypatch.context() as changed:
        changed.setattr(mesh_scene, "read_plain_file", lambda *_: None)
        return function()


def test_polygons_of_a_ply(read):
    text = PLY_TEXT.replace(b"element face 4", b"element face 2")
    (part,) = read("w.ply", text[: text.index(b"\n3 ")] + b"\n4 0 1 2 3\n3 2 1 0\n")
    assert len(part.faces) == 3


@pytest.mark.parametrize(
    ("name", "content", "culprit"),
    [
        ("w.obj", VERTICES + "f 0 1 2", "counted from 1, in line 5 of"),
        ("w.obj", VERTICES + "f 1 2 -5", "counted from 1, in line 5 of"),
        ("w.obj", VERTICES + "f 1 -1 x", "counted from 1, in line 5 of"),
        ("w.obj", VERTICES + "f 1 2 9", "cannot read"),
        ("w.obj", VERTICES + "f 1 2 99999999999999999999", "cannot read"),
        ("w.obj", "v 0 0\nv 1 0\nv 0 1\nf 1 2 3", "cannot read"),
        ("w.obj", "v 0 0 0\nv 1 x 0\nv 0 1 0\nf 1 2 3", "cannot read"),
        ("w.stl", STL[:50], "cut off or no STL"),
        ("w.stl", STL[:-1], "expected 284 bytes for the 4 triangles of its header, got 283"),
        ("w.stl", STL[:80] + b"\xff" * 4 + STL[84:], "4294967295 triangles"),
        ("w.stl", STL_TEXT[: len(STL_TEXT) // 2], "cut off: its last solid has no end"),
        ("w.stl", STL_TEXT + "\n" + STL_TEXT[:-20], "cut off: its last solid has no end"),
        ("w.ply", PLY[:-1], "cut off"),
        ("w.ply", PLY[:40], "cut off"),
        ("w.ply", PLY.replace(b"vertex 4", b"vertex 1000000000000"), "cut off"),
        ("w.ply", PLY.replace(b"face 4", b"face 1000000000000"), "cut off"),
        ("w.ply", PLY_TEXT[:-8], "cut off: expected 4 face elements"),
        ("w.ply", PLY_TEXT.replace(b"face 4", b"face 1000000000000"), "expected 1000000000000"),
        ("w.ply", PLY_TEXT.replace(b"3 ", b"3 7", 1), "cannot read"),
    ],
)
def test_broken_obj_stl_and_ply(read, name, content, culprit):
    with pytest.raises(SceneError, match=culprit) as caught:
        read(name, content)
    assert name in str(caught.value)


POINTS_HEADER = "ply\nformat ascii 1.0\nelement vertex 2\n" + "".join(
    f"property float {axis}\n" for axis in "xyz"
)
NO_FACES = "element face 0\nproperty list uchar int vertex_indices\n"
TWO_POINTS = "end_header\n0 0 0\n1 1 1\n"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.ply", POINTS_HEADER + TWO_POINTS),
        ("a.ply", POINTS_HEADER + NO_FACES + TWO_POINTS),
        (
            "a.ply",
            (POINTS_HEADER + "end_header\n").replace("ascii", "binary_little_endian").encode()
            + np.ones((2, 3), dtype="<f4").tobytes(),
        ),
        ("a.obj", VERTICES),
        ("a.obj", VERTICES + "p 1 2 3"),
        ("a.obj", VERTICES + "l 1 2"),
    ],
)
def test_points_alone_are_told_as_such_and_what_to_do(read, name, content):
    with pytest.raises(SceneError, match=r"holds points without triangles: make a mesh") as caught:
        read(name, content)
    assert name in str(caught.value) and "docs/scans.md" in str(caught.value)


# ---------------------------------------------------------------- DAE


@pytest.mark.parametrize("up", ["X_UP", "Y_UP", "Z_UP"])
def test_dae_unit_counts_and_its_axis_does_not(tmp_path, up):
    moved = place(0.4, (100, 200, 300))
    path = write_dae(tmp_path / "w.dae", WEDGE, 0.01, up, [np.eye(4), moved])
    assert 'meter="0.01"' in path.read_text()
    assert up in path.read_text()
    first, second = read_named_meshes(path)
    same_triangles(first, WEDGE.triangles * 0.01)
    expected = trimesh.transform_points(WEDGE.vertices, moved)[WEDGE.faces]
    same_triangles(second, expected * 0.01)
    first, _ = read_named_meshes(path, up="y", unit=2.0)
    same_triangles(first, WEDGE.triangles @ IN_Z_UP.T * 0.02)


def test_dae_without_a_unit(tmp_path):
    path = write_dae(tmp_path / "w.dae", WEDGE, 0.01)
    text = path.read_text()
    start = text.index("<unit")
    path.write_text(text[:start] + text[text.index(">", start) + 1 :])
    (part,) = read_named_meshes(path)
    same_triangles(part, WEDGE.triangles)


@pytest.mark.parametrize("meter", ["0", "-1", "inf", "nan", "one"])
def test_dae_with_a_wrong_unit(tmp_path, meter):
    path = write_dae(tmp_path / "w.dae", WEDGE, 0.01)
    path.write_text(path.read_text().replace('meter="0.01"', f'meter="{meter}"'))
    with pytest.raises(SceneError, match=rf"<unit meter> in .*w\.dae, got '{meter}'"):
        read_named_meshes(path)


def test_broken_dae(tmp_path):
    path = write_dae(tmp_path / "w.dae", WEDGE)
    text = path.read_text()
    for broken in ("", text[: len(text) // 2], text.replace("#v", "#gone"), "<COLLADA/>"):
        path.write_text(broken)
        with pytest.raises(SceneError, match=r"w\.dae"):
            read_named_meshes(path)


# ---------------------------------------------------------------- odd geometry


def write_obj(path, vertices, faces):
    lines = [f"v {' '.join(map(str, v))}" for v in vertices]
    lines += [f"f {' '.join(str(i + 1) for i in f)}" for f in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


SQUARE = [[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]]


@pytest.mark.parametrize(
    ("vertices", "faces", "count"),
    [
        (SQUARE, [[0, 1, 2]], 1),  # MuJoCo wants four vertices
        ([*SQUARE, [99, 99, 99], ["nan", 0, 0]], [[0, 1, 2], [0, 2, 3]], 2),  # unused ones
        ([*SQUARE, *SQUARE], [[0, 1, 2], [4, 6, 7]], 2),  # doubled ones
        (SQUARE, [[0, 1, 2], [0, 1, 1], [2, 2, 2], [0, 2, 3]], 2),  # no area
        ([*SQUARE, [2, 0, 0]], [[0, 4, 1], [0, 1, 2]], 1),
        (SQUARE, [[0, 1, 2], [0, 2, 1]], 2),  # both sides
        ([[x + 5e5, y - 4e6, z] for x, y, z in SQUARE], [[0, 1, 2], [0, 2, 3]], 2),  # UTM
        ([[x * 1e5, y * 1e5, z] for x, y, z in SQUARE], [[0, 1, 2], [0, 2, 3]], 2),
    ],
)
def test_odd_meshes_make_a_model(tmp_path, vertices, faces, count):
    path = write_obj(tmp_path / "odd.obj", vertices, faces)
    (part,) = read_named_meshes(path)
    assert len(part.faces) == count
    assert len(part.vertices) <= 3 * count
    scene = load_alone(SceneSettings(path=path))
    np.testing.assert_array_equal(scene.shapes.triangles.corners, triangles(part))
    used = np.array(vertices, float)[np.unique(faces[0])]
    assert (scene.bounds[0] <= used.min(axis=0)).all()


@pytest.mark.parametrize(
    ("vertices", "faces", "culprit"),
    [
        ([], [], "no triangles in .*odd.obj"),
        (SQUARE, [], "holds points without triangles"),
        (SQUARE, [[0, 1, 1]], "no triangles"),
        ([*SQUARE, ["nan", 0, 0]], [[0, 1, 4]], "mesh 'odd.*' in .*odd.obj has"),
        ([*SQUARE, ["inf", 0, 0]], [[0, 1, 4]], "no numbers"),
        ([*SQUARE, [1e11, 0, 0]], [[0, 1, 4]], r"reaches beyond 1e\+10 m: check `scene.unit`"),
        ([*SQUARE, [1e300, 0, 1e300]], [[0, 1, 4]], "beyond"),
    ],
)  # fmt: skip
def test_unusable_meshes(tmp_path, vertices, faces, culprit):
    path = write_obj(tmp_path / "odd.obj", vertices, faces)
    with pytest.raises(SceneError, match=culprit):
        load_alone(SceneSettings(path=path))


def test_a_unit_that_overflows(tmp_path):
    path = write_obj(tmp_path / "odd.obj", SQUARE, [[0, 1, 2]])
    with pytest.raises(SceneError, match=r"odd\.obj"):
        read_named_meshes(path, unit=1e308)


def test_flat_meshes_have_no_hull(tmp_path):
    path = write_obj(tmp_path / "odd.obj", SQUARE, [[0, 1, 2], [0, 2, 3]])
    scene = load_alone(SceneSettings(path=path, meshes="hull"))
    assert scene.geoms[0].shape == "surface"
    assert scene.warnings == [
        "mesh 'odd' of geom 'odd' is flat, so it has no convex hull: it counts by its triangles"
    ]


# ---------------------------------------------------------------- what others made


@pytest.mark.skipif(not SHARED_DATA.is_dir(), reason="no shared data here")
def test_real_files():
    def facts(name, **settings):
        parts = read_named_meshes(SHARED_DATA / name, **settings)
        corners = np.concatenate([triangles(part) for part in parts])
        return len(parts), len(corners), corners.reshape(-1, 3)

    num_parts, num_triangles, points = facts("recast_meshes/nav_test.obj", up="y")
    assert (num_parts, num_triangles) == (2, 1612)
    assert (points[:, 2].min() < -2.5) & (points[:, 2].max() > 10)
    assert facts("recast_meshes/dungeon.obj", up="y")[1] == 10_133
    _, num_triangles, points = facts("trimesh_3storey/no_indices_3storybuilding.glb", up="y")
    assert num_triangles == 72
    assert {3, 6, 9} <= set(np.round(points[:, 2], 6))


# ---------------------------------------------------------------- bounds


def test_a_file_that_is_too_large_is_refused_unread(tmp_path):
    for name in ("a.obj", "a.glb"):
        with open(tmp_path / name, "wb") as file:
            file.truncate(mesh_scene.MAX_BYTES + 1)  # takes no room
        with pytest.raises(SceneError, match=rf"{name} is too large: .* 4096 MiB at most"):
            read_named_meshes(tmp_path / name)


@pytest.mark.parametrize("uri", ["../w.bin", "a/%2E%2E/../w.bin"])
def test_a_buffer_outside_of_the_folder_is_named(tmp_path, uri):
    WEDGE.export(tmp_path / "w.gltf")
    content = json.loads((tmp_path / "w.gltf").read_text())
    content["buffers"] = [{**content["buffers"][0], "uri": uri}]
    (tmp_path / "w.gltf").write_text(json.dumps(content))
    with pytest.raises(SceneError, match=r"its buffer '.*w\.bin' lies outside of its folder"):
        read_named_meshes(tmp_path / "w.gltf")


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="no endless device here")
@pytest.mark.parametrize(
    "uri", ["/dev/zero", "%2Fdev%2Fzero", "/dev/zero ", "link", "none.bin", ""]
)
def test_a_gltf_reads_no_device_as_its_buffer(tmp_path, uri):
    (tmp_path / "link").symlink_to("/dev/zero")
    WEDGE.export(tmp_path / "w.gltf")
    content = json.loads((tmp_path / "w.gltf").read_text())
    content["buffers"] = [{**content["buffers"][0], "uri": uri}]
    (tmp_path / "w.gltf").write_text(json.dumps(content))
    with pytest.raises(SceneError, match=r"w\.gltf: its buffer .* is (missing|no file of 4096)"):
        read_named_meshes(tmp_path / "w.gltf")


def test_trimesh_writes_nothing_to_the_terminal(tmp_path, capfd):
    (tmp_path / "a.stl").write_text("solid a\nfacet normal x 0 1\nendfacet\nendsolid a\n")
    with pytest.raises(SceneError):
        read_named_meshes(tmp_path / "a.stl")
    assert capfd.readouterr() == ("", "")


def test_draco_is_read_by_its_package_or_named(tmp_path, monkeypatch):
    pytest.importorskip("DracoPy")
    box = trimesh.creation.box((2.0, 3.0, 1.0))
    path = tmp_path / "d.glb"
    path.write_bytes(box.export(file_type="glb", extension_draco=True))
    if b"KHR_draco_mesh_compression" not in path.read_bytes():
        pytest.skip("this trimesh doesn't write Draco")
    (part,) = read_named_meshes(path)
    assert volume(part) == pytest.approx(6.0, rel=1e-3)
    monkeypatch.setattr(mesh_scene, "find_spec", lambda name: None)
    with pytest.raises(SceneError, match=r"KHR_draco_mesh_compression: `pip install .*draco"):
        read_named_meshes(path)


@pytest.mark.parametrize("name", ["w.obj", "w.glb", "w.gltf", "w.dae"])
def test_a_missing_texture_stops_nothing(tmp_path, name):
    image = Image.new("RGB", (4, 4))
    uv = np.zeros((len(WEDGE.vertices), 2))
    textured = trimesh.Trimesh(
        WEDGE.vertices, WEDGE.faces, visual=trimesh.visual.TextureVisuals(uv, image=image)
    )
    path = tmp_path / name
    textured.export(path)
    text = path.read_bytes()
    if name == "w.dae":  # which trimesh writes without its picture
        path.write_bytes(text.replace(b".png", b"_gone.png"))
    for file in tmp_path.iterdir():
        if file.suffix in (".png", ".jpg", ".jpeg", ".mtl"):
            file.unlink()
    assert read_named_meshes(path)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.stl", "solid a\nfacet" + "\n" * 200_000),
        ("a.stl", "solid a\nfacet" + " " * 200_000 + "\n"),
        ("a.ply", "ply\nformat ascii 1.0\nelement vertex " + "9" * 5000 + "\nend_header\n"),
        ("a.obj", "v 0 0 0\n" + "f" + " 0" * 100_000 + "a\n"),
    ],
)
def test_broken_meshes_cost_time_in_proportion_to_their_size(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    begin = time.process_time()
    with pytest.raises(SceneError):
        read_named_meshes(tmp_path / name)
    assert time.process_time() - begin < 2
