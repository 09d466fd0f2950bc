"""What an agent can stand and walk on, as kernels take it."""

from typing import NamedTuple

import numpy as np

from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.config.settings import AgentSettings


class AgentLimits(NamedTuple):
    """What an agent can stand and walk on.

    Attributes:
        min_up: cosine of the largest slope, less a slack.
        headroom: the agent's height [m].
        step: the largest step [m].
    """

    min_up: float
    headroom: float
    step: float


def agent_limits(agent: AgentSettings) -> AgentLimits:
    """What an agent can stand on, as kernels take it."""
    min_up = float(np.cos(np.radians(agent.max_slope))) - LIMIT_SLACK
    return AgentLimits(min_up, agent.height, agent.traversable_floor_height)
