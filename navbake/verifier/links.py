"""Whether links are free: the ways over drops and jumps with their landings, and lifts' shafts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import fcl
import mujoco
import numpy as np

from navbake.baker.scene.names import body_name, find_subtree_ends, geoms_of_bodies
from navbake.baker.scene.scene import Scene
from navbake.errors import FormatError
from navbake.navgrid.grid import GridBase, SceneGrid2D
from navbake.navgrid.links import Link
from navbake.types import Bool, Float
from navbake.verifier.floors import rounding
from navbake.verifier.lines import Lines
from navbake.verifier.probes import TOUCHES, Column, Probes
from navbake.verifier.report import LINK_TOUCHES, NO_LANDING, Finding
from navbake.verifier.sample import SLACK, Agent

CROSSED = ("drop", "jump")  # kinds of links whose way runs straight from stop to stop
STEP = 0.02  # between the positions of a car that are looked at [m]


def check_links(
    grid: GridBase, scene: Scene, probes: Probes, lines: Lines, agent: Agent, tolerance: float
) -> list[Finding]:
    """Check the links of a grid: drops and jumps for the agent, lifts that the bake found.

    The agent's column has to touch nothing over each cell between the stops of a drop or a jump,
    over the higher of both floors, and down to the landing; whose floor has to be a surface. The
    car of a lift has to touch nothing on its way between the ends of its joint's range.
    """
    try:
        links = grid.links
    except FormatError:  # what an audit reports
        return []
    findings = list[Finding]()
    for link in links:
        if link.kind in CROSSED and len(link.stops) == 2:
            findings += _check_crossing(link, grid, probes, lines, agent, tolerance)
        elif link.kind == "lift" and link.auto:
            findings += _check_shaft(link, grid, scene, probes, tolerance)
    return findings


def _check_crossing(
    link: Link, grid: GridBase, probes: Probes, lines: Lines, agent: Agent, tolerance: float
) -> Iterator[Finding]:
    (one, other), places = link.stops, _cells_along(link, grid)
    lattice = grid.levels[one.level].lattice
    # from where one walks on each of the two floors
    first = _walks_to(places, grid.levels[one.level], grid)
    end = len(places) - 1 - _walks_to(places[::-1], grid.levels[other.level], grid)
    if first >= end:
        return
    start = _floor_at(grid.levels[one.level], places[first])
    stop = _floor_at(grid.levels[other.level], places[end])
    top, cell_size = max(start, stop), lattice.cell_size
    crossed = places[first : end + 1]
    lows = np.full(len(crossed), top)
    lows[0], lows[-1] = start, stop  # over the ends, from their floors on
    half = cell_size / 2
    for (x, y), low in zip(crossed, lows, strict=True):
        band = low + agent.step + tolerance, top + agent.height - tolerance
        center, half_z = np.array([x, y, sum(band) / 2]), (band[1] - band[0]) / 2
        columns = [Column(half, half, half_z, False)]
        columns += [Column(agent.radius, agent.radius, half_z, True)] if agent.radius > half else []
        reach = np.array([max(half, agent.radius)] * 2 + [half_z])
        for number in probes.obstacles.meeting(center - reach, center + reach):
            if any(probes.touches(number, c, center, -tolerance) == TOUCHES for c in columns):
                name = probes.obstacles.name(number)
                text = f"{link.kind} {link.name!r} runs into {name!r}"
                yield _finding(LINK_TOUCHES, link, grid, (x, y, low), text, name)
                return
    (x, y), z = crossed[-1], stop
    off = rounding(x, y, z)
    line = lines.at(x, y)
    if not (line.faces_up(z - off, z + off) or lines.faces_up_beside((x, y, z), off)):
        text = f"{link.kind} {link.name!r} lands at {z:.3f} m, where no surface is"
        yield _finding(NO_LANDING, link, grid, (x, y, z), text, None)


def _check_shaft(
    link: Link, grid: GridBase, scene: Scene, probes: Probes, tolerance: float
) -> Iterator[Finding]:
    """Move the car over its range, and ask FCL what it meets on the way."""
    model, obstacles = scene.model, probes.obstacles
    bodies = [body for body in range(1, model.nbody) if body_name(model, body) == link.name]
    if not bodies or model.body_jntnum[bodies[0]] != 1:
        return
    body, joint = bodies[0], int(model.body_jntadr[bodies[0]])
    own = geoms_of_bodies(model, body, int(find_subtree_ends(model)[body])).tolist()
    car = [item for item in obstacles.items if item.geom in own]
    if not car or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_SLIDE:
        return
    axis = float(scene.data.xaxis[joint, 2])
    now = float(scene.data.qpos[model.jnt_qposadr[joint]])
    low, high = sorted(axis * (end - now) for end in model.jnt_range[joint])
    # what it rests on, or reaches, at the ends of its way is no obstacle
    ups = np.linspace(low + tolerance, high - tolerance, max(int((high - low) / STEP), 1) + 1)
    is_other = np.array([item.geom not in own for item in obstacles.items])
    for item in car:
        if (hit := _first_hit(item, ups, obstacles, is_other)) is not None:
            up, number = hit
            name = obstacles.name(number)
            x, y, z = ((item.low + item.high) / 2 + np.array([0, 0, up])).tolist()
            text = f"the car of {link.kind} {link.name!r} runs into {name!r}, moved by {up:.2f} m"
            yield _finding(LINK_TOUCHES, link, grid, (x, y, z), text, name)
            return


def _first_hit(item: Any, ups: Float, obstacles: Any, is_other: Bool) -> tuple[float, int] | None:
    """How far up a part of a car first meets another obstacle [m], and which."""
    lift = np.array([0.0, 0.0, 1.0])
    near = obstacles.meeting(item.low + lift * ups[0], item.high + lift * ups[-1])
    others = [number for number in near if is_other[number]]
    start = np.array(item.shape.getTranslation())
    try:
        for up in ups.tolist():
            item.shape.setTranslation(start + lift * up)
            for number in others:
                if fcl.collide(item.shape, obstacles.items[number].shape) > 0:
                    return up, number
    finally:
        item.shape.setTranslation(start)
    return None


def _cells_along(link: Link, grid: GridBase) -> list[tuple[float, float]]:
    """The places on the straight line between two stops' cells, a cell apart; x, y [m]."""
    ends = []
    for stop in link.stops:
        level = grid.levels[stop.level]
        ends.append(level.lattice.positions(*divmod(stop.cell, level.width)))
    count = max(round(float(np.abs(ends[1] - ends[0]).max()) / grid.levels[0].lattice.cell_size), 1)
    line = ends[0] + np.linspace(0.0, 1.0, count + 1)[:, None] * (ends[1] - ends[0])
    return [(float(x), float(y)) for x, y in line]


