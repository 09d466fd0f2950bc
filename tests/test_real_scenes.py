"""Scenes that nobody here made, against what is known of them from elsewhere.

They lie beside the repository, and without them these tests skip. Areas and level counts of
the Recast meshes were measured with navbake and looked at; all else is from the scenes' own
files, their published maps or plain geometry done here.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from navbake.baker.bake.pipeline import BakeResult, run_bake
from navbake.baker.readers.mesh import read_named_meshes
from navbake.baker.scene.scene import load_scene
from navbake.config.settings import parse_config
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.islands import find_islands
from original_client import look_up
from project_paths import SHARED_DATA

DATA = SHARED_DATA
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"no real scenes in {DATA}")

STEP, HEADROOM = 0.25, 1.14  # metres, the default agent

SCENES: dict[str, dict[str, Any]] = {
    "aws_small_house": {
        "scene": {"path": "aws_small_house/scene.xml", "meshes": "surface"},
        "grid": {"cell_size": 0.05},
    },
    "turtlebot3_world": {
        "scene": {"path": "turtlebot3_world/scene.xml", "meshes": "surface"},
        "grid": {"cell_size": 0.05},
    },
    "trimesh_3storey": {
        "scene": {"path": "trimesh_3storey/no_indices_3storybuilding.glb", "up": "y"}
        | {"meshes": "shell"},
        "grid": {"cell_size": 0.2},
        "floors": {"roofs": True},
    },
    # an infinite plane is no part of the lattice's box, so the way to the stair needs a margin
    "playground_go1": {
        "scene": {"path": "playground_go1/scene_mjx_feetonly_stairs.xml"},
        "grid": {"margin": 1.0},
    },
    "unitree_go2": {
        "scene": {"path": "unitree_go2/scene_terrain.xml"},
        "grid": {"cell_size": 0.05, "margin": 0.5},
    },
    "nav_test": {"scene": {"path": "recast_meshes/nav_test.obj", "up": "y"}},
    "dungeon": {"scene": {"path": "recast_meshes/dungeon.obj", "up": "y"}},
    "simple_room": {"scene": {"path": "habitat_simple_room/simple_room.glb", "up": "z"}},
    "stage_floor1": {"scene": {"path": "habitat_simple_room/stage_floor1.glb", "up": "y"}},
}


def config_of(name: str) -> Any:
    return parse_config(SCENES[name], folder=DATA)


@cache
def bake(name: str) -> BakeResult:
    return run_bake(config_of(name))


def levels_of(name: str) -> list[SceneGrid2D]:
    return bake(name).grid.levels


def area(level: SceneGrid2D, mask: NDArray[np.bool_]) -> float:
    """The area of a mask's cells [m²]."""
    return float(np.count_nonzero(mask)) * level.lattice.cell_size**2


def island_areas(name: str) -> NDArray[np.float64]:
    """The areas of the connected parts, over all levels, the largest first [m²]."""
    grid = bake(name).grid
    islands = np.concatenate([island.ravel() for island in find_islands(grid)])
    return np.bincount(islands)[1:] * grid.levels[0].lattice.cell_size ** 2


# ---------------------------------------------------------------- what holds for all of them


@pytest.mark.parametrize("name", SCENES)
def test_levels_fit_together(name):
    """The original client finds cells, nothing free shares its headroom, links are steps."""
    grid = bake(name).grid
    boxes = np.array([level.bbox_yup for level in grid.levels])
    assert (boxes[:, 1] > boxes[:, 0]).all()
    found = look_up(grid)
    assert found.lost == look_up(grid, by_cells=True).lost <= 0.015 * found.free
    told = [warning for warning in bake(name).warnings if f"misses {found.lost} of" in warning]
    assert len(told) == (found.lost > 0)

    origin = grid.levels[0].lattice
    columns = []
    for level in grid.levels:
        assert np.isfinite(level.floor_height[level.free]).all()
        rows, cols = origin.rows_cols(level.lattice.positions(*np.nonzero(level.free)))
        columns.append(np.stack([rows, cols, level.floor_height[level.free]], axis=1))
    standing = np.concatenate(columns)
    standing = standing[np.lexsort(standing.T[::-1])]
    same_column = (np.diff(standing[:, :2], axis=0) == 0).all(axis=1)
    assert (np.diff(standing[:, 2])[same_column] >= HEADROOM - 1e-4).all()

    for level_a, cell_a, level_b, cell_b in grid.step_array.tolist():
        a, b = grid.levels[level_a], grid.levels[level_b]
        at_a, at_b = divmod(cell_a, a.width), divmod(cell_b, b.width)
        apart = a.lattice.positions(*at_a) - b.lattice.positions(*at_b)
        assert np.hypot(*apart) == pytest.approx(a.lattice.cell_size)
        assert abs(a.floor_height[at_a] - b.floor_height[at_b]) <= STEP + 1e-4


