"""Columns against MuJoCo's own scalar ray, geom by geom, and along seams where that one leaks.

Run ``NAVBAKE_EXAMPLES=500 pytest tests/baker/columns/test_columns.py`` for more scenes.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from navbake.baker.columns import rough_ground
from navbake.baker.columns.columns import Columns, cast_columns, cast_points, tile_shapes
from navbake.baker.columns.rough_ground import find_ground
from navbake.baker.scene.scene import Scene, load_scene
from navbake.config.settings import parse_config
from navbake.navgrid.lattice import Lattice
from navbake.threads import limit_threads

SEEDS = range(int(os.environ.get("NAVBAKE_EXAMPLES", "12")))
KINDS = ["plane", "rectangle", "hfield", "sphere", "capsule"]
KINDS += ["ellipsoid", "cylinder", "box", "mesh", "hull"]
NEAR = 2e-6  # lines this near to a rim may or may not cross it [m]


def numbers(values: object) -> str:
    return " ".join(repr(float(v)) for v in np.ravel(values))


def turned(rng: Generator) -> str:
    """A turn: any, upright with a yaw, or none; as a quaternion's text."""
    yaw = rng.uniform(-np.pi, np.pi)
    quats = [rng.normal(size=4), [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)], [1, 0, 0, 0]]
    return numbers(quats[rng.choice(3, p=[0.6, 0.25, 0.15])])


def geom_xml(kind: str, group: int, rng: Generator) -> tuple[str, str]:
    """An asset and a geom of a kind, somewhere."""
    place = f'pos="{numbers(rng.uniform(-0.6, 0.6, 3))}" quat="{turned(rng)}" group="{group}"'
    size = rng.uniform(0.05, 0.8, 3)
    name = f"a{group}"
    if kind == "plane":
        return "", f'<geom type="plane" size="0 0 1" {place}/>'
    if kind == "rectangle":
        contact = 'contype="0" conaffinity="0"'  # else it is endless
        return "", f'<geom type="plane" size="{size[0]} {size[1]} 1" {place} {contact}/>'
    if kind == "hfield":
        rows, cols = rng.integers(2, 9, 2)
        heights = numbers(rng.uniform(0, 1, (rows, cols)))
        asset = (
            f'<hfield name="{name}" nrow="{rows}" ncol="{cols}" elevation="{heights}" '
            f'size="{size[0]} {size[1]} {rng.uniform(0.1, 0.5)} {rng.uniform(0.05, 0.3)}"/>'
        )
        return asset, f'<geom type="hfield" hfield="{name}" {place}/>'
    if kind in ("mesh", "hull"):
        points = rng.uniform(-0.6, 0.6, (rng.integers(5, 12), 3))
        faces = outward_faces(points) if kind == "hull" else soup(len(points), rng)
        asset = (
            f'<mesh name="{name}" inertia="shell" vertex="{numbers(points)}" '
            f'face="{" ".join(map(str, np.ravel(faces)))}"/>'
        )
        contact = "" if kind == "hull" else 'contype="0" conaffinity="0"'
        return asset, f'<geom type="mesh" mesh="{name}" {place} {contact}/>'
    return "", f'<geom type="{kind}" size="{numbers(size)}" {place}/>'


