"""Put an agent somewhere, plan a path, and go round what stands in the way for now.

python examples/spawn_and_plan.py
"""

import numpy as np

import navbake

grid = navbake.bake(navbake.samples.path("house"))
finder = navbake.PathFinder(grid)
rng = np.random.default_rng(3)

# A random place downstairs, from which the goal can be reached.
upstairs = next(room for room in grid.rooms if room.level == 1)
start = finder.random_point(rng, level=0, reachable_from=finder.random_point(rng, room=upstairs.id))
print(f"start at {np.round(start, 2)} in room {finder.room_at(start)}")

path = finder.find_path(start, f"room:{upstairs.id}")
print(f"{path.length:.1f} m to room {upstairs.id} through {path.rooms}, doors {path.doors}")
for distance in np.arange(0.0, path.length, 2.0):
    print(f"  after {distance:4.1f} m: {np.round(path.at(distance), 2)}")

# Something stands on the path for a while: paths go round it, or there is none.
with grid.block(disc=(path.at(path.length / 2), 0.3)):
    around = finder.find_path(start, f"room:{upstairs.id}")
    if around is None:
        print("blocked:", finder.why_not(start, f"room:{upstairs.id}"))
    else:
        print(f"round it: {around.length:.1f} m")

print("outside of the grid:", finder.why_not(start, (50.0, 0.0, 0.0)))
