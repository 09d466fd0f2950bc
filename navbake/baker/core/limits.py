"""The limits of an agent on floors, as kernels take them: slope, headroom and step."""

from typing import NamedTuple

import numpy as np

from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.config.settings import AgentSettings


class AgentLimits(NamedTuple):
    """The limits of slope, headroom and step for the floors of an agent.

    Attributes:
        min_normal_z: least z of a walkable surface's unit normal: cosine of the largest slope, less
            LIMIT_SLACK.
        headroom: free height that the agent needs over a floor: its own height [m].
        max_step: largest step up or down [m].
    """

    min_normal_z: float
    headroom: float
    max_step: float


def make_agent_limits(agent: AgentSettings) -> AgentLimits:
    """Turn the settings of an agent into the limits that kernels take."""
    min_normal_z = float(np.cos(np.radians(agent.max_slope))) - LIMIT_SLACK
    return AgentLimits(min_normal_z, agent.height, agent.traversable_floor_height)
