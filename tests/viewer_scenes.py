"""Small scenes and grids that the tests of the viewer share."""

from pathlib import Path
from typing import Any

import mujoco

import navbake
from navbake.views.viewer.view import make_view_state
from navbake.views.viewer.view_state import ViewState

# 4 x 3 m: a wall with an opening of 0.8 m, a table beside it, a mesh that only viewers see
ROOM = """<mujoco model="room">
<asset>
  <mesh name="wedge" vertex="0 0 0 .3 0 0 0 .3 0 0 0 .3"/>
  <material name="wood" rgba=".6 .4 .2 1"/>
</asset>
<worldbody>
  <geom name="floor" type="box" size="2 1.5 .1" pos="0 0 -.1"/>
  <geom name="wall" type="box" size=".05 1.1 1" pos="0 -.4 1"/>
  <body name="table" pos="1 .5 0"><geom type="cylinder" size=".3 .35" pos="0 0 .35" material="wood"/></body>
  <geom name="shown" type="mesh" mesh="wedge" pos="-1.5 -1 0" contype="0" conaffinity="0" group="2"/>
  <geom name="hidden" type="sphere" size=".1" pos="1.5 -1 1.5" group="3"/>
</worldbody></mujoco>"""  # noqa: E501


def room_view_state() -> ViewState:
    """The room, baked at 0.1 m for a point."""
    model = mujoco.MjModel.from_xml_string(ROOM)
    grid = navbake.bake(model, agent={"radius": 0.0}, grid={"cell_size": 0.1})
    return make_view_state(grid, model)


def write_room(folder: Path, **more: Any) -> Path:
    """The room as a scene file, and settings for it; returns the settings' path."""
    (folder / "room.xml").write_text(ROOM)
    path = folder / "room.yaml"
    path.write_text("scene: {path: room.xml}\nagent: {radius: 0}\ngrid: {cell_size: 0.1}\n")
    return path