# ---------------------------------------------------------------- published maps


def read_map(folder: Path) -> NDArray[np.float64]:
    """World x, y of the occupied cells' centres of a ROS map, shape (n, 2) [m]."""
    meta = yaml.safe_load((folder / "map.yaml").read_text())
    content = (folder / meta["image"]).read_bytes()
    lines = [line for line in content.split(b"\n", 5) if not line.startswith(b"#")]
    assert lines[0] == b"P5"
    width, height = map(int, lines[1].split())
    pixels = np.frombuffer(content[-width * height :], dtype=np.uint8).reshape(height, width)
    assert meta["negate"] == 0
    row, col = np.nonzero((255 - pixels.astype(float)) / 255 > meta["occupied_thresh"])
    center = np.stack([col + 0.5, height - row - 0.5], axis=1)  # the first row is the top
    return np.array(meta["origin"][:2]) + center * meta["resolution"]


def distances_to_cells(
    points: NDArray[np.float64], level: SceneGrid2D, mask: NDArray[np.bool_], within: float
) -> NDArray[np.float64]:
    """From each point to the nearest square of a mask's cells, inf beyond `within` [m]."""
    lattice = level.lattice
    rows, cols = lattice.rows_cols(points)
    reach = int(np.ceil(within / lattice.cell_size)) + 1
    padded = np.pad(mask, reach)
    nearest = np.full(len(points), np.inf)
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            center = lattice.positions(rows + down, cols + right)
            gap = np.maximum(np.abs(points - center) - lattice.cell_size / 2, 0.0)
            distance = np.hypot(gap[:, 0], gap[:, 1])
            there = padded[rows + down + reach, cols + right + reach]
            nearest = np.where(there, np.minimum(nearest, distance), nearest)
    return nearest


# what an obstacle in every cell would find: the maps have free space, too
@pytest.mark.parametrize(
    ("name", "expected", "at_most"),
    [("aws_small_house", 0.95, 0.25), ("turtlebot3_world", 1, 0.35)],
)
def test_published_map(name, expected, at_most):
    (level,) = levels_of(name)
    points = read_map(DATA / name)
    x_min, y_min, x_max, y_max = level.lattice.bounds
    inside = ((points > (x_min, y_min)) & (points < (x_max, y_max))).all(axis=1)
    assert inside.sum() > 500
    floor = np.isfinite(level.floor_height)
    obstacle = (level.occupancy == 1) & floor
    near = distances_to_cells(points[inside], level, obstacle, 0.1) <= 0.1
    assert near.mean() >= expected
    assert obstacle.sum() < at_most * floor.sum()


def test_small_house_is_one_walk():
    assert island_areas("aws_small_house")[0] > 140.0
    assert island_areas("aws_small_house")[1] < 5.0  # inside of walls that are hollow


def test_turtlebot3_pillars():
    """Nine cylinders of radius 0.15 m, 0.2 m with the agent's disc, which covers the cell."""
    (level,) = levels_of("turtlebot3_world")
    lattice = level.lattice
    center = lattice.positions(*np.indices(lattice.shape))
    offsets = np.array([[x, y] for x in (-1.1, 0.0, 1.1) for y in (-1.1, 0.0, 1.1)])
    distance = np.linalg.norm(center[:, :, None] - offsets, axis=-1).min(axis=-1)
    middle = np.hypot(center[..., 0], center[..., 1]) < 1.7  # nothing else stands there
    clear = middle & (np.abs(distance - 0.2) > 1e-5)
    assert (level.occupancy[clear] == (distance < 0.2)[clear]).all()
    assert (level.free[clear] == (distance > 0.2)[clear]).all()


# ---------------------------------------------------------------- storeys and stairs


