"""Find doors, and change their states without another bake.

python examples/doors.py
"""

import tempfile
from pathlib import Path

import navbake

# Two rooms, and a door between them. Its joint is modelled closed (0).
SCENE = """
<mujoco>
  <compiler angle="degree"/>
  <worldbody>
    <geom name="floor" type="box" size="3 1.5 0.05" pos="3 1.5 -0.05"/>
    <geom name="wall_south" type="box" size="3 0.05 1.2" pos="3 0.05 1.2"/>
    <geom name="wall_north" type="box" size="3 0.05 1.2" pos="3 2.95 1.2"/>
    <geom name="wall_west" type="box" size="0.05 1.5 1.2" pos="0.05 1.5 1.2"/>
    <geom name="wall_east" type="box" size="0.05 1.5 1.2" pos="5.95 1.5 1.2"/>
    <geom name="wall_a" type="box" size="0.05 0.5 1.2" pos="3 0.6 1.2"/>
    <geom name="wall_b" type="box" size="0.05 0.5 1.2" pos="3 2.4 1.2"/>
    <body name="door" pos="3 1.1 1">
      <joint name="hinge" type="hinge" axis="0 0 1" range="0 90"/>
      <geom name="leaf" type="box" size="0.02 0.39 0.98" pos="0 0.4 0"/>
    </body>
  </worldbody>
</mujoco>
"""

with tempfile.TemporaryDirectory() as folder:
    scene = Path(folder) / "two_rooms.xml"
    scene.write_text(SCENE)
    grid = navbake.bake(scene)

for door in grid.doors:
    print(f"{door.id}: joint {door.joint}, {door.state}, joins {door.rooms}, can be {door.states}")

west, east = (1.0, 1.5, 0.0), (5.0, 1.5, 0.0)
for state in ("closed", "open", "removed"):
    changed = grid.with_doors({"door": state})  # another grid; the scene is not needed
    finder = navbake.PathFinder(changed)
    path = finder.find_path(west, east)
    print(f"{state}: {f'{path.length:.2f} m' if path else finder.why_not(west, east)}")
