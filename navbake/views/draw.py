"""Draws grids, paths, poses, voxels and episodes into MuJoCo's own viewer and films.

MuJoCo draws an ``mjvScene``: a list of geoms, to which programs may add their own. The passive
viewer has one for them, ``viewer.user_scn``; a renderer's is ``renderer.scene``.
"""

from __future__ import annotations

import itertools
import math
import re
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, TypeAlias, overload

import numpy as np
from numpy.typing import ArrayLike

from navbake.episodes.episode import Episode, find_goal_position
from navbake.errors import QueryError, count_of, printable
from navbake.lazy import lazy
from navbake.mujoco_types import MjvSceneLike
from navbake.navgrid import colors
from navbake.navgrid.cells import check_level, place_at
from navbake.navgrid.grid import MultiLevelGrid, NavGrid, SceneGrid2D
from navbake.runtime.draws import Pose, Spawns
from navbake.runtime.path_finder import PathFinder
from navbake.runtime.paths import Path
from navbake.runtime.stand import StandPoses
from navbake.types import Float
from navbake.views.boxes import Boxes, merge_cells, merge_voxels
from navbake.views.describe import Arc, compute_arc, list_arcs
from navbake.views.layers import LAYER_LIFT, make_panel, paint, tint_free_cells
from navbake.voxels.finder import FlightPath, VoxelFinder
from navbake.voxels.grid import VoxelGrid

if TYPE_CHECKING:
    from mujoco import MjvGeom, MjvScene

mujoco = lazy("mujoco")  # whoever has a scene to draw into has loaded it

Poses: TypeAlias = StandPoses | Spawns | Pose
Voxels: TypeAlias = VoxelGrid | VoxelFinder
Drawable: TypeAlias = NavGrid | PathFinder | Path | FlightPath | Poses | Voxels | Episode
"""What `draw` draws."""

DEFAULT_LAYER = "occupancy"
NUM_SHADES = 16  # different colours of a scale: the fewer there are, the fewer boxes cells become
LINE_RADIUS = 0.03  # of the capsules of lines, by default [m]
NAME_LIFT = 0.4  # height of names over the floor [m]
MAX_LABEL_BYTES = 99  # of a label of MuJoCo's
ARROW_SPACING = 1.0  # distance of the arrows on a line [m]
# sizes, as multiples of the radius of lines
LINE_LIFT = 2.0  # height of lines over their positions
ARROW_LENGTH = 9.0
ARROW_RADIUS = 2.0
END_RADIUS = 2.5  # of the ball at the start of a path, and of those at goals
POSE_RADIUS = 4.0  # of the disc under a pose
POSE_LENGTH = 12.0  # of the arrow of a pose
DISC_HEIGHT = 0.01  # of discs on the floor [m]
OPEN_DOOR_OPACITY = 0.4  # of lines across doors that aren't closed, as a share
# MuJoCo draws an arrow half as long as mjv_connector makes it (3.5 to 4.0)
ARROW_SCALE = 2.0
PALE_OPACITY = 0.3  # of discs and of tubes round flights, as a share
# A scene's lights together are mostly brighter than 1; colours at this share don't turn white.
BRIGHTNESS = 0.75


class DrawCount(NamedTuple):
    """How many geoms were drawn."""

    added: int  #: Number of geoms that were added to the scene.
    left_out: int  #: Number of geoms for which the scene had no space.


