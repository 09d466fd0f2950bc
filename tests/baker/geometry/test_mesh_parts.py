"""What the triangles of a mesh enclose, part by part."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from navbake.baker.core.constants import CLOSED_SURFACE, OPEN_SURFACE
from navbake.baker.geometry.mesh_parts import split_mesh
from navbake.baker.geometry.shapes import GeomTriangles
from navbake.baker.geometry.shell_kernels import MAX_EDGES_OF_POINT, NOT_SHELL
from navbake.threads import limit_threads

TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
OUTWARD = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
SOLID = TETRAHEDRON[OUTWARD]
FAR_AWAY = SOLID[:1] + 50.0
SHEET = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0.0]]])


def box(size=(1.0, 1.0, 1.0), at=(0.0, 0.0, 0.0)):
    """Triangles of a box round a point, facing out."""
    return np.array(trimesh.creation.box(size).triangles) + np.array(at)


def turned(triangles):
    """The triangles, facing the other way."""
    return triangles[:, ::-1]


def split(*pieces) -> GeomTriangles:
    corners = np.concatenate(pieces).reshape(-1, 3)
    return split_mesh(corners, np.arange(len(corners)).reshape(-1, 3))


def codes(*pieces):
    """Of each piece, what its triangles enclose; fails where they differ within one."""
    closed = split(*pieces).closed
    ends = np.cumsum([len(piece) for piece in pieces])
    assert len(closed) == ends[-1]
    found = [set(part.tolist()) for part in np.split(closed, ends[:-1])]
    assert all(len(values) == 1 for values in found)
    return [values.pop() == CLOSED_SURFACE for values in found]


# ---------------------------------------------------------------- one part


def test_closed_and_open():
    assert codes(SOLID) == [True]
    assert codes(SOLID + 1e5) == [True]
    assert codes(SOLID[:3]) == [False]
    assert codes(turned(SOLID)) == [False]  # seen from inside: a room
    assert split(SOLID[:0]).closed.shape == (0,)


def test_kinds():
    assert split(SOLID).description == "closed surface"
    assert split(SHEET).description == "surface"
    assert split(SOLID, FAR_AWAY).description == "partly closed surface"


def test_closedness_by_index():
    assert split_mesh(TETRAHEDRON, OUTWARD).description == "closed surface"
    points = np.concatenate([box().reshape(-1, 3), TETRAHEDRON])
    assert split_mesh(points, OUTWARD + 36).description == "closed surface"
    assert split_mesh(TETRAHEDRON, OUTWARD[:, ::-1]).description == "surface"


def test_parts_are_numbered_from_one():
    found = split(SHEET + 9, SOLID, SOLID + 3)
    assert found.part.tolist() == [0] * 2 + [1] * 4 + [2] * 4


# ---------------------------------------------------------------- what hangs on them


def test_a_stray_triangle_opens_nothing():
    assert codes(SOLID, FAR_AWAY) == [True, False]


def test_an_open_part_beside_opens_nothing():
    assert codes(box(), SHEET + 5, box(at=(3, 0, 0))) == [True, False, True]


def test_a_fin_on_an_edge_opens_nothing():
    a, b = TETRAHEDRON[0], TETRAHEDRON[1]
    fin = np.array([[a, b, [0.5, -1.0, 0.0]]])
    assert codes(SOLID, fin) == [True, False]
    assert codes(SOLID, np.concatenate([fin, turned(fin)])) == [True, False]


def test_a_wall_of_triangles_on_a_slab_is_a_sheet():
    """It is peeled off ring by ring, from its free edges down to the one on the slab."""
    slab = box((1.0, 1.0, 1.0), (0.5, 0.5, -0.5))
    edge = slab.reshape(-1, 3)
    edge = np.unique(edge[(edge[:, 2] == 0) & (edge[:, 1] == 0)], axis=0)
    low, high = [np.append(p[:2], 0) for p in edge], [np.append(p[:2], 2) for p in edge]
    wall = np.array([[low[0], low[1], high[1]], [low[0], high[1], high[0]]])
    assert codes(slab, wall) == [True, False]
    assert codes(slab, np.concatenate([wall, turned(wall)])) == [True, False]


def test_both_sides_of_a_sheet_enclose_nothing():
    assert codes(np.concatenate([SHEET, turned(SHEET)])) == [False]
    # the other side cut along the other diagonal, so that each edge is met by a partner
    other = np.array([[[0, 0, 0], [0, 1, 0], [1, 0, 0]], [[1, 0, 0], [0, 1, 0], [1, 1, 0.0]]])
    assert codes(np.concatenate([SHEET, other])) == [False]


def test_boxes_that_touch_stay_closed():
    """They share an edge, a whole side with the same triangles, or corners only."""
    assert codes(box(), box(at=(1, 1, 0))) == [True, True]
    assert codes(box(), box(at=(1, 1, 1))) == [True, True]
    side = box()
    mirror = turned(side * [-1, 1, 1]) + np.array([1, 0, 0])
    assert codes(side, mirror) == [True, True]


def test_copies_and_empty_triangles_are_left_out():
    a, b = TETRAHEDRON[0], TETRAHEDRON[1]
    assert split(SOLID, [[a, b, b]]).description == "closed surface"
    found = split(SOLID, SOLID[2:3])
    assert found.description == "closed surface" and len(found.faces) == 4
    found = split(SOLID, np.roll(SOLID, 1, axis=1))
    assert found.description == "closed surface" and len(found.faces) == 4


# ---------------------------------------------------------------- triangles that face in


def test_one_that_faces_in_is_turned():
    for faulty in range(12):
        block = box()
        block[faulty] = turned(block[faulty : faulty + 1])[0]
        found = split(block)
        assert found.description == "closed surface, 1 turned"
        corners = block.reshape(-1, 3)[found.faces]
        volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum()
        assert volume / 6 == pytest.approx(1)


def test_the_larger_side_decides_by_area():
    mostly_in = np.concatenate([SOLID[:1], turned(SOLID[1:])])
    found = split(mostly_in)
    assert found.description == "surface"
    np.testing.assert_array_equal(found.faces, np.arange(12).reshape(-1, 3))  # nothing encloses
    found = split(np.concatenate([turned(SOLID[:1]), SOLID[1:]]))
    assert found.description == "closed surface, 1 turned"


def test_each_part_is_judged_by_itself():
    faulty = np.concatenate([turned(box()[:1]), box()[1:]])
    assert codes(faulty, turned(box()) + 3, SHEET + 6) == [True, False, False]


def test_a_strip_with_one_side_encloses_nothing():
    """A Möbius strip, closed to a projective plane by a cap: no side is the outer one."""
    faces = np.array(
        [(0, i, i % 5 + 1) for i in range(1, 6)]
        + [(i, i % 5 + 1, (i + 2) % 5 + 1) for i in range(1, 6)]
    )
    points = np.random.default_rng(1).uniform(0, 1, (6, 3))
    assert split_mesh(points, faces).description == "surface"


# ---------------------------------------------------------------- membranes


def grid_block(nx: int, ny: int, nz: int, walls: bool) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of a block of cells that faces out, and of the walls between its cells."""
    shell, inner = [], []
    for axis, count in enumerate((nx, ny, nz)):
        other = [(axis + 1) % 3, (axis + 2) % 3]
        for at in range(count + 1):
            if 0 < at < count and not walls:
                continue
            for i in range((nx, ny, nz)[other[0]]):
                for j in range((nx, ny, nz)[other[1]]):
                    corner = np.zeros((4, 3))
                    corner[:, axis] = at
                    corner[:, other[0]] = [i, i + 1, i + 1, i]
                    corner[:, other[1]] = [j, j, j + 1, j + 1]
                    if at == 0:
                        corner = corner[::-1]
                    (inner if 0 < at < count else shell).extend(corner[[[0, 1, 2], [0, 2, 3]]])
    return np.array(shell), np.array(inner).reshape(-1, 3, 3)


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("size", [(1, 1, 2), (3, 1, 1), (2, 2, 1), (1, 4, 1)])
def test_a_membrane_hollows_nothing(size, flip):
    """Walls without thickness inside of a block; they cross each other in some."""
    shell, inner = grid_block(*size, walls=True)
    assert codes(shell) == [True]
    found = codes(shell, turned(inner) if flip else inner)
    assert found == [True, False]


