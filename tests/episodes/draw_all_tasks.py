"""Draws episodes of each task on a grid, and writes one set: ``draw_all_tasks.py GRID SET``."""

import sys

import msgspec

import navbake
from navbake.episodes import EpisodeSet, make_episodes, write_episodes

grid, found = navbake.load(sys.argv[1]), []
for task in ("point", "object", "room", "sequence", "explore", "reach"):
    content = make_episodes(grid, task, "habitat", count=15, seed=5)
    found += [msgspec.structs.replace(e, id=f"{task} {e.id}") for e in content.episodes]
write_episodes(EpisodeSet(content.header, tuple(found)), sys.argv[2])