@overload
def draw(
    scene: MjvSceneLike,
    content: NavGrid | PathFinder,
    *,
    layer: str | None = None,
    level: int | None = None,
    opacity: float = 1.0,
    radius: float = LINE_RADIUS,
    labels: bool = True,
) -> DrawCount: ...
@overload
def draw(
    scene: MjvSceneLike,
    content: Path | FlightPath | Poses | Voxels | Episode,
    *,
    color: str | None = None,
    opacity: float = 1.0,
    radius: float = LINE_RADIUS,
    labels: bool = True,
) -> DrawCount: ...
def draw(
    scene: MjvSceneLike,
    content: Drawable,
    *,
    layer: str | None = None,
    level: int | None = None,
    color: str | None = None,
    opacity: float = 1.0,
    radius: float = LINE_RADIUS,
    labels: bool = True,
) -> DrawCount:
    """Add geoms to a scene of MuJoCo's that show a grid, a path, poses, voxels or an episode.

    - A grid, or a finder's grid: the cells with a floor, as flat boxes on it, in the colours that
      pictures and the viewer have; values such as heights have 16 shades. Cells of one colour
      whose floor is a plane share a box. Doors are lines from jamb to jamb, paler unless closed.
      The layer ``links`` has arcs of links and stairs, too.
    - A path: capsules with an arrow each metre, arcs over links, a ball at its start. A path
      through the air has a pale tube, as wide as the ball that flies.
    - Poses, of `finder.stand_poses`, `finder.spawn` or `finder.random_pose`: a disc and an arrow
      for each, one colour for each of several targets.
    - Voxels, or those of their finder: boxes of voxels of one ID, one of six colours for each ID.
    - An episode: its start with the heading, its path, and its goals with their radius.

    Only geoms are added, after those that the scene has; they belong to no object of the model,
    cast no shadow, and are left out of segmentations. If there are more than the scene's
    ``maxgeom`` leaves space for, the largest boxes are drawn, after all lines and labels, and a
    warning states how many were left out.

    MuJoCo's viewer keeps what is drawn: ``viewer.user_scn.ngeom = 0`` clears it. A renderer forgets
    it at its next ``update_scene``.

    Args:
        scene: an ``mjvScene``, such as ``viewer.user_scn`` of ``mujoco.viewer.launch_passive``,
            under ``viewer.lock()``, or ``renderer.scene`` of a ``mujoco.Renderer`` after its
            ``update_scene``.
        content: what to draw.
        layer: of a grid, the layer whose colours are shown, one of `navbake plot --layer`; None for
            ``occupancy``.
        level: of a grid, the number of the only level to draw, 0 is the lowest; None for all.
        color: the colour of a path, poses, voxels or an episode's path, as ``#1864ab``; None for
            that of pictures.
        opacity: how opaque all of it is, more than 0, up to 1.
        radius: the radius of the capsules of lines [m], > 0; arrows, balls and discs are in
            proportion.
        labels: whether to write names: those of the layer's rooms, doors, links or areas, the
            targets of poses, and the id and goals of an episode. MuJoCo writes only ASCII letters;
            other names are replaced by ids, or their other letters by question marks.

    Returns:
        How many geoms were added, and how many were left out.

    Raises:
        QueryError: an argument is not valid, or there is no such layer or level.

    Example:
        >>> with mujoco.viewer.launch_passive(model, data) as viewer:
        ...     with viewer.lock():
        ...         navbake.draw(viewer.user_scn, grid, layer="rooms", opacity=0.6)
        ...         navbake.draw(viewer.user_scn, path)
        ...     viewer.sync()
    """
    if not isinstance(scene, mujoco.MjvScene):
        expected = "an mjvScene, such as viewer.user_scn or renderer.scene"
        raise _make_error("scene", scene, expected, type(scene).__name__)
    if not isinstance(content, Drawable):
        expected = "a grid, finder, path, poses, voxels or episode"
        hint = ": there is no path; finder.why_not says why" if content is None else ""
        raise _make_error("content", content, expected, f"{type(content).__name__}{hint}")
    if not (isinstance(opacity, int | float | np.number) and 0 < opacity <= 1):
        raise _make_error("opacity", opacity, "an opacity > 0, at most 1", repr(opacity))
    if not (isinstance(radius, int | float | np.number) and 0 < radius < math.inf):
        raise _make_error("radius", radius, "a radius > 0 m", repr(radius))
    if color is not None and not re.fullmatch("#[0-9a-fA-F]{6}", str(color)):
        raise _make_error("color", color, "a colour such as #1864ab", repr(color))
    grid = content.grid if isinstance(content, PathFinder) else content
    is_grid = isinstance(grid, SceneGrid2D | MultiLevelGrid)
    meaningless_options = {"color": color} if is_grid else {"layer": layer, "level": level}
    for name, value in meaningless_options.items():
        if value is not None:
            kind = type(content).__name__
            raise QueryError(f"a {kind} is drawn without `{name}`, got {value!r}", key=name)

    pen = _Pen(scene, opacity, radius)
    if isinstance(grid, SceneGrid2D | MultiLevelGrid):
        check_level(level, len(grid.levels))
        level_numbers = list(range(len(grid.levels))) if level is None else [level]
        _draw_grid(pen, grid, layer or DEFAULT_LAYER, level_numbers, labels=labels)
    elif isinstance(content, Path):
        _draw_path(pen, content, color or colors.ROUTE)
    elif isinstance(content, FlightPath):
        _draw_flight(pen, content, color or colors.ROUTE)
    elif isinstance(content, Voxels):
        voxels = content.voxels if isinstance(content, VoxelFinder) else content
        pen.add_boxes(merge_voxels(voxels), color)
    elif isinstance(content, Episode):
        _draw_episode(pen, content, color or colors.ROUTE, labels=labels)
    elif isinstance(content, Poses):
        _draw_poses(pen, content, color, labels=labels)
    if pen.num_left_out:
        message = (
            f"{count_of(pen.num_left_out, 'geom')} of {pen.num_added + pen.num_left_out} left out, "
            f"as the scene holds {scene.maxgeom}: make one with a larger maxgeom, or draw less"
        )
        warnings.warn(message, stacklevel=2)
    return DrawCount(pen.num_added, pen.num_left_out)