def outward_faces(points: NDArray) -> NDArray:
    hull = ConvexHull(points)
    a, b, c = (points[hull.simplices[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0
    faces = hull.simplices.copy()
    faces[inward] = faces[inward][:, ::-1]
    return faces


def soup(num: int, rng: Generator) -> NDArray:
    """Triangles between any points, closed nowhere, through each other."""
    every = np.array(list(itertools.permutations(range(num), 3)))
    faces = rng.permutation(every)[:14]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return faces[first]


def load(folder: Path, xml: str, **settings: object) -> Scene:
    path = folder / "scene.xml"
    path.write_text(xml)
    config = {"scene": {"path": str(path), "geoms": "all", **settings}}
    return load_scene(parse_config(config))


def cast(scene: Scene, lattice: Lattice, threads: int = 2) -> Columns:
    with limit_threads(threads):
        return cast_columns(tile_shapes(scene.shapes, lattice, 0.1))


def column(columns: Columns, cell: int, geom: int) -> tuple[NDArray, NDArray]:
    """Heights and normals of one geom's hits in a cell."""
    part = slice(columns.start[cell], columns.start[cell + 1])
    own = columns.geom[part] == geom
    return columns.z[part][own], columns.normal[part][own]


def mujoco_column(scene: Scene, x: float, y: float, geom: int) -> tuple[NDArray, NDArray]:
    """Heights, ascending, and normals of one geom's hits by repeated mj_ray.

    Downwards, each ray starting just below the hit before; planes answer from their front only,
    so that rays go up as well.
    """
    model, data = scene.model, scene.data
    group = np.zeros(6, dtype=np.uint8)
    group[model.geom_group[geom]] = 1
    hit, normal = np.zeros(1, dtype=np.int32), np.zeros(3)
    found = []
    for way in (-1.0, 1.0):
        if way > 0 and model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE:
            break
        start = -5.0 * way
        while True:
            distance = mujoco.mj_ray(
                model, data, [x, y, start], [0, 0, way], group, True, -1, hit, normal
            )
            if distance < 0:
                break
            assert hit[0] == geom
            height = start + way * distance
            if not _is_inside_field(scene, [x, y, height], geom):
                found.append((height, *normal))
            start = height + way * 1e-8
    hits = np.array(sorted(found)).reshape(-1, 4)
    return hits[:, 0], hits[:, 1:]


def _is_inside_field(scene: Scene, point: list[float], geom: int) -> bool:
    """Whether a point is on the face that mj_ray has between a height field and its base."""
    if scene.model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_HFIELD:
        return False
    mat = scene.data.geom_xmat[geom].reshape(3, 3)
    return abs((np.array(point) - scene.data.geom_xpos[geom]) @ mat[:, 2]) < 1e-9


def near_rim(scene: Scene, x: float, y: float, geom: int) -> bool:
    """Whether lines a hair beside cross something else."""
    turns = np.arange(8) * np.pi / 4 + 0.2
    nearby = [
        mujoco_column(scene, x + NEAR * np.cos(t), y + NEAR * np.sin(t), geom)[1] for t in turns
    ]
    first = nearby[0]
    return any(n.shape != first.shape or np.abs(n - first).max(initial=0) > 1e-3 for n in nearby)


@pytest.mark.parametrize("seed", SEEDS)
def test_each_geom_is_crossed_as_mj_ray_crosses_it(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    kinds = rng.choice(KINDS, 6)
    assets, geoms = zip(*(geom_xml(k, group, rng) for group, k in enumerate(kinds)), strict=True)
    scene = load(
        tmp_path,
        f"<mujoco><asset>{''.join(assets)}</asset><worldbody>{''.join(geoms)}</worldbody></mujoco>",
    )
    half = rng.uniform(0.8, 1.3)
    lattice = Lattice.cover((-half, -half, half + 0.137, half), rng.uniform(0.06, 0.2))
    columns = cast(scene, lattice)
    check_order(columns)
    skipped = compared = 0
    for cell in range(lattice.width * lattice.height):
        x, y = lattice.positions(*divmod(cell, lattice.width))
        for geom, kind in enumerate(kinds):
            z, normal = column(columns, cell, geom)
            expected_z, expected_normal = mujoco_column(scene, x, y, geom)
            if "turned" in scene.geoms[geom].shape and len(z) == len(expected_z):
                # navbake turns triangles of closed meshes that face in, MuJoCo's rays do not
                is_turned = np.einsum("ij,ij->i", normal, expected_normal) < 0
                expected_normal = np.where(is_turned[:, None], -expected_normal, expected_normal)
            agrees = (
                len(z) == len(expected_z)
                and np.abs(normal - expected_normal).max(initial=0.0) <= 1e-5
            )
            if not agrees and near_rim(scene, x, y, geom):
                skipped += 1
                continue
            where = f"{kind} {geom} at {x}, {y}"
            assert len(z) == len(expected_z), f"{where}: {z}, mj_ray: {expected_z}"
            assert np.abs(z - expected_z).max(initial=0.0) <= 1e-7, f"{where}: {z}, {expected_z}"
            assert agrees, f"{where}: {normal}, mj_ray: {expected_normal}"
            compared += len(z)
    assert compared > 100
    assert skipped <= 3


def check_order(columns: Columns) -> None:
    """Heights ascend in each column, normals are unit vectors."""
    assert columns.start[0] == 0
    assert columns.start[-1] == len(columns.z) == len(columns.normal) == len(columns.geom)
    rises = np.diff(columns.z) >= 0
    new_column = np.zeros(len(columns.z) + 1, dtype=bool)
    new_column[columns.start] = True
    assert (rises | new_column[1:-1]).all()
    assert np.abs(np.linalg.norm(columns.normal, axis=1) - 1).max(initial=0) < 1e-5


@pytest.mark.parametrize("seed", [0, 1])
def test_threads_change_nothing(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    parts = [geom_xml(kind, group % 6, rng) for group, kind in enumerate(KINDS)]
    assets = "".join(a.replace('name="a', f'name="{k}a') for k, (a, _) in enumerate(parts))
    geoms = "".join(
        g.replace('mesh="a', f'mesh="{k}a').replace('field="a', f'field="{k}a')
        for k, (_, g) in enumerate(parts)
    )
    scene = load(
        tmp_path, f"<mujoco><asset>{assets}</asset><worldbody>{geoms}</worldbody></mujoco>"
    )
    lattice = Lattice.cover((-1.0, -1.1, 1.2, 1.0), 0.02)
    once, twice = cast(scene, lattice, threads=1), cast(scene, lattice, threads=2)
    check_order(once)
    assert len(once.z) > len(once.start)
    for name in ("start", "z", "normal", "geom"):
        np.testing.assert_array_equal(getattr(once, name), getattr(twice, name), err_msg=name)


def aligned_xml(rng: Generator) -> str:
    """Geoms of all kinds, and some whose rims and edges run through the centres of a raster."""
    parts = [geom_xml(kind, group % 6, rng) for group, kind in enumerate(rng.choice(KINDS, 8))]
    assets = "".join(a.replace('name="a', f'name="{k}a') for k, (a, _) in enumerate(parts))
    geoms = "".join(
        g.replace('mesh="a', f'mesh="{k}a').replace('field="a', f'field="{k}a')
        for k, (_, g) in enumerate(parts)
    )
    for kind in ("box", "cylinder", "sphere", "capsule", "ellipsoid"):
        pos, size = np.round(rng.uniform(-0.8, 0.8, 3), 1), np.round(rng.uniform(0.1, 0.5, 3), 1)
        yaw = rng.choice([0, 30, 45, 90])
        place = f'pos="{numbers(pos)}" euler="0 0 {yaw}"'
        geoms += f'<geom type="{kind}" size="{numbers(size)}" {place}/>'
    heights = numbers(np.round(rng.uniform(0, 1, (9, 9)), 1))
    assets += f'<hfield name="f" nrow="9" ncol="9" elevation="{heights}" size=".8 .8 .5 .1"/>'
    geoms += '<geom type="hfield" hfield="f" pos="0 0 -1"/>'
    return f"<mujoco><asset>{assets}</asset><worldbody>{geoms}</worldbody></mujoco>"


@pytest.mark.parametrize("seed", SEEDS)
def test_lines_together_cross_what_each_crosses_by_itself(tmp_path: Path, seed: int) -> None:
    """Geometry that visits cells against one line at a time that asks all geometry nearby."""
    rng = np.random.default_rng(seed)
    scene = load(tmp_path, aligned_xml(rng))
    corner = rng.uniform(-1.3, -0.7, 2)
    for lattice in (
        Lattice(-1.05, 1.05, 0.1, 21, 21),
        Lattice(corner[0], -corner[1], rng.uniform(0.01, 0.05), 37, 41),
    ):
        tiled = tile_shapes(scene.shapes, lattice, 0.1)
        cells = np.arange(lattice.width * lattice.height)
        centers = lattice.positions(*np.divmod(cells, lattice.width))
        alone, together = cast_points(tiled, cells, centers), cast_columns(tiled).hits
        assert len(alone.z)
        for name in ("start", "z", "normal", "geom", "closed"):
            one, other = getattr(alone, name), getattr(together, name)
            np.testing.assert_array_equal(one, other, err_msg=name)


@pytest.mark.parametrize("seed", SEEDS)
def test_ground_is_the_highest_hit_near_a_height_that_faces_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    """At points anywhere, and at cells' centres, through which edges of the height field run.

    None outside of the lattice, also where shapes are. Many points are divided among threads.
    """
    rng = np.random.default_rng(seed)
    scene = load(tmp_path, aligned_xml(rng))
    lattice = Lattice(-1.05, 1.05, 0.1, 21, 21)
    tiled = tile_shapes(scene.shapes, lattice, 0.1)
    cells = rng.integers(0, 21 * 21, 2000)
    points = lattice.positions(*np.divmod(cells, 21))
    points[::2] += rng.uniform(-0.05, 0.05, (1000, 2))
    z = rng.uniform(-1.2, 0.5, 2000)
    expected = np.full(2000, np.nan)
    hits = cast_points(tiled, cells, points)
    for line, (first, end) in enumerate(itertools.pairwise(hits.start)):
        for hit in range(first, end):
            if hits.normal[hit, 2] > 0 and abs(hits.z[hit] - z[line]) <= 0.3:
                expected[line] = hits.z[hit] - z[line]
    np.testing.assert_array_equal(find_ground(tiled, points, z, 0.3), expected)
    outside = points + [[2.1, 0], [-2.1, 0], [0, 2.1], [0, -2.1]] * 500
    assert np.isnan(find_ground(tiled, outside, z, 0.3)).all()
    np.testing.assert_array_equal(
        find_ground(tiled, np.concatenate([outside, points]), np.tile(z, 2), 0.3)[2000:], expected
    )
    assert 100 < np.isnan(expected).sum() < 1900
    with limit_threads(1):
        np.testing.assert_array_equal(find_ground(tiled, points, z, 0.3), expected)
    monkeypatch.setattr(rough_ground, "MIN_LINES_PER_CALL", 10)
    np.testing.assert_array_equal(find_ground(tiled, points, z, 0.3), expected)


@pytest.mark.parametrize("seed", range(3))
def test_slivers_across_many_cells(tmp_path: Path, seed: int) -> None:
    """Triangles that are long, thin and askew: rows' spans must lose none of their cells."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (300, 3))
    points[1::3] = points[::3] + rng.normal(size=(100, 3)) * 10 ** rng.uniform(-4, -1, (100, 1))
    faces = " ".join(map(str, range(300)))
    scene = load(
        tmp_path,
        f'<mujoco><asset><mesh name="m" inertia="shell" vertex="{numbers(points)}" face="{faces}"/>'
        '</asset><worldbody><geom type="mesh" mesh="m" contype="0" conaffinity="0"/></worldbody>'
        "</mujoco>",
        meshes="surface",
    )
    tiled = tile_shapes(scene.shapes, Lattice(-1.0, 1.0, 0.01, 200, 200), 0.1)
    cells = np.arange(200 * 200)
    centers = tiled.lattice.positions(*np.divmod(cells, 200))
    alone, together = cast_points(tiled, cells, centers), cast_columns(tiled).hits
    assert len(alone.z) > 50
    np.testing.assert_array_equal(alone.start, together.start)
    np.testing.assert_array_equal(alone.z, together.z)


# ---------------------------------------------------------------- seams


def tops(columns: Columns) -> NDArray:
    """How many hits of each column face up."""
    up = np.concatenate([[0], np.cumsum(columns.normal[:, 2] > 0)])
    return np.diff(up[columns.start])


def quad(folder: Path, seed: int) -> tuple[Scene, NDArray]:
    """A tilted quad of two triangles, and the ends of the edge that they share."""
    rng = np.random.default_rng(seed)
    corners = np.array([[-3.0, -2, 0], [3, -2, 0], [3, 2, 0], [-3, 2, 0]])
    corners[:, 2] = corners[:, :2] @ rng.uniform(-1, 1, 2)
    scene = load(
        folder,
        f'<mujoco><asset><mesh name="q" inertia="shell" vertex="{numbers(corners)}" '
        'face="0 1 2 0 2 3"/></asset><worldbody><geom type="mesh" mesh="q" contype="0" '
        'conaffinity="0"/></worldbody></mujoco>',
    )
    model, data = scene.model, scene.data
    vertices = model.mesh_vert.astype(np.float64) @ data.geom_xmat[0].reshape(3, 3).T
    shared = sorted(set(model.mesh_face[0]) & set(model.mesh_face[1]))
    return scene, (vertices + data.geom_xpos[0])[shared]


@pytest.mark.parametrize("seed", range(3))
def test_an_edge_of_two_triangles_never_leaks(tmp_path: Path, seed: int) -> None:
    """Lines that meet the edge to the last bit, of which mj_ray misses a few."""
    scene, (one, other) = quad(tmp_path, seed)
    lines = np.random.default_rng(seed).uniform(0.01, 0.99, 2000)
    points = one + lines[:, None] * (other - one)
    missed = np.array([not len(mujoco_column(scene, x, y, 0)[0]) for x, y, _ in points])
    print(f"mj_ray misses {missed.sum()} of {len(points)} lines")
    for x, y, z in [*points[missed], *points[:100]]:
        columns = cast(scene, Lattice(x - 0.05, y + 0.05, 0.1, 1, 1))
        np.testing.assert_allclose(columns.z, [z], atol=1e-9)


@pytest.mark.parametrize("threads", [1, 2])
def test_an_edge_of_two_triangles_is_crossed_once(tmp_path: Path, threads: int) -> None:
    """The edge runs through the centres of 201 cells, as near as float32 vertices have it.

    One of two hits is dropped there, and those of all further lines move up.
    """
    scene, _ = quad(tmp_path, seed=0)
    lattice = Lattice.cover((-2.9, -1.9, 2.9, 1.9), 0.01, margin=0.005)
    x, y = np.meshgrid(lattice.center_x(), lattice.center_y())
    assert (np.abs(2 * x - 3 * y) < 1e-9).sum() > 190
    columns = cast(scene, lattice, threads)
    np.testing.assert_array_equal(np.diff(columns.start), 1)
    steepness = np.random.default_rng(0).uniform(-1, 1, 2)
    expected = (np.stack([x, y], axis=-1) @ steepness).ravel()
    np.testing.assert_allclose(columns.z, expected, atol=1e-6)
    assert len(columns.normal) == len(columns.geom) == len(columns.hits.closed) == x.size


def box(center: NDArray, half: NDArray, yaw: float) -> str:
    quat = numbers([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])
    return f'<geom type="box" size="{numbers(half)}" pos="{numbers(center)}" quat="{quat}"/>'


@pytest.mark.parametrize(("rise", "run"), [(0, 1), (1, 1), (1, 2), (3, 2), (1, 5), (4, 1)])
@pytest.mark.parametrize("gap", [0.0, 1e-9, -1e-9, 1e-7])
def test_a_seam_of_two_boxes_never_leaks(tmp_path: Path, rise: int, run: int, gap: float) -> None:
    """Two floor boxes side by side; their seam runs through cells' centres."""
    yaw = np.arctan2(rise, run)
    along, across = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    middle = np.array([0.3, -0.7])
    half = np.array([1.5, 0.5, 0.1])
    boxes = [
        box([*(middle + side * across * (half[1] + gap / 2)), 0.25], half, yaw) for side in (-1, 1)
    ]
    scene = load(tmp_path, f"<mujoco><worldbody>{''.join(boxes)}</worldbody></mujoco>")
    cell, num = 0.05, 81
    lattice = Lattice(middle[0] - cell * num / 2, middle[1] + cell * num / 2, cell, num, num)
    columns = cast(scene, lattice)
    x, y = np.meshgrid(lattice.center_x() - middle[0], lattice.center_y() - middle[1])
    u, v = x * along[0] + y * along[1], x * across[0] + y * across[1]
    inside = (np.abs(u) < half[0] - NEAR) & (np.abs(v) < 2 * half[1] - NEAR)
    assert (inside & (np.abs(v) < 1e-9)).sum() > 10
    assert (tops(columns).reshape(num, num)[inside] >= 1).all()
    np.testing.assert_allclose(columns.z[columns.normal[:, 2] > 0], 0.35, atol=1e-9)
    for geom in (0, 1):  # each box is entered as often as it is left
        sides = np.where(columns.normal[:, 2] > 0, 1, -1) * (columns.geom == geom)
        total = np.concatenate([[0], np.cumsum(sides)])[columns.start]
        np.testing.assert_array_equal(np.diff(total), 0)


TANGENT = {
    "sphere": 'type="sphere" size="0.2"',
    "ellipsoid": 'type="ellipsoid" size="0.2 0.1 0.3"',
    "cylinder": 'type="cylinder" size="0.2 0.3"',
    "lying cylinder": 'type="cylinder" size="0.2 0.3" quat="1 1 0 0"',
    "lying capsule": 'type="capsule" size="0.1 0.2" quat="1 0 1 0"',
    "box": 'type="box" size="0.2 0.1 0.3" quat="1 0 0 1"',
    "box on its edge": f'type="box" size="{0.1 * 2**0.5!r} {0.1 * 2**0.5!r} 0.3" euler="45 90 0"',
}


@pytest.mark.parametrize("name", TANGENT)
@pytest.mark.parametrize("shift", [0.0, 1e-9, 0.3])
def test_a_solid_is_entered_as_often_as_it_is_left(tmp_path: Path, name: str, shift: float) -> None:
    """Lines that only graze a side among them."""
    scene = load(
        tmp_path,
        f"<mujoco><worldbody><body pos='{shift} 0 0'><geom {TANGENT[name]}/></body>"
        "</worldbody></mujoco>",
    )
    num, cell = 13, 0.1
    lattice = Lattice(-cell * num / 2, cell * num / 2, cell, num, num)
    columns = cast(scene, lattice)
    up = tops(columns)
    np.testing.assert_array_equal(np.diff(columns.start), 2 * up)
    assert set(up) == {0, 1}


@pytest.mark.parametrize("yaw", [0.0, np.pi / 2, 0.3])
def test_lines_through_the_points_of_a_height_field_cross_it_once(
    tmp_path: Path, yaw: float
) -> None:
    rng = np.random.default_rng(3)
    num, cell = 9, 0.125
    heights = rng.uniform(0, 1, (num, num))
    quat = numbers([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])
    scene = load(
        tmp_path,
        f'<mujoco><asset><hfield name="h" nrow="{num}" ncol="{num}" '
        f'elevation="{numbers(heights)}" size="0.5 0.5 0.4 0.1"/></asset><worldbody>'
        f'<geom type="hfield" hfield="h" quat="{quat}"/></worldbody></mujoco>',
    )
    lattice = Lattice(-cell * num / 2, cell * num / 2, cell, num, num)
    columns = cast(scene, lattice)
    x, y = np.meshgrid(lattice.center_x(), lattice.center_y())
    u, v = x * np.cos(yaw) + y * np.sin(yaw), y * np.cos(yaw) - x * np.sin(yaw)
    inside = (np.maximum(np.abs(u), np.abs(v)) < 0.5 + 1e-9).ravel()
    np.testing.assert_array_equal(np.diff(columns.start), np.where(inside, 2, 0))
    np.testing.assert_array_equal(tops(columns), np.where(inside, 1, 0))
    if yaw == 0.0:
        data = scene.model.hfield_data.reshape(num, num)[::-1]  # rows run against y
        expected = data.astype(np.float64).ravel() * 0.4
        np.testing.assert_allclose(columns.z[columns.normal[:, 2] > 0], expected, atol=1e-6)


@pytest.mark.parametrize("kind", ["hull", "surface"])
def test_lines_through_edges_and_corners_of_a_mesh_cross_it_twice(
    tmp_path: Path, kind: str
) -> None:
    """A cube of 24 triangles, with a corner in the middle of its top and of its bottom."""
    corners = [(x, y, z) for z in (0.0, 1.0) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    vertices = [*corners, (0.5, 0.5, 0.0), (0.5, 0.5, 1.0)]
    faces = []
    for i in range(4):
        j = (i + 1) % 4
        faces += [(j, i, 8), (i + 4, j + 4, 9), (i, j, j + 4), (i, j + 4, i + 4)]
    scene = load(
        tmp_path,
        f'<mujoco><asset><mesh name="c" vertex="{numbers(vertices)}" '
        f'face="{" ".join(map(str, np.ravel(faces)))}"/></asset><worldbody>'
        '<geom type="mesh" mesh="c" pos="-0.5 -0.5 0"/></worldbody></mujoco>',
        meshes=kind,
    )
    num, cell = 11, 0.1
    lattice = Lattice(-cell * num / 2, cell * num / 2, cell, num, num)
    columns = cast(scene, lattice)
    np.testing.assert_array_equal(np.diff(columns.start), 2)
    np.testing.assert_allclose(columns.z.reshape(-1, 2), [[0.0, 1.0]] * num**2, atol=1e-6)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("kind", ["hull", "surface"])
def test_line_within_an_upright_side_enters_as_often_as_it_leaves(
    tmp_path: Path, seed: int, kind: str
) -> None:
    """The halves of a gabled roof meet in upright sides over a row of cells' centres."""
    rng = np.random.default_rng(seed)
    rise, over, eave = rng.uniform(0.35, 0.8), rng.uniform(0, 0.3), rng.uniform(2, 12)
    assets, geoms, middle = "", "", float(rng.uniform(-1, 1))
    for side in (-1.0, 1.0):
        line = [(middle + side * 3.1, eave), (middle, eave + rise * 3.1)]
        points = [
            (x, y, z + t) for y in (-3 - over, 3 + over) for x, z in line for t in (0.0, 0.12)
        ]
        name = "left" if side < 0 else "right"
        faces = " ".join(map(str, np.ravel(outward_faces(np.array(points)))))
        assets += f'<mesh name="{name}" vertex="{numbers(points)}" face="{faces}"/>'
        geoms += f'<geom type="mesh" mesh="{name}"/>'
    xml = f"<mujoco><asset>{assets}</asset><worldbody>{geoms}</worldbody></mujoco>"
    scene = load(tmp_path, xml, meshes=kind)
    lattice = Lattice(middle - 0.75, 2.9, 0.1, 15, 58)
    columns = cast(scene, lattice)
    for cell in range(lattice.width * lattice.height):
        for geom in (0, 1):
            z, normal = column(columns, cell, geom)
            assert (normal[:, 2] > 0).sum() == (normal[:, 2] < 0).sum(), (cell, z)
    # and no line slips through between the two
    assert (np.diff(columns.start) >= 2).all()


CROSSED: dict[str, tuple[str, Callable[[float, float], list[float]]]] = {
    "front up": ('size="0 0 1"', lambda x, y: [0.0]),
    "front down": ('size="0 0 1" quat="0 1 0 0"', lambda x, y: [0.0]),
    "upright": ('size="0 0 1" quat="1 1 0 0"', lambda x, y: []),
    "strip": (
        'size="0.3 0 1" pos="0 0 0.5" contype="0" conaffinity="0"',
        lambda x, y: [0.5] if abs(x) < 0.3 else [],
    ),
}


@pytest.mark.parametrize("name", CROSSED)
def test_planes(tmp_path: Path, name: str) -> None:
    attributes, expected = CROSSED[name]
    scene = load(
        tmp_path,
        f'<mujoco><worldbody><geom type="plane" {attributes}/></worldbody></mujoco>',
    )
    lattice = Lattice.cover((-0.51, -0.52, 0.53, 0.54), 0.05)
    columns = cast(scene, lattice)
    for cell in range(lattice.width * lattice.height):
        x, y = lattice.positions(*divmod(cell, lattice.width))
        z, normal = column(columns, cell, 0)
        np.testing.assert_allclose(z, expected(x, y), atol=1e-12)
        np.testing.assert_allclose(normal[:, 2], -1.0 if name == "front down" else 1.0)


def test_lines_at_points_are_the_same_on_any_number_of_threads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load(tmp_path, aligned_xml(np.random.default_rng(5)))
    lattice = Lattice(-1.05, 1.05, 0.1, 21, 21)
    cells = np.arange(21 * 21)
    tiled, points = tile_shapes(scene.shapes, lattice, 0.1), lattice.positions(*divmod(cells, 21))
    whole = cast_points(tiled, cells, points)
    monkeypatch.setattr("navbake.baker.columns.columns.MIN_POINTS_PER_CALL", 7)
    with limit_threads(2):
        parts = cast_points(tiled, cells, points)
    for one, other in zip(whole, parts, strict=True):
        np.testing.assert_array_equal(one, other)
    assert cast_points(tiled, cells[:0], points[:0]).start.tolist() == [0]
