"""For which agent a grid is: what its metadata state of the agent, and of inflations."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from navbake.errors import FormatError, QueryError
from navbake.navgrid.grid_base import GridBase
from navbake.navgrid.lattice import FARTHEST

MODES = ("exact", "minos")
MOST_RADIUS = 10_000.0  # for which a grid can be inflated [m]


class Agent(NamedTuple):
    """For whom the grid is: height, radius and step as baked [m]."""

    height: float
    radius: float
    step: float
    min_up: float  # least z of a floor's unit normal

    @classmethod
    def of(cls, grid: GridBase) -> Agent:
        """The agent that a grid states, with the format's defaults for what it doesn't state.

        Raises:
            FormatError: what it states is no size of an agent.
        """
        most, slope = float(FARTHEST / grid.unit), grid.navbake.get("maxSlope")
        stated = {**grid.metadata, "maxSlope": slope}
        for key, least, largest, expected in (
            ("agentHeight", math.ulp(0.0), most, "a length > 0"),
            ("agentRadius", 0, most, "a length >= 0"),
            ("traversableFloorHeight", 0, most, "a length >= 0"),
            ("maxSlope", 0, 90, "0 to 90 degrees"),
        ):
            value = stated.get(key)
            if value is not None and not _is_within(value, least, largest):
                raise FormatError(
                    f"the grid's metadata: expected {expected} as `{key}`, got "
                    f"{repr(value)[:50]}: cells can't be judged for such an agent"
                )
        if grid.agent_height <= grid.max_step:
            raise FormatError(
                f"the grid's metadata: expected `agentHeight` above `traversableFloorHeight`, got "
                f"{grid.agent_height:g} and {grid.max_step:g} m: nothing is left to judge cells by"
            )
        min_up = float(np.cos(np.radians(45.0 if slope is None else slope)))
        return cls(grid.agent_height, grid.agent_radius, grid.max_step, min_up)


def _is_within(value: Any, least: float, most: float) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and least <= value <= most


class Inflation(NamedTuple):
    """What was done to a grid for a larger agent."""

    radius: float | None = None  # of the cylinder on free cells [m]; None for the baked footprint
    reach: float = 0.0  # how far from a closed cell's centre the reason may be [m]
    by_centres: bool = False  # whether that is any occupied cell, as in the mode ``minos``


def inflate_for(grid: Any, radius: float | None) -> tuple[Any, Inflation, list[str]]:
    """The grid for a radius [m], or as it is if None; what was done to it; and notes.

    A grid that was inflated for a smaller radius is inflated further: that gives what one
    inflation for the larger radius gives.

    Raises:
        QueryError: the grid was inflated for a larger radius, or in the mode ``minos``.
        FormatError: the metadata state an inflation for no radius.
    """
    done, notes = _stated_inflation(grid)
    if radius is None:
        return grid, done, notes
    if done.by_centres:
        raise QueryError(
            "the grid was inflated in the mode minos, whose cells promise nothing for a radius: "
            "leave the radius out, or give the grid as it was before"
        )
    if done.radius is not None and radius < done.radius:
        raise QueryError(
            f"the grid was inflated for {done.radius:g} m, which can't be undone for {radius:g} m: "
            f"expected a radius of at least {done.radius:g} m, or the grid as it was before"
        )
    inflated = grid if radius == done.radius else grid.inflate(radius)
    return inflated, Inflation(radius, radius), notes


def _stated_inflation(grid: GridBase) -> tuple[Inflation, list[str]]:
    """The inflation that the metadata state, and what a user should know of it."""
    stated, notes = grid.metadata.get("inflation", []), []
    entries = stated if isinstance(stated, list) else [stated]
    done = [e for e in entries if isinstance(e, dict) and e.get("mode") in MODES]
    if not isinstance(stated, list) or len(done) < len(entries):
        done = done if isinstance(stated, list) else []
        notes.append(
            "the metadata's `inflation` isn't as navbake writes it: what it closed has to touch "
            "something by itself"
        )
    for entry in done:
        if not _is_within(entry.get("radius"), 0, MOST_RADIUS):
            raise FormatError(
                f"the grid's metadata: expected a radius of 0 to {MOST_RADIUS:,.0f} m in "
                f"`inflation`, got {repr(entry.get('radius'))[:50]}"
            )
    largest = max((float(entry["radius"]) for entry in done), default=0.0)
    if all(entry["mode"] == "exact" for entry in done):
        return Inflation(largest if done else None, largest), notes
    notes.append(
        "inflated in the mode minos, which measures from the centres of cells: free cells are "
        "judged by the baked footprint"
    )
    return Inflation(None, largest, by_centres=True), notes
