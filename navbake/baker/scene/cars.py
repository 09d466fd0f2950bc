"""Finds cars of lifts: bodies with one joint, a vertical slide, and a floor for an agent."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from navbake.baker.columns.columns import cast_columns, tile_shapes
from navbake.baker.core.constants import SLIDE
from navbake.baker.core.limits import make_agent_limits
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.scene.names import all_names, find_subtree_ends, mark_geoms_of_bodies
from navbake.config.links import LinkSettings
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Int

if TYPE_CHECKING:
    import mujoco

# The least cosine of the angle between a lift's joint and the vertical, for 2.6 degrees
MIN_VERTICAL_COSINE = 0.999
# The least area of a car's floor [m²]
MIN_CAR_AREA = 0.25
# Surfaces at most this far above or below a car's floor belong to the floor [m]
FLOOR_FLATNESS = 0.01


class CarFloor(NamedTuple):
    """The floor of a lift's car on a lattice.

    Attributes:
        cells: ids of the cells that the floor covers, ascending.
        footprint_cells: ids of the cells over which any part of the car lies, seen from above; an
            id may occur several times.
        height: z of the floor's highest point [m].
        geom: the id of the geom that most of the floor belongs to.
    """

    cells: Int
    footprint_cells: Int
    height: float
    geom: int


def find_lift_joints(
    model: mujoco.MjModel, data: mujoco.MjData, patterns: Sequence[str]
) -> list[int]:
    """Find the joints that may move a lift's car: vertical slides with limits.

    The slide is the only joint of its body, and the body's name matches a pattern.

    Args:
        model: the model.
        data: the model's pose.
        patterns: patterns of bodies' names, such as ``lift*``.

    Returns:
        The ids of the joints, ascending.
    """
    names = all_names(model).bodies
    is_lift_joint = (model.jnt_type == SLIDE) & np.asarray(model.jnt_limited, dtype=np.bool_)
    is_lift_joint &= model.body_jntnum[model.jnt_bodyid] == 1
    is_lift_joint &= np.abs(data.xaxis[:, 2]) > MIN_VERTICAL_COSINE
    joint_ids = list[int]()
    for joint in np.flatnonzero(is_lift_joint).tolist():
        name = names[int(model.jnt_bodyid[joint])]
        if any(fnmatchcase(name, pattern) for pattern in patterns):
            joint_ids.append(joint)
    return joint_ids


def measure_car(shapes: Shapes, lattice: Lattice, agent: AgentSettings) -> CarFloor | None:
    """Find the floor inside of a body that may be a lift's car: its cells, height and main geom.

    Args:
        shapes: the geometry of the body and its descendants, and nothing else.
        lattice: a lattice that covers the body.
        agent: the agent that has to fit into the car.

    Returns:
        The floor; None if the body has none that is large enough.
    """
    columns = cast_columns(tile_shapes(shapes, lattice, 0.0))
    cell_of_hit = np.repeat(np.arange(lattice.width * lattice.height), np.diff(columns.start))
    # The headroom above a hit is the distance to the next hit of its vertical column.
    is_last_of_column = np.append(cell_of_hit, -1)[1:] != cell_of_hit
    headroom = np.where(is_last_of_column, np.inf, np.append(columns.z, np.inf)[1:] - columns.z)
    is_floor = columns.normal[:, 2] >= make_agent_limits(agent).min_normal_z
    is_floor &= headroom >= agent.height - LIMIT_SLACK
    floor_heights, height_counts = np.unique(np.round(columns.z[is_floor], 3), return_counts=True)
    # The floor is the lowest large surface; the car's roof may be another one.
    is_large = 2 * height_counts >= height_counts.max(initial=0)
    height = floor_heights[is_large].min(initial=np.inf)
    is_floor &= np.abs(columns.z - height) <= FLOOR_FLATNESS
    if np.count_nonzero(is_floor) * lattice.cell_size**2 < MIN_CAR_AREA:
        return None
    return CarFloor(
        cells=cell_of_hit[is_floor],
        footprint_cells=cell_of_hit,
        height=float(columns.z[is_floor].max()),
        geom=int(np.bincount(columns.geom[is_floor]).argmax()),
    )


def find_cars(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    shapes: Shapes,
    links: Sequence[LinkSettings],
    agent: AgentSettings,
    cell_size: float,
) -> list[int]:
    """Find the bodies that are cars of lifts, if the settings of links have rules for lifts.

    Args:
        model: the model.
        data: the model's pose.
        shapes: the geometry of all geoms that count.
        links: the settings of links.
        agent: the agent that has to fit into a car.
        cell_size: edge of the cells by which floors are measured [m].

    Returns:
        The ids of the bodies, ascending; none without a rule for lifts.
    """
    subtree_ends = find_subtree_ends(model)
    car_bodies = set[int]()
    for rule in links:
        if rule.auto != "lift":
            continue
        for joint in find_lift_joints(model, data, rule.patterns or ("*",)):
            body = int(model.jnt_bodyid[joint])
            is_body_geom = mark_geoms_of_bodies(model, body, int(subtree_ends[body]))
            body_shapes = shapes.only(is_body_geom)
            if body_shapes.bounds is None:
                continue
            (x_min, y_min), (x_max, y_max) = body_shapes.bounds[:, :2].tolist()
            lattice = Lattice.cover((x_min, y_min, x_max, y_max), cell_size)
            if measure_car(body_shapes, lattice, agent) is not None:
                car_bodies.add(body)
    return sorted(car_bodies)
