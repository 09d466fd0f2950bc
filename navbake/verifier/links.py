"""Whether links are free: the ways over drops and jumps with their landings, and lifts' shafts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import fcl
import mujoco
import numpy as np

from navbake.baker.scene.names import body_name, find_subtree_ends, geoms_of_bodies
from navbake.baker.scene.scene import Scene
from navbake.errors import FormatError
from navbake.navgrid.grid import GridBase
from navbake.navgrid.links import Link
from navbake.verifier.floors import rounding
from navbake.verifier.lines import Lines
from navbake.verifier.probes import TOUCHES, Column, Probes
from navbake.verifier.report import LINK_TOUCHES, NO_LANDING, Finding
from navbake.verifier.sample import SLACK, Agent

CROSSED = ("drop", "jump")  # kinds of links whose way runs straight from stop to stop
STEP = 0.02  # between the positions of a car that are looked at [m]


def check_links(
    grid: GridBase, scene: Scene, probes: Probes, lines: Lines, agent: Agent, tolerance: float
) -> tuple[list[Finding], list[str]]:
    """Check the links of a grid: drops and jumps for the agent, lifts that the bake found.

    The agent's column has to touch nothing over each cell between the stops of a drop or a jump,
    over the higher of both floors, and down to the landing; whose floor has to be a surface. The
    car of a lift has to touch nothing on its way between the ends of its joint's range. Returns
    notes of the lifts whose car isn't found, too.
    """
    try:
        links = grid.links
    except FormatError:  # what an audit reports
        return [], []
    findings, notes = list[Finding](), list[str]()
    for link in links:
        if link.kind in CROSSED and len(link.stops) == 2:
            findings += _check_crossing(link, grid, probes, lines, agent, tolerance)
        elif link.kind == "lift" and link.auto:
            body = _find_car(link, scene)
            if body is None:
                notes.append(f"lift {link.name!r} was not checked: no body of its name slides")
            else:
                findings += _check_shaft(link, body, grid, scene, probes, tolerance)
    return findings, notes


def _find_car(link: Link, scene: Scene) -> int | None:
    """The body of a lift's car: that of its name, or of the one that the bake numbered."""
    model = scene.model
    names = [body_name(model, body) for body in range(model.nbody)]
    for name in (link.name, link.name.rpartition("#")[0]):
        body = names.index(name) if name in names else 0
        joint = int(model.body_jntadr[body])
        if joint >= 0 and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
            return body
    return None


def _check_crossing(
    link: Link, grid: GridBase, probes: Probes, lines: Lines, agent: Agent, tolerance: float
) -> Iterator[Finding]:
    levels = [grid.levels[stop.level] for stop in link.stops]
    ends = [
        level.lattice.positions(*divmod(stop.cell, level.width))
        for stop, level in zip(link.stops, levels, strict=True)
    ]
    cell_size = levels[0].lattice.cell_size
    count = max(round(float(np.abs(ends[1] - ends[0]).max()) / cell_size), 1)
    line = ends[0] + np.linspace(0.0, 1.0, count + 1)[:, None] * (ends[1] - ends[0])
    # up to where, and from where on, one walks on the floors of both ends
    walks = []
    for level, places in zip(levels, (line, line[::-1]), strict=True):
        rows, cols = level.lattice.rows_cols(places)
        inside = (rows >= 0) & (rows < level.height) & (cols >= 0) & (cols < level.width)
        rows, cols = rows[inside], cols[inside]
        floor = level.floor_of(rows, cols)
        step = np.abs(np.diff(floor, prepend=floor[:1])) > agent.step + SLACK
        stops = ~level.free[rows, cols] | np.isnan(floor) | step
        last = int(np.argmax(np.append(stops, True))) - 1
        walks.append((last, float(floor[max(last, 0)])))
    (first, start), (back, z) = walks
    crossed = line[max(first, 0) : len(line) - max(back, 0)]
    if len(crossed) < 2:  # one walks all the way
        return
    top = max(start, z)
    lows = np.full(len(crossed), top)
    lows[[0, -1]] = start, z  # over the ends, from their floors on
    half = cell_size / 2
    for (x, y), low in zip(crossed.tolist(), lows.tolist(), strict=True):
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
    x, y = crossed[-1].tolist()
    off = rounding(x, y, z)
    found = lines.at(x, y).faces_up(z - off, z + off)
    if not (found or lines.faces_up_beside((x, y, z), off)):
        text = f"{link.kind} {link.name!r} lands at {z:.3f} m, where no surface is"
        yield _finding(NO_LANDING, link, grid, (x, y, z), text, None)


def _check_shaft(
    link: Link, body: int, grid: GridBase, scene: Scene, probes: Probes, tolerance: float
) -> Iterator[Finding]:
    """Move the car over its range, and ask FCL what it meets on the way."""
    model, obstacles, up = scene.model, probes.obstacles, np.array([0.0, 0.0, 1.0])
    joint = int(model.body_jntadr[body])
    own = geoms_of_bodies(model, body, int(find_subtree_ends(model)[body])).tolist()
    axis = float(scene.data.xaxis[joint, 2])
    now = float(scene.data.qpos[model.jnt_qposadr[joint]])
    low, high = sorted(axis * (end - now) for end in model.jnt_range[joint])
    # what it rests on, or reaches, at the ends of its way is no obstacle
    moves = np.linspace(low + tolerance, high - tolerance, max(int((high - low) / STEP), 1) + 1)
    for item in (item for item in obstacles.items if item.geom in own):
        near = obstacles.meeting(item.low + up * moves[0], item.high + up * moves[-1])
        others = [number for number in near if obstacles.items[number].geom not in own]
        start = np.array(item.shape.getTranslation())
        for move, number in product(moves.tolist(), others):
            item.shape.setTranslation(start + up * move)
            if fcl.collide(item.shape, obstacles.items[number].shape) > 0:
                name = obstacles.name(number)
                text = f"the car of {link.kind} {link.name!r} runs into {name!r}, "
                place = (item.low + item.high) / 2 + up * move
                text += f"moved by {move:.2f} m"
                yield _finding(LINK_TOUCHES, link, grid, place.tolist(), text, name)
                break
        item.shape.setTranslation(start)


def _finding(
    kind: str, link: Link, grid: GridBase, at: Sequence[float], text: str, geom: str | None
) -> Finding:
    stop = link.stops[0]
    cell = divmod(stop.cell, grid.levels[stop.level].width)
    x, y, z = (float(value) for value in at)
    return Finding(kind, stop.level, cell, (x, y, z), text, geom)
