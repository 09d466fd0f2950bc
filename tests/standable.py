"""The regions of a bake that stopped before its floors were chosen."""

from __future__ import annotations

from navbake.baker.bake.stages import Stages
from navbake.baker.columns.columns import ColumnSource
from navbake.baker.floors.regions import Regions, find_regions
from navbake.baker.floors.surfaces import find_surfaces


def regions_of(stages: Stages, columns: ColumnSource | None = None) -> Regions:
    """The regions that steps make of the surfaces in the columns, those of the bake if None."""
    source = stages.column_chunks if columns is None else columns
    agent = stages.config.agent
    return find_regions(find_surfaces(source, stages.shape_source.shapes.planes, agent), agent)
