"""Cars of lifts: bodies on one vertical slide, with a floor that an agent can stand on."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.columns.columns import cast_columns, tile_shapes
from navbake.baker.core.constants import SLIDE
from navbake.baker.core.limits import agent_limits
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.scene.names import all_names, find_subtree_ends, mark_body
from navbake.config.links import LinkSettings
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Int

# Cosine of a lift's joint with the vertical
VERTICAL = 0.999
# The least area of a car's floor [m²]
LEAST_CAR = 0.25
# How far a car's floor is from its height at most [m]
FLAT = 0.01


class CarFloor(NamedTuple):
    """The floor of a car on a lattice.

    Attributes:
        cells: the cells that the floor covers, ascending.
        outline: the cells that anything of the car covers; they may repeat.
        height: of the highest place of the floor [m].
        carrier: the geom that most of the floor belongs to.
    """

    cells: Int
    outline: Int
    height: float
    carrier: int


def find_lift_joints(model: Any, data: Any, patterns: Sequence[str]) -> list[int]:
    """The joints that may carry a lift: the only one of a body, vertical, a slide with limits.

    Args:
        patterns: name patterns of the bodies.
    """
    names = all_names(model).bodies
    slides = (model.jnt_type == SLIDE) & np.asarray(model.jnt_limited, dtype=np.bool_)
    slides &= model.body_jntnum[model.jnt_bodyid] == 1
    slides &= np.abs(data.xaxis[:, 2]) > VERTICAL
    joints = list[int]()
    for joint in np.flatnonzero(slides).tolist():
        name = names[int(model.jnt_bodyid[joint])]
        if any(fnmatchcase(name, pattern) for pattern in patterns):
            joints.append(joint)
    return joints


def measure_car(shapes: Shapes, lattice: Lattice, agent: AgentSettings) -> CarFloor | None:
    """Find the floor of what may be a car, None where it has none that is large enough.

    Args:
        shapes: the geometry of the car alone.
        lattice: cells over the car.
    """
    columns = cast_columns(tile_shapes(shapes, lattice, 0.0))
    cell = np.repeat(np.arange(lattice.width * lattice.height), np.diff(columns.start))
    # up to what is next above it in its column
    is_last = np.append(cell, -1)[1:] != cell
    headroom = np.where(is_last, np.inf, np.append(columns.z, np.inf)[1:] - columns.z)
    flat = columns.normal[:, 2] >= agent_limits(agent).min_up
    flat &= headroom >= agent.height - LIMIT_SLACK
    heights, counts = np.unique(np.round(columns.z[flat], 3), return_counts=True)
    # the lowest of those that are large: not the roof of the car
    height = heights[2 * counts >= counts.max(initial=0)].min(initial=np.inf)
    flat &= np.abs(columns.z - height) <= FLAT
    if np.count_nonzero(flat) * lattice.cell_size**2 < LEAST_CAR:
        return None
    carrier = int(np.bincount(columns.geom[flat]).argmax())
    return CarFloor(cell[flat], cell, float(columns.z[flat].max()), carrier)


def find_cars(
    model: Any,
    data: Any,
    shapes: Shapes,
    links: Sequence[LinkSettings],
    agent: AgentSettings,
    cell_size: float,
) -> list[int]:
    """The bodies that are cars of lifts, where the settings of links look for these; ascending.

    Args:
        shapes: all geometry that counts.
        cell_size: edge of the cells by which floors are measured [m].
    """
    ends = find_subtree_ends(model)
    cars = set[int]()
    for rule in links:
        if rule.auto != "lift":
            continue
        for joint in find_lift_joints(model, data, rule.patterns or ("*",)):
            body = int(model.jnt_bodyid[joint])
            own = shapes.only(mark_body(model, body, int(ends[body])))
            if own.bounds is None:
                continue
            (x_min, y_min), (x_max, y_max) = own.bounds[:, :2].tolist()
            lattice = Lattice.cover((x_min, y_min, x_max, y_max), cell_size)
            if measure_car(own, lattice, agent) is not None:
                cars.add(body)
    return sorted(cars)
