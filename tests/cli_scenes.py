"""Small scenes that the tests of the commands share."""

from __future__ import annotations

from pathlib import Path

ROOM = """
<mujoco>
  <worldbody>
    <geom name="floor" type="box" size="3 2 .1" pos="0 0 -.1"/>
    <geom name="wall [b]" type="box" size=".1 2 1" pos="1 0 1"/>
    <body name="lamp">
      <geom name="shade" type="sphere" size=".1" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
</mujoco>
"""
ARENA = """
<mujoco>
  <worldbody>
    <geom name="floor" type="box" size=".75 1 .05" pos=".75 1 -.05"/>
    <geom name="block" type="box" size=".1 .05 .2" pos="1.2 .25 .2"/>
    <body name="cart" pos=".3 1.6 .3"><geom type="sphere" size=".15"/></body>
  </worldbody>
</mujoco>
"""
# the two parts of a map descriptor of an arena
P1 = "FFC07F80FF01FE03FFFFFFF3FFE7FFCFFF9C7F38FE71FCE3F87FF0FFE1FFC3FF87FF0E0E1C1F"
P2 = "00000100001C80000000001C0000080000060001C00000080000"


def write_room(folder: Path) -> None:
    """Write room.xml and room.yaml."""
    (folder / "room.xml").write_text(ROOM)
    (folder / "room.yaml").write_text("scene: {path: room.xml}\ngrid: {cell_size: 0.5}\n")


def write_arena(folder: Path) -> None:
    """Write arena.xml and arena.yaml."""
    (folder / "arena.xml").write_text(ARENA)
    (folder / "arena.yaml").write_text(
        "scene: {path: arena.xml}\nagent: {height: 0.4, traversable_floor_height: 0.05}\n"
        "floors: {min_area: 0.1, shrink: 0.1}\n"
    )
