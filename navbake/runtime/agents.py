"""Grids for agents of other sizes than the one that a grid was baked for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from weakref import WeakSet

import numpy as np

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.islands import renew_islands
from navbake.navgrid.links import Agent
from navbake.runtime.blocking import block
from navbake.runtime.flat_grid import check_distance, check_positive
from navbake.runtime.inflation import check_radius, ledges_setting

SIZE_TOLERANCE = 1e-9  # [m]: sizes that differ by less are equal
FLOOR_ROUNDING = 1e-5  # [m]: rounding error of floor heights, which files hold as float32


def find_agent(grid: NavGrid, agent: str | Agent | None) -> Agent | None:
    """Find the agent of a given name in the grid's `agents`.

    Args:
        grid: the grid.
        agent: the agent's name; an `Agent` or None is returned unchanged.

    Raises:
        QueryError: the grid lists no such agent, or it is neither a name nor an `Agent`.
    """
    if agent is None or isinstance(agent, Agent):
        return agent
    if not isinstance(agent, str):
        expected = "the name of an agent or a navbake.Agent"
        hint = 'write navbake.Agent("robot", radius=0.2)'
        raise QueryError(
            f"expected {expected}, got {agent!r}: {hint}",
            key="agent",
            value=agent,
            expected=expected,
            hint=hint,
        )
    agents: Mapping[str, Agent] = grid.agents
    if agent not in agents:
        hint = suggest(agent, agents)
        raise QueryError(
            f"no agent {agent!r} in {grid.scene_id!r}: {hint}", key="agent", value=agent, hint=hint
        )
    return agents[agent]


def check_agent(agent: Agent) -> None:
    """Check the sizes and the speed of an agent that a user makes.

    Args:
        agent: the agent. Those of files were checked when these were read.

    Raises:
        QueryError: a size or the speed is no such number as `Agent` says.
    """
    if agent.radius is not None:
        check_radius(agent.radius)
    if agent.height is not None:
        check_positive(agent.height, "height")
    if agent.step is not None:
        check_distance(agent.step, "step")
    check_positive(agent.speed, "speed")


def fit_grid(grid: NavGrid, agent: Agent | None) -> NavGrid:
    """Make the grid for an agent's size: inflated to its radius, without steps too high for it.

    Obstacles that are added to the original grid later block the new grid, too. Only the heights of
    floors decide whether an agent can take a step. So it can't use a ramp that rises by more than
    its step within one cell.

    Args:
        grid: the original grid.
        agent: the agent; None for the grid's own.

    Returns:
        A new grid; the original one if it fits the agent.

    Raises:
        QueryError: the agent is higher, takes higher steps, or is smaller than the grid was
            inflated for, or a number of it is none that an agent can have.
    """
    if agent is None:
        return grid
    check_agent(agent)
    grid_name = f"the grid of {grid.scene_id or 'scene'!r}"
    agent_name = f" (agent {agent.name!r})" if agent.name else ""
    for noun, key, size, limit in (
        ("agents", "height", agent.height, grid.agent_height),
        ("steps", "traversable_floor_height", agent.step, grid.max_step),
    ):
        if size is not None and size > limit + SIZE_TOLERANCE:
            hint = f"bake it with agent.{key}={size:g}"
            raise QueryError(
                f"{grid_name} is for {noun} up to {limit:g} m, got {size:g} m{agent_name}: {hint}",
                key="agent",
                value=size,
                expected=f"{noun} up to {limit:g} m",
                hint=hint,
            )
    grid_without_added: NavGrid = grid.without_obstacles()
    fitted_grid = grid_without_added
    radius = agent.radius
    if agent.step is not None and agent.step < grid.max_step - SIZE_TOLERANCE:
        fitted_grid = _limit_steps(grid_without_added, agent.step)
    # a grid that was baked for this radius, but not inflated, has other cells than an inflated one
    if radius is not None and not (
        grid.exact_inflations and math.isclose(radius, grid.inflated_radius, abs_tol=SIZE_TOLERANCE)
    ):
        if radius < grid.inflated_radius:
            hint = "plan on the grid as it was baked"
            raise QueryError(
                f"{grid_name} was inflated to {grid.radius:g} m, got {radius:g} m{agent_name}: "
                f"{hint}",
                key="agent",
                value=radius,
                hint=hint,
            )
        fitted_grid = fitted_grid.inflate(radius, ledges=ledges_setting(grid))
    if fitted_grid is grid_without_added:
        return grid
    grid.fitted_grids = grid.fitted_grids or WeakSet()
    grid.fitted_grids.add(fitted_grid)
    for obstacle in grid.obstacles:
        obstacle.copies.append(block(fitted_grid, **obstacle.arguments))
    return fitted_grid


def _limit_steps(grid: NavGrid, max_step: float) -> NavGrid:
    """Copy a grid without obstacles, but limit the steps between its floors.

    Args:
        grid: the grid, which stays as it is.
        max_step: the highest step of the new grid [m]; steps between levels that rise by more are
            left out.
    """
    floor = np.concatenate([level.floor.ravel() for level in grid.levels])
    first_cells = np.cumsum([0] + [level.width * level.height for level in grid.levels])
    step_cells = first_cells[grid.step_array[:, ::2]] + grid.step_array[:, 1::2]
    is_low_enough = np.abs(np.diff(floor[step_cells])[:, 0]) <= max_step + FLOOR_ROUNDING
    metadata = {**grid.metadata, "traversableFloorHeight": max_step / grid.unit}
    if not is_low_enough.all():
        links = [*grid.step_array[is_low_enough].tolist(), *(link.to_json() for link in grid.links)]
        metadata["navbake"] = {**grid.navbake, "links": links}
    limited_grid = grid.with_levels([level.with_layers() for level in grid.levels], metadata)
    renew_islands(limited_grid)
    return limited_grid