def _make_error(key: str, value: object, expected: str, text: str) -> QueryError:
    """Return an error for a wrong argument; the message shows its value as `text`."""
    message = f"expected {expected}, got {text}"
    return QueryError(message, key=key, value=value, expected=expected)


class _Pen:
    """Adds geoms to a scene, as long as it has space.

    Attributes:
        radius: the radius of lines [m].
        num_added: the number of geoms that were added.
        num_left_out: the number of those for which there was no space.

    Args:
        scene: the scene.
        opacity: the opacity of all geoms.
        radius: the radius of lines [m].
    """

    def __init__(self, scene: MjvScene, opacity: float, radius: float) -> None:
        self._scene = scene
        self._geoms = scene.geoms
        self._opacity = opacity
        self.radius = radius
        self.num_added = 0
        self.num_left_out = 0

    def add(
        self,
        kind: str,
        size: ArrayLike,
        position: ArrayLike,
        rgb: ArrayLike,
        *,
        rotation: Float | None = None,
        opacity: float = 1.0,
    ) -> MjvGeom | None:
        """Add a geom.

        Args:
            kind: its type, such as ``box``.
            size: its sizes as MuJoCo has them for the type, shape (3,) [m].
            position: its middle, world x, y, z [m].
            rgb: its red, green and blue, 0 to 255.
            rotation: its axes as columns, shape (3, 3); None for the world's.
            opacity: its opacity, as a share of that of all geoms.

        Returns:
            The geom; None if there was no space for it.
        """
        if self._scene.ngeom >= self._scene.maxgeom:
            self.num_left_out += 1
            return None
        geom = self._geoms[self._scene.ngeom]
        rgba = np.append(np.asarray(rgb) * (BRIGHTNESS / 255), self._opacity * opacity)
        mujoco.mjv_initGeom(
            geom,
            type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"),
            size=np.asarray(size, dtype=np.float64),
            pos=np.asarray(position, dtype=np.float64),
            mat=np.ravel(np.eye(3) if rotation is None else rotation),
            rgba=rgba.astype(np.float32),
        )
        # which mjv_initGeom leaves as they are
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        geom.objtype = mujoco.mjtObj.mjOBJ_UNKNOWN
        geom.objid = -1
        geom.segid = -1
        geom.transparent = 0
        geom.camdist = 0.0
        geom.specular = 0.0
        if hasattr(geom, "castshadow"):  # of MuJoCo 4
            geom.castshadow = 0
        self._scene.ngeom += 1
        self.num_added += 1
        return geom

    def connect(
        self, kind: str, radius: float, start: Float, end: Float, color: str, opacity: float = 1.0
    ) -> None:
        """Add a capsule or an arrow from one position to another, world x, y, z [m]."""
        geom = self.add(kind, np.zeros(3), start, colors.rgb_of(color), opacity=opacity)
        if geom is not None:
            mujoco.mjv_connector(geom, geom.type, radius, start, end)
            if kind == "arrow":
                geom.size[2] *= ARROW_SCALE

    def add_boxes(self, boxes: Boxes, color: str | None) -> None:
        """Add boxes, the largest first, in their own colours or in `color`."""
        for center, half_size, rotation, rgb in zip(*boxes, strict=True):
            box_rgb = rgb if color is None else colors.rgb_of(color)
            self.add("box", half_size, center, box_rgb, rotation=rotation)

    def add_ball(self, position: Float, color: str) -> None:
        """Add a ball to a position on the floor, as high over it as lines are."""
        radius = END_RADIUS * self.radius
        center = position + np.array([0.0, 0.0, LINE_LIFT * self.radius])
        self.add("sphere", np.full(3, radius), center, colors.rgb_of(color))

    def add_disc(self, position: Float, radius: float, color: str, opacity: float = 1.0) -> None:
        """Add a flat disc over a position on the floor, as high over it as drawn cells are."""
        size = [radius, radius, DISC_HEIGHT / 2]
        center = position + np.array([0.0, 0.0, LAYER_LIFT + DISC_HEIGHT])
        self.add("cylinder", size, center, colors.rgb_of(color), opacity=opacity)

    def add_heading(self, position: Float, heading: float, color: str) -> None:
        """Add the arrow of a pose: from a position on the floor along a heading [rad]."""
        start = position + np.array([0.0, 0.0, LINE_LIFT * self.radius])
        direction = np.array([math.cos(heading), math.sin(heading), 0.0])
        end = start + POSE_LENGTH * self.radius * direction
        self.connect("arrow", ARROW_RADIUS * self.radius, start, end, color)

    def add_line(self, points: Float, color: str) -> None:
        """Add capsules along a line through points, world x, y, z [m], shape (n, 3)."""
        for start, end in itertools.pairwise(points):
            if not np.array_equal(start, end):
                self.connect("capsule", self.radius, start, end, color)

    def add_arrows(self, points: Float, color: str) -> None:
        """Add an arrow to each `ARROW_SPACING` of a line, and one at its end."""
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        distances = np.append(0.0, np.cumsum(lengths))
        arrow_length = ARROW_LENGTH * self.radius
        tip_distances = np.arange(distances[-1], arrow_length / 2, -ARROW_SPACING)
        for tip_distance in tip_distances:
            segment = int(np.searchsorted(distances, tip_distance)) - 1
            direction = (points[segment + 1] - points[segment]) / lengths[segment]
            tip = points[segment] + (tip_distance - distances[segment]) * direction
            start = tip - arrow_length * direction
            self.connect("arrow", ARROW_RADIUS * self.radius, start, tip, color)

    def write(self, text: str, position: ArrayLike, fallback: str = "") -> None:
        """Add a label.

        Args:
            text: its text.
            position: where it stands, world x, y, z [m].
            fallback: the text if `text` has letters that MuJoCo's font lacks.
        """
        if not text.isascii() and fallback.isascii() and fallback:
            text = fallback
        text = printable(text).encode("ascii", "replace").decode()
        geom = self.add("label", np.zeros(3), position, (255, 255, 255))
        if geom is not None:
            is_short = len(text) <= MAX_LABEL_BYTES
            geom.label = text if is_short else f"{text[: MAX_LABEL_BYTES - 3]}..."


