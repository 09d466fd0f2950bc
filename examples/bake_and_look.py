"""Bake a scene, save its grid, and look at what it holds.

python examples/bake_and_look.py
"""

import navbake

# Settings are a YAML file, a scene file, or a mapping with the same keys.
grid = navbake.bake(navbake.samples.path("house"))
grid.save("house.grid.json")

# Loading needs neither MuJoCo nor the scene.
grid = navbake.load("house.grid.json")
for number, level in enumerate(grid.levels):
    area = level.free.sum() * level.lattice.cell_size**2
    print(f"level {number}: {level.width} x {level.height} cells, ground {level.ground:.2f} m")
    print(f"  free: {area:.1f} m2, occupied: {level.occupancy.mean():.0%} of the cells")

for room in grid.rooms:
    reached = ", ".join(f"{n.room} ({n.door or n.kind})" for n in room.neighbours)
    print(f"room {room.id}: {room.area:.1f} m2, leads to {reached}")

# Arrays are [row, col]; the lattice translates between cells and the world (z up, metres).
level = grid.levels[0]
row, col = level.lattice.rows_cols((4.2, -0.5))
print(f"the stair's floor at (4.2, -0.5) is {level.floor_height[row, col]:.2f} m high")
print(f"at (1.5, -1.0) stands: {grid.blockers((1.5, -1.0), level=0)}")
