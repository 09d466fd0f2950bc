"""Which agent plans, and the grid for its size."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any
from weakref import WeakSet

import numpy as np

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.navgrid.agents import Agent
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.islands import renew_islands
from navbake.runtime.blocks import block
from navbake.runtime.inflation import check_radius, ledges_of

SAME = 1e-9  # [m] between two sizes that are one
ROUNDING = 1e-5  # [m] of floors in files, which are float32


def find_agent(grid: NavGrid, agent: str | Agent | None) -> Agent | None:
    """The agent of a name that the grid lists; an agent, or None, as it is given."""
    if agent is None or isinstance(agent, Agent):
        return agent
    known: Mapping[str, Agent] = grid.agents
    if agent not in known:
        raise QueryError(f"no agent {agent!r} in {grid.scene_id!r}: {suggest(agent, known)}")
    return known[agent]


def fit_grid(grid: NavGrid, agent: Agent | None) -> NavGrid:
    """The grid for an agent's size: inflated to its radius, with steps as low as it takes.

    It follows the blocks of the given grid, which is returned itself if it fits. Goes by floors
    alone where steps are lowered: a ramp that rises more over a cell is none for the agent.

    Raises:
        QueryError: the agent is higher, takes higher steps, or is smaller than the grid was
            inflated for.
    """
    if agent is None:
        return grid
    of, name = f"the grid of {grid.scene_id or 'scene'!r}", f" (agent {agent.name!r})"
    name = name if agent.name else ""
    for what, key, stated, most in (
        ("agents", "height", agent.height, grid.agent_height),
        ("steps", "traversable_floor_height", agent.step, grid.max_step),
    ):
        if stated is not None and stated > most + SAME:
            got = f"got {stated:g} m{name}: bake it with agent.{key}={stated:g}"
            raise QueryError(f"{of} is for {what} up to {most:g} m, {got}")
    clean: NavGrid = grid.without_blocks()
    fitted, radius = clean, agent.radius
    if agent.step is not None and agent.step < grid.max_step - SAME:
        fitted = _with_step(fitted, agent.step)
    if radius is not None and not math.isclose(radius, grid.radius, abs_tol=SAME):
        check_radius(radius)
        if radius < grid.inflated_radius:
            got = f"got {radius:g} m{name}: plan on the grid as it was baked"
            raise QueryError(f"{of} was inflated to {grid.radius:g} m, {got}")
        fitted = fitted.inflate(radius, ledges=ledges_of(grid))
    if fitted is clean:
        return grid
    grid.fitted = grid.fitted or WeakSet()
    grid.fitted.add(fitted)
    for held in grid.blocks:
        held.copies.append(block(fitted, **held.arguments))
    return fitted


def _with_step(grid: NavGrid, step: float) -> NavGrid:
    """The grid for an agent that takes lower steps."""
    floor = np.concatenate([level.floor.ravel() for level in grid.levels])
    start = np.cumsum([0] + [level.width * level.height for level in grid.levels])
    ends = start[grid.step_array[:, ::2]] + grid.step_array[:, 1::2]
    is_high = np.abs(np.diff(floor[ends])[:, 0]) > step + ROUNDING
    metadata: dict[str, Any] = {**grid.metadata, "traversableFloorHeight": step / grid.unit}
    if is_high.any():
        links = [*grid.step_array[~is_high].tolist(), *(link.to_json() for link in grid.links)]
        metadata["navbake"] = {**grid.navbake, "links": links}
    changed = grid.with_levels([level.with_layers() for level in grid.levels], metadata)
    renew_islands(changed)
    return changed