def test_three_storeys():
    """Storeys drawn as closed boxes; as solids two of three would be lost, which a warning says."""
    levels = levels_of("trimesh_3storey")
    assert [level.ground for level in levels] == pytest.approx([3.0, 6.0, 9.0], abs=1e-5)
    for level in levels:
        floor = np.isfinite(level.floor_height)
        assert area(level, floor) == pytest.approx(1731.0, rel=0.02)
        assert level.floor_height[floor] == pytest.approx(level.ground, abs=1e-4)
        assert area(level, level.free) == pytest.approx(1731.0, rel=0.03)
    config = SCENES["trimesh_3storey"]
    solid = {**config, "scene": {**config["scene"], "meshes": "auto"}}
    warnings = run_bake(parse_config(solid, folder=DATA)).warnings
    (warning,) = (line for line in warnings if "closed mesh" in line)
    assert "'floor_1' (1731.8 m² at 3.00 m, and 1 more); `scene.meshes: shell`" in warning


def test_stair_of_open_treads():
    """One walk leads from the plane over all 20 treads, which are in the XML, to the top."""
    model = mujoco.MjModel.from_xml_path(
        str(DATA / "playground_go1" / "scene_mjx_feetonly_stairs.xml")
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    treads = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_BOX)
    tops = data.geom_xpos[treads, 2] + model.geom_size[treads, 2]
    assert len(treads) == 20

    grid = bake("playground_go1").grid
    islands = find_islands(grid)
    walked = np.concatenate(
        [
            level.floor_height[island == 1]
            for level, island in zip(grid.levels, islands, strict=True)
        ]
    )
    heights = np.unique(np.round(walked.astype(float), 4))
    assert heights == pytest.approx([0.0, *np.sort(tops)], abs=1e-4)
    assert heights[-1] == pytest.approx(2.945, abs=1e-4)
    assert len(island_areas("playground_go1")) == 1
    for top in tops:  # each is 0.2 x 1.5 m
        assert np.isclose(walked, top, atol=1e-4).sum() * 0.1**2 == pytest.approx(0.3, rel=0.01)


# ---------------------------------------------------------------- terrain


@dataclass
class Terrain:
    """unitree_go2 in MuJoCo, and the cells of its grid."""

    model: Any
    data: Any

    def cells_on(self, geom: int, margin: float = 1e-3) -> list[tuple[SceneGrid2D, Any, Any]]:
        """Of each level: the cells whose centres lie over a geom's rectangle, and where in it."""
        pos, mat = self.data.geom_xpos[geom], self.data.geom_xmat[geom].reshape(3, 3)
        half = self.half_size(geom)
        found = []
        for level in levels_of("unitree_go2"):
            xy = level.lattice.positions(*np.indices(level.shape))
            # up the vertical line to the geom's own plane z = half[2]
            top = pos + mat[:, 2] * half[2]
            z = top[2] - ((xy - top[:2]) @ mat[:2, 2]) / mat[2, 2]
            local = (np.concatenate([xy, z[..., None]], axis=-1) - pos) @ mat
            mask = (np.abs(local[..., :2]) < half[:2] - margin).all(axis=-1)
            found.append((level, mask, z))
        return found

    def half_size(self, geom: int) -> NDArray[np.float64]:
        if self.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_HFIELD:
            size = self.model.hfield_size[self.model.geom_dataid[geom]]
            return np.array([size[0], size[1], 0.0])
        return self.model.geom_size[geom]

    def highest_at(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """The height of the first thing under the sky, by MuJoCo's own ray [m]."""
        down, geom = np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32)
        start = 10.0
        return np.array(
            [
                start
                - mujoco.mj_ray(
                    self.model, self.data, np.array([x, y, start]), down, None, 1, -1, geom
                )
                for x, y in xy
            ]
        )

    def upright_boxes(self) -> list[int]:
        is_box = self.model.geom_type == mujoco.mjtGeom.mjGEOM_BOX
        upright = np.abs(self.data.geom_xmat[:, 8] - 1.0) < 1e-9
        return np.flatnonzero(is_box & upright).tolist()


