"""OBJ: groups, objects, indices, polygons, and what is wrong with a file."""

import numpy as np
import pytest

from navbake.bake.meshes.obj import read_obj
from navbake.errors import SceneError

VERTICES = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


@pytest.fixture
def read(tmp_path):
    def call(text):
        path = tmp_path / "house.obj"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_obj(path)

    return call


def corners(parts):
    return {part.name: part.vertices[part.faces].tolist() for part in parts}


def test_all_groups_and_objects(read):
    parts = read(
        f"# a house\nmtllib none.mtl\n{VERTICES}"
        "o house\ng walls\nusemtl a\nf 1 2 3\nusemtl b\nf 1 2 4\ng floor of it\nf 2 3 4\n"
        "o shed\nf 1 3 4\no house\ng walls\nf 2 3 4\n"
    )
    assert [(p.name, len(p.faces)) for p in parts] == [
        ("house_walls", 3),
        ("house_floor of it", 1),
        ("shed", 1),
    ]


def test_a_file_without_names_has_one_part(read):
    (part,) = read(
        VERTICES + "f 1 2 3\ns off\nf 3/1 4/2 1/3\nf 1//1 2//1 3//1\nf 1/1/1 2/2/1 3/3/1"
    )
    assert part.name == "house"
    assert part.faces.tolist() == [[0, 1, 2], [2, 3, 0], [0, 1, 2], [0, 1, 2]]


def test_relative_indices_count_from_where_they_stand(read):
    (part,) = read("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 5\nv 1 0 5\nv 0 1 5\nf -3 -2 -1\n")
    assert part.faces.tolist() == [[0, 1, 2], [3, 4, 5]]


@pytest.mark.parametrize(
    "text",
    [
        VERTICES.replace("\n", "\r\n") + "f 1 2 3\r\n",
        VERTICES.replace("\n", "\r") + "f 1 2 3\r",
        VERTICES.replace(" ", "\t") + "f\t1\t2\t3",
        VERTICES.replace("v", "  v") + "  f 1 2 3  # the one",
        VERTICES.replace("\n", " 1.0\n") + "f 1 2 3",
        VERTICES.replace("\n", " .5 .5 .5\n") + "f 1 \\\n 2 3",
        b"# r\xe9sum\xe9\n" + VERTICES.encode() + b"f 1 2 3\n",
        "\ufeff" + VERTICES + "vn 0 0 1\nvt 0 0\nl 1 2\np 1\nf 1 2 3\nf 1 2\ncurv 1",
        "f 1 2 3\n" + VERTICES,
    ],
)
def test_ways_to_write_it(read, text):
    assert corners(read(text)) == {"house": [[[0, 0, 0], [1, 0, 0], [1, 1, 0]]]}


def test_polygons_are_split_where_they_are(read):
    l_shape = "v 0 0 0\nv 3 0 0\nv 3 1 0\nv 1 1 0\nv 1 3 0\nv 0 3 0\n"
    (part,) = read(l_shape + "f 2 3 4 5 6 1\n")
    a, b, c = np.swapaxes(part.vertices[part.faces], 0, 1)
    assert np.cross(b - a, c - a)[:, 2].sum() == pytest.approx(2 * 5.0)
    assert (np.cross(b - a, c - a)[:, 2] >= 0).all()


@pytest.mark.parametrize("text", ["", "hello world\n", VERTICES, bytes(range(256)) * 20])
def test_nothing_to_read(read, text):
    assert read(text) == []


@pytest.mark.parametrize(
    ("text", "culprit"),
    [
        ("v 0 0\nf 1 1 1", r"three numbers in line 1, got 'v 0 0'"),
        ("v 0 0 0\nv 1 x 0", r"three numbers in line 2, got 'v 1 x 0'"),
        ("v 0,5 0 0", r"three numbers in line 1"),
        (VERTICES + "f 0 1 2", r"from 1 on in line 5, got 'f 0 1 2'"),
        (VERTICES + "f 1 2 -5", r"line 5, got 'f 1 2 -5'"),
        (VERTICES + "f 1 2 a", r"line 5, got 'f 1 2 a'"),
        (VERTICES + "f 1 2 9", r"vertex 9, but there are only 4"),
        (VERTICES + "f 1 2 99999999999999999999", r"vertex 99999999999999999999"),
    ],
)
def test_broken_files_name_the_line(read, text, culprit):
    with pytest.raises(SceneError, match=f"house.obj: .*{culprit}"):
        read(text)
