"""Bake once for a small agent, and use the grid for larger ones.

python examples/larger_robot.py
"""

import navbake

grid = navbake.bake(navbake.samples.path("apartment"))
hall, goal = (0.5, 0.4, 0.0), "room:bedroom"

for radius in (0.05, 0.2, 0.3, 0.4):
    larger = grid.inflate(radius)  # another grid; the baked one stays as it is
    finder = navbake.PathFinder(larger)
    path = finder.find_path(hall, goal)
    answer = f"path of {path.length:.1f} m" if path else finder.why_not(hall, goal)
    print(f"radius {radius:.2f} m: {finder.navigable_area:4.1f} m2 free, {answer}")

# Keep away from walls where there is room: cells near them cost more.
careful = navbake.PathFinder(grid.inflate(0.15, clearance=0.25))
plain = navbake.PathFinder(grid.inflate(0.15))
for name, finder in (("plain", plain), ("careful", careful)):
    path = finder.find_path(hall, (-3.5, -1.2, 0.0))
    nearest = min(finder.clearance(position) for position in path.positions)
    print(f"{name}: {path.length:.2f} m, {nearest:.2f} m from the nearest obstacle")

# A robot that is not round fits in some headings only.
outline = [(0.35, 0.15), (-0.35, 0.15), (-0.35, -0.15), (0.35, -0.15)]  # x ahead, y left [m]
(masks,) = grid.inflate_footprint(outline, num_headings=8)
print("cells by heading:", masks.sum(axis=(1, 2)).tolist())