def _walks_to(places: list[tuple[float, float]], level: SceneGrid2D, grid: GridBase) -> int:
    """The number of the last place to which one walks from the first, on a level."""
    last = _floor_at(level, places[0])
    for number, place in enumerate(places[1:]):
        floor = _floor_at(level, place)
        if np.isnan(floor) or abs(floor - last) > grid.max_step + SLACK or not _at(level, place)[0]:
            return number
        last = floor
    return len(places) - 1


def _floor_at(level: SceneGrid2D, place: tuple[float, float]) -> float:
    return _at(level, place)[1]


def _at(level: SceneGrid2D, place: tuple[float, float]) -> tuple[bool, float]:
    """Whether the cell at a place is free, and its floor [m]; NaN for none."""
    row, col = (int(v) for v in level.lattice.rows_cols(place))
    if not (0 <= row < level.height and 0 <= col < level.width):
        return False, float("nan")
    floor = level.floor_of(np.array([row]), np.array([col]))
    return bool(np.isfinite(level.weights[row, col])), float(floor[0])


def _finding(
    kind: str, link: Link, grid: GridBase, at: tuple[float, ...], text: str, geom: str | None
) -> Finding:
    stop = link.stops[0]
    cell = divmod(stop.cell, grid.levels[stop.level].width)
    x, y, z = (float(value) for value in at)
    return Finding(kind, stop.level, cell, (x, y, z), text, geom)