def test_a_membrane_and_a_triangle_that_faces_in():
    shell, inner = grid_block(1, 1, 2, walls=True)
    shell[0] = turned(shell[:1])[0]
    assert codes(shell, inner) == [True, False]


def test_a_block_that_faces_in_opens_no_other_one_at_its_edge():
    assert codes(box(), turned(box(at=(1, 1, 0)))) == [True, False]


# ---------------------------------------------------------------- cavities


def test_a_cavity_counts_inside_of_a_part_that_faces_out():
    assert codes(box((3, 3, 3)), turned(box())) == [True, True]
    assert codes(box((3, 3, 3)), turned(box(at=(9, 0, 0)))) == [True, False]
    # within the box round the tetrahedron, but beside it
    beyond = turned(SOLID * 0.1) + 0.6
    assert codes(SOLID, beyond) == [True, False]


def test_a_block_inside_of_a_cavity_is_closed():
    assert codes(box((5, 5, 5)), turned(box((3, 3, 3))), box()) == [True, True, True]


def test_cavities_at_random():
    """Against the solid angle under which a point of the cavity sees the part round it."""
    rng = np.random.default_rng(0)
    ball = np.array(trimesh.creation.icosphere(2).triangles) * [3, 2, 1.0]
    seen = set()
    for at in rng.uniform(-2.5, 2.5, (60, 3)) * [1, 0.7, 0.4]:
        if 0.9 < np.linalg.norm(at / [3, 2, 1]) < 1.05:  # the two may cross
            continue
        small = turned(box((0.01, 0.01, 0.01), at))
        a, b, c = np.moveaxis(ball - at, 1, 0)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        across = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        angle = 2 * np.arctan2((a * np.cross(b, c)).sum(1), across).sum()
        seen.add(inside := bool(angle > 2 * np.pi))
        assert codes(ball, small) == [True, inside]
    assert seen == {True, False}


