"""Flights in a small grid of voxels that follows a robot, while it and other bodies move."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from navbake.baker.voxels.voxelize import Voxelizer
from navbake.mujoco_types import MjDataLike
from navbake.voxels.finder import FlightPath, VoxelFinder


class LocalFlight:
    """Plans flights in voxels around a robot that are made anew wherever it is.

    Each update voxelizes the scene around the robot, in the pose of its bodies, measures distances
    and plans. It takes as long as the small grid needs, however large the scene is. Beyond the grid
    nothing is known: for a goal there, the path leads to the reachable place nearest to it, which
    may be a dead end. So for a goal far away, pass places along a path through the whole scene, one
    after the other.

    Attributes:
        voxelizer: The scene. Leave the robot itself out, by `ignore` of `navbake.Voxelizer`.
        finder: The finder in the voxels of the last update, with its `voxels` and `distances`; None
            before the first.

    Args:
        voxelizer: The scene.
        cells: Numbers of voxels of the grid along x, y and z, >= 1 each.
        res: Edge of a voxel [m].
        radius: Radius of the ball around the robot [m], > 0.
        min_height: Least world z of the ball's centre [m]; None for any.
        max_height: Greatest world z of the ball's centre [m]; None for any.
        cost_of_clearance: What a metre costs more at 1 m from what is occupied [m], >= 0.

    Example:
        >>> voxelizer = navbake.Voxelizer(model, data, ignore=["drone"])
        >>> local = navbake.LocalFlight(voxelizer, (60, 60, 40), res=0.1, radius=0.25)
        >>> path = local.update(data.body("drone").xpos, goal, data=data)  # in each control step
    """

    def __init__(
        self,
        voxelizer: Voxelizer,
        cells: Sequence[int],
        *,
        res: float,
        radius: float,
        min_height: float | None = None,
        max_height: float | None = None,
        cost_of_clearance: float = 0.0,
    ) -> None:
        self.voxelizer = voxelizer
        self.finder: VoxelFinder | None = None
        self._cells = cells
        self._res = res
        self._radius = radius
        self._heights = (min_height, max_height)
        self._cost_of_clearance = cost_of_clearance

    def update(
        self, position: ArrayLike, goal: ArrayLike, *, data: MjDataLike | None = None
    ) -> FlightPath | None:
        """Look around, and plan a path to a goal, or towards it.

        Args:
            position: World x, y, z of the robot [m], shape (3,).
            goal: World x, y, z of the goal [m], shape (3,).
            data: The pose of the scene, in which geom poses are computed; None if nothing moved.

        Returns:
            The path from the position to the goal; or, if the goal is not free or not reachable in
            the grid, to the reachable place nearest to it. None if the ball does not fit at the
            position, see `VoxelFinder.why_not`.

        Raises:
            ConfigError: A number is wrong, or the data are of another scene.
            QueryError: A position is not three finite numbers.
        """
        if data is not None:
            self.voxelizer.set_pose(data=data)
        voxels = self.voxelizer.create(position, self._cells, res=self._res, align=True)
        if self.finder is None:
            self.finder = VoxelFinder(voxels, self._radius, *self._heights, self._cost_of_clearance)
        else:
            self.finder.use(voxels)
        path = self.finder.find_path(position, goal)
        if path is not None:
            return path
        island = self.finder.island_at(position)
        if island is None:
            return None
        nearest = self.finder.snap(goal, island=island)
        return None if nearest is None else self.finder.find_path(position, nearest)
