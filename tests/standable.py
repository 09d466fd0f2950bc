"""The sheets of a bake that stopped before its floors were chosen."""

from __future__ import annotations

from navbake.baker.columns import ColumnSource
from navbake.baker.floors.sheets import Sheets
from navbake.baker.floors.surfaces import SurfaceStore
from navbake.baker.stages import Stages


def sheets_of(stages: Stages, columns: ColumnSource | None = None) -> Sheets:
    """The sheets that steps make of the surfaces in the columns, those of the bake if None."""
    found = columns or stages.columns
    store = SurfaceStore(found.lattice, stages.config.agent)
    for block in found.blocks():
        store.add(block, stages.tiled.shapes.planes)
    store.finish()
    sheets = Sheets(store, stages.config.agent)
    every = sheets.blocks.all()
    sheets.update(every, every)
    return sheets