def test_cavities_below_edges_and_corners_of_the_part_round_them():
    shell, _ = grid_block(2, 2, 2, walls=False)
    inner = turned(box((1, 1, 1), (1, 1, 1)))
    assert codes(shell, inner) == [True, True]
    assert codes(shell, inner - [0, 0, 5]) == [True, False]
    small = turned(SOLID * 0.3) - [0.1, 0.1, 0]  # the middle of its largest triangle is at 0, 0
    for x, y in itertools.product((0.5, 1, 1.5), (0.5, 1, 1.5)):
        assert codes(shell, small + np.array([x, y, 1])) == [True, True]


def test_rooms_drawn_from_inside_enclose_nothing():
    assert codes(turned(box((3, 3, 3))), box()) == [False, True]


# ---------------------------------------------------------------- at random


PIECES = {
    "box": (box(), True),
    "sheet": (SHEET, False),
    "room": (turned(box()), False),
    "cut": (box()[:-1], False),
    "ball": (np.array(trimesh.creation.icosphere(1).triangles), True),
}


@settings(max_examples=30, derandomize=True, deadline=None, database=None)
@given(
    st.lists(st.sampled_from(sorted(PIECES)), min_size=1, max_size=5),
    st.randoms(use_true_random=False),
)
def test_order_of_triangles_decides_nothing(names, random):
    pieces = [PIECES[name][0] + [5.0 * i, 0, 0] for i, name in enumerate(names)]
    corners = np.concatenate(pieces)
    expected = np.repeat([PIECES[name][1] for name in names], [len(piece) for piece in pieces])
    order = list(range(len(corners)))
    random.shuffle(order)
    found = split(corners[order])
    assert len(found.faces) == len(corners)
    np.testing.assert_array_equal(found.closed == CLOSED_SURFACE, expected[order])
    assert set(found.closed.tolist()) <= {OPEN_SURFACE, CLOSED_SURFACE}
    # no two closed pieces share a part
    owner = np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])[order]
    pairs = {(p, o) for p, o in zip(found.part.tolist(), owner.tolist(), strict=True) if p}
    assert len(pairs) == len({p for p, _ in pairs}) == len({o for _, o in pairs})


@pytest.mark.parametrize("subdivisions", [4])
def test_large_meshes(subdivisions):
    ball = np.array(trimesh.creation.icosphere(subdivisions).triangles)
    assert codes(ball) == [True]
    assert codes(ball[1:]) == [False]
    assert split(ball, ball[1:] + 5).description == "partly closed surface"


# ---------------------------------------------------------------- shells, the fast way


