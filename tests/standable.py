"""The sheets of a bake that stopped before its floors were chosen."""

from __future__ import annotations

from navbake.baker.columns import ColumnSource
from navbake.baker.floors.sheets import Sheets, find_sheets
from navbake.baker.floors.surfaces import find_surfaces
from navbake.baker.stages import Stages


def sheets_of(stages: Stages, columns: ColumnSource | None = None) -> Sheets:
    """The sheets that steps make of the surfaces in the columns, those of the bake if None."""
    source = stages.column_blocks if columns is None else columns
    agent = stages.config.agent
    return find_sheets(find_surfaces(source, stages.tile_index.shapes.planes, agent), agent)