def _draw_grid(
    pen: _Pen, grid: NavGrid, layer: str, level_numbers: Sequence[int], *, labels: bool
) -> None:
    """Draw levels of a grid: their doors, names and arcs, then their cells."""
    level_boxes = []
    for level_number in level_numbers:
        # relief has a colour of its own for each cell
        panel = tint_free_cells(make_panel(grid, layer, level_number))._replace(relief_step=0.0)
        level_boxes.append(merge_cells(grid.levels[level_number], paint(panel, NUM_SHADES)))
        for door in panel.doors:
            ends = np.array([door.start, door.end])
            z = _floor_at(grid, level_number, *door.middle) + LINE_LIFT * pen.radius
            door_ends = np.column_stack([ends, [z, z]])
            opacity = 1.0 if door.state == "closed" else OPEN_DOOR_OPACITY
            pen.connect("capsule", pen.radius, door_ends[0], door_ends[1], colors.DOOR, opacity)
        for label in panel.labels if labels else ():
            z = _floor_at(grid, level_number, label.x, label.y) + NAME_LIFT
            pen.write(label.text, (label.x, label.y, z), label.fallback)
    if layer == "links":
        for arc in list_arcs(grid, level_numbers):
            _draw_arc(pen, arc)
    for boxes in level_boxes:
        pen.add_boxes(boxes, None)


