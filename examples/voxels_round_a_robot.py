"""Keep a scene ready, and make voxel grids round a robot that moves through it.

python examples/voxels_round_a_robot.py
"""

import time

import numpy as np

import navbake

# The scene is loaded once. `ignore` leaves bodies out, such as the robot itself.
voxelizer = navbake.Voxelizer(navbake.samples.path("apartment"), ignore=["ball"])
voxelizer.create((0.0, 0.0, 0.75), (2, 2, 2), res=0.05, segments="top")  # compiles, the first time

for x, y in ((-2.0, -2.6), (0.5, 0.5), (3.0, 1.8)):
    begin = time.perf_counter()
    near = voxelizer.create((x, y, 0.75), (40, 40, 30), res=0.05, segments="top")
    took = time.perf_counter() - begin
    names = sorted(near.names[number] for number in near.ids())
    print(f"robot at ({x}, {y}): {np.count_nonzero(near.values)} voxels, {1e3 * took:.0f} ms")
    print(f"  in reach: {', '.join(names)}")

# Another pose: voxels follow, and nothing is loaded again.
doorway = (2.6, 1.5, 1.0)
for angle in (0.0, 1.2):
    voxelizer.set_pose(joints={"door_kitchen": angle})
    near = voxelizer.create(doorway, (20, 20, 20), res=0.05)
    print(f"door at {angle} rad: {np.count_nonzero(near.values)} voxels")

voxelizer.create(res=0.05, align=True).save("apartment.bt")  # the whole scene as an octree
tree = navbake.load_voxels("apartment.bt")
print(f"apartment.bt: {tree.shape} voxels, {np.count_nonzero(tree.values)} occupied")
