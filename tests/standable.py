"""The standable surfaces of a bake that stopped before its floors were chosen."""

from __future__ import annotations

from navbake.baker.floors.sheets import Standable, StandableFinder
from navbake.baker.stages import Stages


def standable_of(stages: Stages) -> Standable:
    """The standable surfaces, and the sheets that steps make of them."""
    columns = stages.columns
    finder = StandableFinder(columns.lattice, stages.tiled.shapes, stages.config.agent)
    for block in columns.blocks():
        finder.add(block)
    return finder.found()[0]
