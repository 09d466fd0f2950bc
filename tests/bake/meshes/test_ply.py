"""PLY: text and binary, polygons of mixed sizes."""

import numpy as np
import pytest
import trimesh

from navbake.bake.meshes.ply import read_ply
from navbake.errors import SceneError

BOX = trimesh.creation.box()
BINARY = trimesh.exchange.ply.export_ply(BOX)
TEXT = trimesh.exchange.ply.export_ply(BOX, encoding="ascii")
VERTICES = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [-1, 1, 0.5]])
POLYGONS = [[0, 1, 2, 3, 4], [2, 1, 0], [0, 1, 2, 3]]
FACES = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [2, 1, 0], [0, 1, 2], [0, 2, 3]]


def header(encoding, num_faces, lists="list uchar int vertex_indices"):
    return (
        f"ply\nformat {encoding} 1.0\ncomment made here\nelement vertex 5\nproperty double x\n"
        f"property uchar red\nproperty double y\nproperty double z\nelement face {num_faces}\n"
        f"property float quality\nproperty {lists}\nproperty list uchar float texcoord\n"
        f"element edge 1\nproperty int vertex1\nend_header\n"
    ).encode()


def binary(order, polygons):
    data = b""
    for x, y, z in VERTICES:
        data += np.array([x], f"{order}f8").tobytes() + b"\x07"
        data += np.array([y, z], f"{order}f8").tobytes()
    for polygon in polygons:
        data += np.array([0.5], f"{order}f4").tobytes() + bytes([len(polygon)])
        data += np.array(polygon, f"{order}i4").tobytes()
        data += b"\x02" + np.array([0, 1], f"{order}f4").tobytes()
    return data + np.array([3], f"{order}i4").tobytes()


def text(polygons):
    lines = [f"{x} 7 {y} {z}" for x, y, z in VERTICES]
    lines += [f"0.5 {len(p)} {' '.join(map(str, p))} 2 0 1" for p in polygons]
    return ("\n".join([*lines, "3"]) + "\n").encode()


@pytest.fixture
def read(tmp_path):
    def call(data):
        path = tmp_path / "box.ply"
        path.write_bytes(data)
        (part,) = read_ply(path)
        return part

    return call


@pytest.mark.parametrize("data", [BINARY, TEXT, TEXT.replace(b"\n", b"\r\n"), BINARY + b"more"])
def test_reads_what_trimesh_wrote(read, data):
    part = read(data)
    assert part.name == "box"
    np.testing.assert_allclose(part.vertices[part.faces], BOX.triangles, atol=1e-6)


@pytest.mark.parametrize("polygons", [POLYGONS, POLYGONS[1:2] * 4, POLYGONS[2:]])
@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_polygons_between_other_properties(read, encoding, polygons):
    order = ">" if "big" in encoding else "<"
    body = text(polygons) if encoding == "ascii" else binary(order, polygons)
    part = read(header(encoding, len(polygons)) + body)
    np.testing.assert_array_equal(part.vertices, VERTICES)
    expected = {3: FACES, 4: FACES[3:4] * 4, 1: FACES[4:]}[len(polygons)]
    assert part.faces.tolist() == expected


def test_points_have_no_faces(read):
    points = TEXT[: TEXT.index(b"element face")] + b"end_header\n" + b"0 0 0\n" * 8
    assert read(points).faces.shape == (0, 3)


CUT = header("binary_little_endian", 3) + binary("<", POLYGONS)


@pytest.mark.parametrize(
    ("data", "culprit"),
    [
        (b"", "no PLY header"),
        (b"solid", "no PLY header"),
        (BINARY[:60], "no PLY header"),
        (BINARY.replace(b"binary_little", b"ternary_little"), "expected one of ascii"),
        (BINARY.replace(b"float x", b"float w"), "has no 'x'"),
        (BINARY.replace(b"float x", b"quad x"), "has no 'quad'"),
        (BINARY.replace(b"element vertex", b"element vortex"), "has no 'vertex'"),
        (BINARY.replace(b"vertex 8", b"vertex -8"), "negative count"),
        (BINARY.replace(b"vertex 8", b"vertex x"), "invalid literal"),
        (BINARY.replace(b"vertex 8", b"vertex 1000000000000"), "1000000000000 vertex"),
        (BINARY.replace(b"face 12", b"face 1000000000000"), "1000000000000 face"),
        (TEXT.replace(b"face 12", b"face 1000000000000"), "1000000000000 face"),
        (BINARY[:-1], "cut off in its 12 face elements"),
        (TEXT[:-10], "cut off in its 12 face elements"),
        (TEXT[: len(TEXT) // 2], "cut off"),
        (TEXT[:-10] + b"x 3 4 5 6", "could not convert"),
        (CUT[:-9], "cut off in its 3 face elements"),
        (CUT[:-3], "cut off in its 1 edge elements"),
        (header("ascii", 3) + text(POLYGONS).replace(b"0.5 5", b"0.5 -5"), "negative length"),
        (header("ascii", 3) + text(POLYGONS).replace(b" 4 2 0 1", b" 9 2 0 1"), "not there"),
        (header("ascii", 3) + text(POLYGONS).replace(b" 4 2 0 1", b" -1 2 0 1"), "not there"),
        (header("ascii", 3) + text(POLYGONS).replace(b"0.5 5", b"0.5 nan"), "cannot convert"),
    ],
)
def test_broken_files(read, data, culprit):
    with pytest.raises(SceneError, match=f"box.ply: .*{culprit}"):
        read(data)
