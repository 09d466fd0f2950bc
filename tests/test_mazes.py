"""Mazes that others made: their own arrays say what is wall and what is open.

Walls here are as wide as corridors, so by their size their tops are floors as good as any (an
agent could stand on a wall 4 m wide); the settings give the one level there is, as a user would.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from floor_scenes import labyrinth, open_area
from navbake.baker.bake.pipeline import BakeResult, run_bake
from navbake.config.settings import parse_config
from navbake.navgrid.lattice import Lattice

EDGE = 1e-6  # metres that a cell may reach over its block: rounding


@dataclass
class Maze:
    """A maze of square blocks.

    Attributes:
        model: its MjModel.
        walls: shape (rows, cols), bool: which blocks are wall.
        first: world x, y of block (0, 0)'s centre [m].
        step: metres to the next column's x and to the next row's y.
        robot: name of the robot's root body, None where there is no robot.
    """

    model: Any
    walls: NDArray[np.bool_]
    first: tuple[float, float]
    step: tuple[float, float]
    robot: str | None = None

    def block_of(self, lattice: Lattice) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Masks of the cells whose square lies inside a wall block, inside an open block."""
        size = abs(self.step[0])
        half = lattice.cell_size / 2
        rows, cols = self.walls.shape
        inside, index = [], []
        for center, origin, step, count in (
            (lattice.center_x(), self.first[0], self.step[0], cols),
            (lattice.center_y(), self.first[1], self.step[1], rows),
        ):
            nearest = np.rint((center - origin) / step)
            off = np.abs(center - (origin + nearest * step))
            inside.append((off + half <= size / 2 + EDGE) & (nearest >= 0) & (nearest < count))
            index.append(np.clip(nearest, 0, count - 1).astype(np.int64))
        wall = self.walls[index[1][:, None], index[0][None, :]]
        whole = inside[1][:, None] & inside[0][None, :]
        return whole & wall, whole & ~wall


def bake_maze(maze: Maze, folder: Path, cell_size: float) -> BakeResult:
    path = folder / "maze.mjb"
    mujoco.mj_saveModel(maze.model, str(path), None)
    excluded = [maze.robot] if maze.robot else []
    return run_bake(
        parse_config(
            {
                "scene": {"path": path, "exclude": {"bodies": excluded}},
                "grid": {"cell_size": cell_size},
            }
        )
    )


def check_maze(maze: Maze, result: BakeResult) -> None:
    (level,) = result.grid.levels
    wall, open_ = maze.block_of(level.lattice)
    block_cells = (abs(maze.step[0]) / level.lattice.cell_size - 1) ** 2
    for cells, blocks in ((wall, maze.walls), (open_, ~maze.walls)):
        assert cells.sum() > 0.8 * block_cells * blocks.sum()
    assert (level.occupancy[wall] == 1).all()
    assert np.isinf(level.weights[wall]).all()
    assert (level.occupancy[open_] == 0).all()
    assert level.free[open_].all()
    assert (level.floor_height[open_] == np.float32(level.ground)).all()
    # of its walls, and of what is walled in
    known = ("the top of", "no step leads to")
    assert all(any(text in warning for text in known) for warning in result.warnings)


def check_robot_is_out(maze: Maze, result: BakeResult) -> None:
    model = maze.model
    robot = model.body_rootid[model.geom_bodyid] == model.body(maze.robot).id
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    assert (robot & collides).any()
    assert [geom.counted for geom in result.geoms] == (collides & ~robot).tolist()


def centered_maze(env: Any, robot: str) -> Maze:
    """What gymnasium-robotics says: row 0 has the largest y."""
    maze = env.unwrapped.maze
    scale = float(maze.maze_size_scaling)
    return Maze(
        model=env.unwrapped.model,
        walls=np.array([[block == 1 for block in row] for row in maze.maze_map]),
        first=(0.5 * scale - maze.x_map_center, maze.y_map_center - 0.5 * scale),
        step=(scale, -scale),
        robot=robot,
    )


