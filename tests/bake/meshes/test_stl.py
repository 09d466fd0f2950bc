"""STL: binary and text."""

import numpy as np
import pytest
import trimesh

from navbake.bake.meshes.stl import read_stl
from navbake.errors import SceneError

BOX = trimesh.creation.box()
BINARY = trimesh.exchange.stl.export_stl(BOX)
TEXT = trimesh.exchange.stl.export_stl_ascii(BOX).replace("solid", "solid  my box", 1)


@pytest.fixture
def read(tmp_path):
    def call(data):
        path = tmp_path / "box.stl"
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
        return read_stl(path)

    return call


@pytest.mark.parametrize(
    ("data", "name"),
    [
        (BINARY, "box"),
        (b"solid" + BINARY[5:], "box"),  # some writers do that
        (BINARY + b"more", "box"),
        (TEXT, "my box"),
        (TEXT.replace("\n", "\r\n").upper().replace("MY BOX", "my box"), "my box"),
        ("\n" + TEXT.replace("  my box", "", 1), "box"),
        (b"solid caf\xe9 \xff\n" + TEXT.split("\n", 1)[1].encode(), "caf\ufffd \ufffd"),
    ],
)
def test_reads_what_trimesh_wrote(read, data, name):
    (part,) = read(data)
    assert part.name == name
    np.testing.assert_allclose(part.vertices[part.faces], BOX.triangles, atol=1e-6)


def test_all_solids_of_a_text(read):
    parts = read(TEXT + "\n" + TEXT.replace("my box", "other"))
    assert [(part.name, len(part.faces)) for part in parts] == [("my box", 12), ("other", 12)]


def test_an_empty_file_of_no_triangles(read):
    (part,) = read(BINARY[:80] + bytes(4))
    assert part.faces.shape == (0, 3)


@pytest.mark.parametrize(
    ("data", "culprit"),
    [
        (b"", "ends in its header, after 0 bytes"),
        (BINARY[:50], "after 50 bytes"),
        (BINARY[:-1], "expected 684 bytes for the 12 triangles of its header, got 683"),
        (BINARY[:80] + b"\xff" * 4 + BINARY[84:], "4294967295 triangles"),
        (b"solid nothing at all".ljust(100), "expected"),
        (TEXT[:-20], "cut off, solid 'my box' has no end"),
        (TEXT.replace("vertex", "vertex x", 1), "three numbers in line 4"),
        (TEXT.replace("vertex", "vortex", 1), "no 3 vertices a facet"),
    ],
)
def test_broken_files(read, data, culprit):
    with pytest.raises(SceneError, match=f"box.stl: .*{culprit}"):
        read(data)
