"""Put a mug on a counter, and find where a robot can stand to reach it.

python examples/reach_a_mug.py
"""

import mujoco

import navbake

# The apartment, with a mug on the counter of its kitchen.
scene = navbake.samples.path("apartment").parent / "scenes/apartment.xml"
spec = mujoco.MjSpec.from_file(str(scene))
mug = spec.worldbody.add_body(name="mug", pos=(2.6, 3.4, 0.97))
mug.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=(0.04, 0.05, 0.0))
grid = navbake.bake(spec).inflate(0.15)  # the robot's disc fits through where it goes

# The robot's base is 0.4 x 0.3 m, its shoulder 0.9 m and its camera 1.1 m over the floor.
base = [(0.2, 0.15), (-0.2, 0.15), (-0.2, -0.15), (0.2, -0.15)]  # x ahead, y left [m]
robot = (0.5, 0.4, 0.0)  # in the hall
finder = navbake.PathFinder(grid)
rules = {"reach": (0.3, 0.75), "footprint": base, "height": 0.9, "sight": 1.1, "start": robot}
poses = finder.stand_poses("object:mug", count=5, **rules)
for position, heading, length in zip(
    poses.positions, poses.headings, poses.path_lengths, strict=True
):
    x, y, _ = position
    print(f"stand at {x:.2f}, {y:.2f}, face {heading:+.2f} rad, after {length:.2f} m")

# The nearest pose, and the way there.
path = finder.find_path(robot, poses.positions[0])
print(f"through {' and '.join(path.doors)}: {path.length:.2f} m")

# All cells from which the mug can be reached, and why something else cannot.
region = finder.stand_region("object:mug", **rules)
area = region[0].sum() * grid.cell_size**2
print(f"the mug can be reached from {area:.2f} m2")
print(finder.stand_poses("object:dining_lamp", **rules).why_not["dining_lamp"])

grid.plot("mug.png", layers=["occupancy"], poses=poses, region=region, route=path)