@pytest.mark.parametrize(
    ("name", "robot", "cell_size"),
    [
        ("PointMaze_Large-v3", "particle", 0.15),
        ("AntMaze_Large-v4", "torso", 0.3),
        ("AntMaze_Large-v5", "torso", 0.25),
    ],
)
def test_gymnasium_robotics(name, robot, cell_size, tmp_path, monkeypatch):
    gymnasium = pytest.importorskip("gymnasium")
    gymnasium_robotics = pytest.importorskip("gymnasium_robotics")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))  # where it leaves its XML
    gymnasium.register_envs(gymnasium_robotics)
    env = gymnasium.make(name, render_mode=None)
    try:
        maze = centered_maze(env, robot)
        result = bake_maze(maze, tmp_path, cell_size)
    finally:
        env.close()
    check_maze(maze, result)
    check_robot_is_out(maze, result)


def test_ogbench(tmp_path, monkeypatch):
    gymnasium = pytest.importorskip("gymnasium")
    pytest.importorskip("ogbench")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    env = gymnasium.make("pointmaze-giant-v0")
    try:
        inner: Any = env.unwrapped
        first, (second, _) = inner.ij_to_xy((0, 0)), inner.ij_to_xy((0, 1))
        unit = second - first[0]
        maze = Maze(
            model=inner.model,
            walls=np.array(inner.maze_map) == 1,
            first=first,  # row 0 has the smallest y
            step=(unit, unit),
            robot="torso",
        )
        result = bake_maze(maze, tmp_path, 0.3)
    finally:
        env.close()
    check_maze(maze, result)
    check_robot_is_out(maze, result)


@pytest.mark.parametrize("seed", range(5))
def test_labmaze(seed, tmp_path):
    """Its ground collides, but is drawn with alpha 0, so that MuJoCo's own rays miss it."""
    labmaze = pytest.importorskip("labmaze")
    mazes = pytest.importorskip("dm_control.locomotion.arenas.mazes")
    layout = labmaze.RandomMaze(height=21, width=21, random_seed=seed)
    arena = mazes.MazeWithTargets(maze=layout, xy_scale=2.0, z_height=2.0)
    arena.regenerate()
    model = mujoco.MjModel.from_xml_string(
        arena.mjcf_model.to_xml_string(), arena.mjcf_model.get_assets()
    )
    first, right, down = arena.grid_to_world_positions([(0, 0), (0, 1), (1, 0)])
    maze = Maze(
        model=model,
        walls=np.array(layout.entity_layer) == "*",
        first=(first[0], first[1]),
        step=(right[0] - first[0], down[1] - first[1]),
    )
    ground = model.geom("ground")
    assert ground.rgba[3] == 0.0
    assert ground.contype[0] != 0

    result = bake_maze(maze, tmp_path, 0.15)

    assert result.geoms[ground.id].counted
    check_maze(maze, result)


@pytest.mark.parametrize("seed", [9001, 9004])
@pytest.mark.parametrize(("corridor", "wall"), [(1.0, None), (3.0, None), (2.0, 1.5)])
def test_tops_of_walls_are_no_floor_of_a_labyrinth(seed, corridor, wall, tmp_path):
    """They are larger than the corridors, wider than them here and there, and in pieces."""
    labmaze = pytest.importorskip("labmaze")
    maze = labmaze.RandomMaze(height=17, width=17, random_seed=seed)
    walls = np.array(maze.entity_layer) == "*"
    path = tmp_path / "scene.xml"
    path.write_text(labyrinth(walls, corridor, wall))
    settings = {"scene": {"path": str(path)}, "grid": {"cell_size": 0.15}}
    (level,) = run_bake(parse_config(settings)).grid.levels
    area = open_area(walls, corridor, wall)
    assert (level.floor_height[level.free] == 0.0).all()
    assert 0.75 * area < level.free.sum() * level.cell_size**2 <= 1.1 * area