def draw_soup(rng):
    """Boxes on a lattice, touching or inside of each other, some broken, in any order."""
    pieces = []
    for _ in range(rng.integers(1, 6)):
        triangles = box(rng.integers(1, 4, 3), rng.integers(0, 5, 3) / 2)
        triangles = turned(triangles) if rng.random() < 0.3 else triangles
        one, other = rng.integers(12, size=2)
        if rng.random() < 0.3:  # a copy in place of another
            triangles[one] = triangles[other]
        if rng.random() < 0.3:
            triangles[one] = triangles[one, ::-1]
        if rng.random() < 0.3:
            triangles = np.delete(triangles, other, axis=0)
        pieces.append(triangles)
    soup = rng.permutation(np.concatenate(pieces))
    return np.stack([np.roll(triangle, rng.integers(3), axis=0) for triangle in soup])


@pytest.mark.parametrize("seed", range(100))
def test_shells_are_what_the_general_way_finds(seed, monkeypatch):
    soup = draw_soup(np.random.default_rng(seed))
    fast = split(soup)
    name = "navbake.baker.geometry.mesh_parts.label_shells"
    monkeypatch.setattr(name, lambda mate, shell: shell.fill(NOT_SHELL))
    general = split(soup)
    for name in ("faces", "part", "closed"):
        np.testing.assert_array_equal(getattr(fast, name), getattr(general, name))
    assert fast.description == general.description


@pytest.mark.parametrize("seed", range(3))
def test_many_points_on_several_threads(seed):
    """A torus and a sheet, of more points than one thread takes at once, in any order."""
    rng, num = np.random.default_rng(seed), 80
    row, col = np.divmod(np.arange(num * num), num)
    u, v = (2 * np.pi / num) * row, (2 * np.pi / num) * col
    torus = np.stack([(3 + np.cos(v)) * np.cos(u), (3 + np.cos(v)) * np.sin(u), np.sin(v)], axis=1)
    a, b = row * num + col, (row + 1) % num * num + col
    c, d = (row + 1) % num * num + (col + 1) % num, row * num + (col + 1) % num
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    inner = (row < num - 1) & (col < num - 1)
    sheet = np.stack([row * 1.0, col * 1.0, np.full(len(row), 9.0)], axis=1)
    of_sheet = faces[np.tile(inner, 2)] + len(torus)
    corners = np.concatenate([torus, sheet])[np.concatenate([faces, of_sheet])]
    order = rng.permutation(len(corners))
    soup = corners[order]
    with limit_threads(1):
        alone = split(soup)
    found = split(soup)
    np.testing.assert_array_equal(found.part, (order < len(faces)).astype(np.int32))
    for name in ("faces", "part", "closed"):
        np.testing.assert_array_equal(getattr(found, name), getattr(alone, name))


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize(
    "sides", [MAX_EDGES_OF_POINT - 1, MAX_EDGES_OF_POINT, MAX_EDGES_OF_POINT + 1, 5000]
)
def test_a_point_with_many_edges(sides, threads):
    """Two cones, base to base; the top comes first, and so all its edges are its own."""
    angle = np.arange(sides) * (2 * np.pi / sides)
    rim = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], axis=1)
    vertices = np.concatenate([[[0, 0, 1.0], [0, 0, -1.0]], rim])
    here, after = 2 + np.arange(sides), 2 + (np.arange(sides) + 1) % sides
    upper = np.stack([np.zeros(sides, dtype=int), here, after], axis=1)
    lower = np.stack([np.ones(sides, dtype=int), after, here], axis=1)
    faces = np.concatenate([upper, lower])
    above = vertices * (1.0, 1.0, -1.0) + (0.0, 0.0, 2.0)  # which has the same tip
    both = np.concatenate([vertices, above])
    with limit_threads(threads):
        found = split_mesh(vertices, faces)
        assert found.description == "closed surface"
        assert (found.part == 1).all()
        assert not split_mesh(vertices, faces[1:]).part.any()
        two = split_mesh(both, np.concatenate([faces, faces[:, ::-1] + len(vertices)]))
    assert two.description == "closed surface"
    np.testing.assert_array_equal(two.part, np.repeat([1, 2], len(faces)))


def test_a_fan_of_many_triangles_at_one_edge():
    """Each is a sheet, and the copies among them are dropped; in no time that grows as k²."""
    height = np.repeat(np.arange(20_000.0), 2)
    fan = np.zeros((len(height), 3, 3))
    fan[:, 1, 0], fan[:, 2, 1], fan[:, 2, 2] = 1.0, 1.0, height
    found = split(fan)
    assert len(found.part) == 20_000
    assert not found.part.any()
