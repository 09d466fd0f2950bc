"""Fly a ball from the garden into a room upstairs, and keep away from walls on the way.

python examples/fly_through_a_house.py
"""

import numpy as np

import navbake
from navbake.views.flight import draw_flight

GARDEN = (0.0, -4.4, 1.5)
UPSTAIRS = (-3.0, 3.0, 4.2)
RADIUS = 0.25  # of the drone, with its rotors [m]

# Voxels of 10 cm of the house, and of a metre around it.
voxelizer = navbake.Voxelizer(navbake.samples.path("house"))
size = np.ptp(voxelizer.shapes.bounds, axis=0) + 2.0
voxels = voxelizer.create(voxelizer.shapes.bounds.mean(axis=0), res=0.1, size=size, align=True)

# The shortest way, and one on which a metre near a wall costs more.
for cost in (0.0, 0.3):
    finder = navbake.VoxelFinder(voxels, RADIUS, max_height=5.5, cost_of_clearance=cost)
    path = finder.find_path(GARDEN, UPSTAIRS)
    nearest = finder.distances.at(path.at(np.arange(0.0, path.length, 0.02)))
    print(f"cost of clearance {cost:g} m: {path.length:.2f} m, {nearest.mean():.2f} m from things")

path.save("flight.json")
with open("flight.png", "wb") as file:
    file.write(draw_flight(voxels, path, "house"))

# Which way is away from what is nearest? As potential fields and trajectory optimizers ask.
field = voxels.distances(signed=True)
print(f"at the start: {field.at(GARDEN):.2f} m, away along {field.gradients_at(GARDEN).round(1)}")

# Too large for the windows: what would get through?
large = navbake.VoxelFinder(voxels, 0.6, max_height=5.5)
start = large.snap(GARDEN)
print(large.why_not(start, large.snap(UPSTAIRS)))
