"""Tasks for agents in baked scenes: sets of episodes, drawn, read and written.

`make_episodes` draws a set on grids, `make_flight_episodes` in voxels; `write_episodes` writes it
to a file, and `read_episodes` reads it. `navbake.scores` computes how well an agent did.
"""

from navbake.episodes.episode import (
    Agent,
    Episode,
    EpisodeSet,
    Goal,
    GridEntry,
    Header,
    Stance,
    ViewPoint,
    digest_of,
)
from navbake.episodes.files import read_episodes, write_episodes
from navbake.episodes.flights import (
    FlightRules,
    digest_of_voxels,
    make_flight_episodes,
    make_flight_finder,
    make_flight_rules,
)
from navbake.episodes.goals import Task
from navbake.episodes.sampler import (
    PRESETS,
    Rules,
    Splits,
    make_episodes,
    make_rules,
    make_splits,
    make_task,
)

__all__ = [
    "PRESETS", "Agent", "Episode", "EpisodeSet", "FlightRules", "Goal", "GridEntry", "Header",
    "Rules", "Splits", "Stance", "Task", "ViewPoint", "digest_of", "digest_of_voxels",
    "make_episodes", "make_flight_episodes", "make_flight_finder", "make_flight_rules",
    "make_rules", "make_splits", "make_task", "read_episodes", "write_episodes",
]  # fmt: skip
