"""Tasks for agents in baked scenes: sets of episodes, made, read, written and converted.

`make_episodes` draws a set on grids, `read_episodes` and `write_episodes` keep it in a file.
`navbake.scores` says how well an agent did.
"""

from navbake.episodes.episode import (
    Agent,
    Episode,
    EpisodeSet,
    Goal,
    GridEntry,
    Header,
    ViewPoint,
    digest_of,
)
from navbake.episodes.files import read_episodes, write_episodes

__all__ = [
    "Agent",
    "Episode",
    "EpisodeSet",
    "Goal",
    "GridEntry",
    "Header",
    "ViewPoint",
    "digest_of",
    "read_episodes",
    "write_episodes",
]
