"""The volume over a cell's floor that has to be free for an agent to stand there."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from navbake.baker.core.arrays import HeightRange
from navbake.baker.core.tolerances import TOUCH_DEPTH

if TYPE_CHECKING:
    from navbake.config.settings import AgentSettings


class Footprint(NamedTuple):
    """The volume over a cell's floor that has to be free for an agent to stand there.

    It is an upright prism. Its base is the union of the cell's square and the agent's disc round
    the cell's centre. It begins above the highest step that the agent can take, and ends at the
    agent's height. It is smaller by TOUCH_DEPTH on all sides, so that what only touches it does not
    block it.

    Attributes:
        half_square: half of the square's edge, less TOUCH_DEPTH; 0 if the disc covers the square
            [m].
        radius: the disc's radius less TOUCH_DEPTH; 0 if the square covers the disc [m].
        low: height of the volume's bottom above the floor: the highest step plus TOUCH_DEPTH [m].
        high: height of the volume's top above the floor: the agent's height less TOUCH_DEPTH [m].
    """

    half_square: float
    radius: float
    low: float
    high: float

    @property
    def half_width(self) -> float:
        """Return half the footprint's width along x or y, including TOUCH_DEPTH [m]."""
        return max(self.half_square, self.radius) + TOUCH_DEPTH

    @classmethod
    def for_agent(cls, agent: AgentSettings, cell_size: float) -> Footprint:
        """Return the footprint of an agent over a cell.

        Args:
            agent: the agent; its radius, height and highest step are read.
            cell_size: edge of a cell [m].
        """
        half_cell_size = cell_size / 2
        radius = agent.radius
        disc_covers_square = radius >= half_cell_size * np.sqrt(2.0)
        square_covers_disc = radius <= half_cell_size
        return cls(
            half_square=0.0 if disc_covers_square else half_cell_size - TOUCH_DEPTH,
            radius=0.0 if square_covers_disc else radius - TOUCH_DEPTH,
            low=agent.traversable_floor_height + TOUCH_DEPTH,
            high=agent.height - TOUCH_DEPTH,
        )

    def with_heights(self, heights: HeightRange) -> Footprint:
        """Return the volume with the same base between two other heights over the floor [m]."""
        return self._replace(low=heights.low + TOUCH_DEPTH, high=heights.high - TOUCH_DEPTH)