def _floor_at(grid: NavGrid, level_number: int, x: float, y: float) -> float:
    """Return world z of the floor at world x, y, or of the level's ground where there is none."""
    place = place_at(grid, (x, y), level_number)
    if place is None or place.floor is None:
        return grid.levels[level_number].ground
    return place.floor


def _draw_arc(pen: _Pen, arc: Arc) -> None:
    """Draw the arc of a link or a stair; one that is one-way has an arrow."""
    points = arc.points + np.array([0.0, 0.0, LINE_LIFT * pen.radius])
    pen.add_line(points, arc.color)
    if arc.is_one_way:
        pen.add_arrows(points, arc.color)


def _draw_path(pen: _Pen, path: Path, color: str) -> None:
    """Draw a path: lines, and an arc over each link."""
    pen.add_ball(path.positions[0], colors.START)
    points = path.positions + np.array([0.0, 0.0, LINE_LIFT * pen.radius])
    first_index = 0
    for departure, arrival in path.stops.tolist():
        pen.add_line(points[first_index : departure + 1], color)
        pen.add_arrows(points[first_index : departure + 1], color)
        pen.add_line(compute_arc(points[departure], points[arrival]), colors.LINK)
        first_index = arrival
    pen.add_line(points[first_index:], color)
    pen.add_arrows(points[first_index:], color)


def _draw_flight(pen: _Pen, flight: FlightPath, color: str) -> None:
    """Draw a path through the air: lines in a tube that the ball sweeps."""
    start = flight.positions[0]
    pen.add("sphere", np.full(3, END_RADIUS * pen.radius), start, colors.rgb_of(colors.START))
    pen.add_line(flight.positions, color)
    pen.add_arrows(flight.positions, color)
    for tube_start, tube_end in itertools.pairwise(flight.positions):
        pen.connect("capsule", flight.radius, tube_start, tube_end, color, PALE_OPACITY)


def _draw_poses(pen: _Pen, poses: Poses, color: str | None, *, labels: bool) -> None:
    """Draw poses: a disc and an arrow for each; the first of each target has the target's name."""
    if isinstance(poses, Pose):
        poses = Spawns(poses.position[None], np.array([poses.heading]))
    targets: tuple[str, ...] = ()
    target_index = np.zeros(len(poses.headings), dtype=np.int64)
    if isinstance(poses, StandPoses):
        targets = poses.targets
        target_index = poses.target_index
    pose_colors = colors.MARKS if len(targets) > 1 else (colors.STAND,)
    named_targets = set()
    for position, heading, target in zip(
        poses.positions, poses.headings.tolist(), target_index.tolist(), strict=True
    ):
        pose_color = color or pose_colors[target % len(pose_colors)]
        pen.add_disc(position, POSE_RADIUS * pen.radius, pose_color, PALE_OPACITY)
        pen.add_heading(position, heading, pose_color)
        if labels and targets and target not in named_targets:
            named_targets.add(target)
            pen.write(targets[target], position + np.array([0.0, 0.0, NAME_LIFT]))


def _draw_episode(pen: _Pen, episode: Episode, color: str, *, labels: bool) -> None:
    """Draw an episode: its start with the heading, its path if it has one, and its goals."""
    lift = np.array([0.0, 0.0, NAME_LIFT])
    start = np.array(episode.start)
    pen.add_ball(start, colors.START)
    pen.add_heading(start, episode.heading, colors.START)
    if labels:
        pen.write(episode.id, start + lift)
    points = np.array(episode.path).reshape(-1, 3) + np.array([0.0, 0.0, LINE_LIFT * pen.radius])
    if len(points):
        pen.add_line(points, color)
        pen.add_arrows(points, color)
    for goal in episode.goals:
        position = find_goal_position(goal)
        if position is None:
            continue
        pen.add_ball(np.array(position), color)
        if goal.radius:
            pen.add_disc(np.array(position), goal.radius, color, PALE_OPACITY)
        if labels:
            name = goal.name or goal.category or "goal"
            pen.write(name, np.array(position) + lift, goal.room or "")