@pytest.fixture(scope="module")
def terrain():
    model = mujoco.MjModel.from_xml_path(str(DATA / "unitree_go2" / "scene_terrain.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return Terrain(model, data)


def test_terrain_boxes(terrain):
    """The tops of the boxes: a platform with a cylinder on it and two stairs of ten."""
    boxes = terrain.upright_boxes()
    assert len(boxes) == 21
    for box in boxes:
        top = terrain.data.geom_xpos[box, 2] + terrain.model.geom_size[box, 2]
        standing = total = 0
        for level, mask, _ in terrain.cells_on(box):
            xy = level.lattice.positions(*np.nonzero(mask))
            mask[mask] = np.hypot(*(xy - (1.5, 0.0)).T) > 0.56  # clear of the cylinder
            standing += int((level.free & mask & np.isclose(level.floor_height, top)).sum())
            total = max(total, int(mask.sum()))
        assert standing >= 0.97 * total > 0


def test_terrain_ramp(terrain):
    """A box turned by 29 degrees: its floor is its plane, until it goes under the ground."""
    ramp = 3
    assert terrain.model.geom_size[ramp] == pytest.approx([1.5, 0.75, 0.05])
    on_ramp, tops = 0.0, []
    for level, mask, z in terrain.cells_on(ramp):
        standing = mask & (z > 0.01) & level.free & (np.abs(level.floor_height - z) < 1e-4)
        on_ramp += area(level, standing)
        tops += level.floor_height[standing].tolist()
    ground, mask, z = terrain.cells_on(ramp)[0]
    assert on_ramp == pytest.approx(area(ground, mask & (z > 0.01)), rel=0.01)
    assert on_ramp > 3.0
    assert max(tops) > 1.2


def test_terrain_height_fields(terrain):
    fields = np.flatnonzero(terrain.model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD)
    assert len(fields) == 2
    for field in fields:
        (ground, mask, _) = terrain.cells_on(field)[0]
        expected = terrain.highest_at(ground.lattice.positions(*np.nonzero(mask)))
        assert np.ptp(expected) > 0.015
        standing = ground.free[mask]
        assert standing.mean() > 0.9
        # where a bump is steep, the floor may run on under it
        on_top = np.abs(ground.floor_height[mask] - expected)[standing] < 1e-4
        assert on_top.mean() > 0.98
        below = (expected - ground.floor_height[mask])[standing][~on_top]
        assert (below < STEP).all() and (below > 0).all()


def test_terrain_is_one_walk():
    areas = island_areas("unitree_go2")
    assert areas[0] > 0.99 * areas.sum()


# ---------------------------------------------------------------- Recast's meshes


def read_obj(path: Path) -> NDArray[np.float64]:
    """All triangles of an OBJ with y up, in the world frame, shape (n, 3, 3)."""
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    for line in path.read_text().splitlines():
        kind, *rest = line.split() or [""]
        if kind == "v":
            x, y, z = map(float, rest[:3])
            vertices.append([x, -z, y])
        elif kind == "f":
            corner = [int(entry.split("/")[0]) for entry in rest]
            corner = [i - 1 if i > 0 else len(vertices) + i for i in corner]
            faces += [[corner[0], corner[k], corner[k + 1]] for k in range(1, len(corner) - 1)]
    return np.array(vertices)[np.array(faces)]


def hits(
    triangles: NDArray[np.float64], xy: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Heights where the vertical line through a point crosses triangles, and their normals' z."""
    a, b, c = (triangles[:, i, :2] - xy for i in range(3))

    def cross(p: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
        return p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]

    weights = np.stack([cross(b, c), cross(c, a), cross(a, b)], axis=1)
    total = weights.sum(axis=1)
    hit = (np.abs(total) > 1e-12) & ((weights * np.sign(total)[:, None]) >= 0).all(axis=1)
    z = (weights[hit] * triangles[hit, :, 2]).sum(axis=1) / total[hit]
    corners = triangles[hit]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return z, normal[:, 2] / np.linalg.norm(normal, axis=1)


@pytest.mark.parametrize(("name", "number"), [("nav_test", 1612), ("dungeon", 10133)])
def test_recast_mesh_is_read_whole(name, number):
    path = DATA / "recast_meshes" / f"{name}.obj"
    assert len(read_obj(path)) == number
    assert sum(len(part.faces) for part in read_named_meshes(path, up="y")) == number
    assert len(load_scene(config_of(name)).shapes.triangles.corners) == number


@pytest.mark.parametrize("name", ["nav_test", "dungeon"])
def test_recast_floors_are_of_the_mesh(name):
    """Where an agent can stand, a triangle that isn't too steep has headroom over it."""
    triangles = read_obj(DATA / "recast_meshes" / f"{name}.obj")
    rng = np.random.default_rng(0)
    for level in levels_of(name):
        rows, cols = np.nonzero(level.free)
        chosen = rng.choice(len(rows), 150, replace=False)
        for row, col in zip(rows[chosen], cols[chosen], strict=True):
            z, up = hits(triangles, level.lattice.positions(row, col))
            floor = level.floor_height[row, col]
            is_floor = np.abs(z - floor) < 1e-3
            assert (is_floor & (up > 0)).any()
            assert not ((z > floor + STEP + 1e-3) & (z < floor + HEADROOM - 1e-3)).any()


@pytest.mark.parametrize("name", ["nav_test", "dungeon"])
def test_recast_floors_are_complete(name):
    """Wherever a line crosses the mesh in a large flat floor with headroom, there is one."""
    triangles = read_obj(DATA / "recast_meshes" / f"{name}.obj")
    flat = {"nav_test": -2.37, "dungeon": 10.0}[name]  # its largest floor [m]
    levels = levels_of(name)
    x_min, y_min, x_max, y_max = levels[0].lattice.bounds
    rng = np.random.default_rng(1)
    standing = found = 0
    for xy in rng.uniform((x_min, y_min), (x_max, y_max), (1000, 2)):
        center = levels[0].lattice.positions(*levels[0].lattice.rows_cols(xy))
        z, up = hits(triangles, center)
        on_floor = (np.abs(z - flat) < 0.02) & (up > 0.99)
        if not on_floor.any():
            continue
        floor = z[on_floor].max()
        above = z[z > floor + 1e-3]
        if above.size and above.min() < floor + HEADROOM + 0.01:
            continue
        if above.size and up[z == above.min()].max() > 0:
            continue  # under a face that faces up: inside of a solid
        standing += 1
        for level in levels:
            row, col = (int(i) for i in level.lattice.rows_cols(center))
            if 0 <= row < level.height and 0 <= col < level.width:
                found += bool(abs(level.floor_height[row, col] - floor) < 1e-3)
    assert standing > 100
    assert found >= 0.99 * standing


@pytest.mark.parametrize(
    ("name", "num_levels", "free", "largest"),
    [
        ("nav_test", 2, 4252.0, [2141.0, 1162.0, 937.0]),
        ("dungeon", 2, 1879.0, [1771.0, 84.0, 18.0]),
    ],
)
def test_recast_levels(name, num_levels, free, largest):
    """Regression: levels, and the free area [m²] as a whole and in its largest islands.

    nav_test's flat tops of 218, 199, 119 and 69 m² are roofs: no step leads there. So is the ring
    of 126 m² on top of the dungeon, 22 to 25 m up.
    """
    levels = levels_of(name)
    assert len(levels) == num_levels
    assert sum(area(level, level.free) for level in levels) == pytest.approx(free, rel=0.01)
    assert island_areas(name)[: len(largest)] == pytest.approx(largest, rel=0.03)


# ---------------------------------------------------------------- Habitat's stages


def test_simple_room():
    """A slab of 10.5 x 10.9 m with a table of 1.4 m and a cube of 2 m on it."""
    parts = read_named_meshes(DATA / SCENES["simple_room"]["scene"]["path"])
    slab = max(parts, key=lambda part: float(np.ptp(part.vertices[:, 0]))).vertices
    size, top = np.ptp(slab, axis=0), float(slab[:, 2].max())

    (level,) = levels_of("simple_room")
    floor = np.isfinite(level.floor_height)
    assert level.ground == pytest.approx(top, abs=1e-4)
    assert area(level, floor) == pytest.approx(size[0] * size[1], rel=0.02)
    under_table = tuple(int(i) for i in level.lattice.rows_cols([0.25, 0.25]))
    assert level.floor_height[under_table] == pytest.approx(top, abs=1e-4)
    assert level.occupancy[under_table] == 1
    assert island_areas("simple_room")[0] == pytest.approx(size[0] * size[1] - 5.5, rel=0.01)


def test_stage_floor1():
    """A terrain of 20 x 20 m without steep places: all of it is one walk, at its own height."""
    (level,) = levels_of("stage_floor1")
    assert level.free.all()
    assert island_areas("stage_floor1") == pytest.approx([400.0])
    (part,) = read_named_meshes(DATA / SCENES["stage_floor1"]["scene"]["path"], up="y")
    assert level.floor_height.min() == pytest.approx(part.vertices[:, 2].min(), abs=0.05)
    assert level.floor_height.max() == pytest.approx(part.vertices[:, 2].max(), abs=0.05)
