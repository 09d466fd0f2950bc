"""A user's first script, all in one: `tests/test_public_types.py` checks its types, and runs it."""

import numpy as np

import navbake
from navbake import episodes, scores, tensors

# bake, save, load, and make the grid fit a larger robot
baked = navbake.bake(navbake.samples.path("apartment"), grid={"cell_size": 0.1})
baked.save("apartment.grid.json.gz")
grid = navbake.load("apartment.grid.json.gz").with_doors("open").inflate(0.2, clearance=0.1)
print(grid.scene_id, grid.levels[0].free, [room.name for room in grid.rooms])
for warning in [*baked.warnings, *grid.warnings]:
    print(warning)

# what is in the cell of one position, and in the cells of many
start = (0.5, 0.5, 0.0)
positions = [start, (1.0, 1.5, 0.0)]
place = grid.at(start)
if place is not None:
    print(place.cell.row, place.floor, place.free, place.room, place.weight, place.island)
print(grid.values_at("floor", positions), grid.values_at("free", positions))
print(grid.values_at("room", positions), grid.values_at("clearance", positions))
print(grid.position_of(grid.cells_at(positions)), grid.blockers((-1.0, -3.5)))

# places, paths, and why there is none
finder = navbake.PathFinder(grid)
rng = np.random.default_rng(0)
goal = finder.random_point(rng, room="kitchen")
goals = finder.random_point(rng, 5, outdoors=False)
pose = finder.random_pose(rng)
print(pose.position, pose.heading, finder.room_at(start), finder.room_at(positions))
print(finder.clearance(start), finder.is_navigable(positions), finder.snap(start))
print(finder.distances(positions, goal), finder.distance_field(goal))
path = finder.find_path(start, goal)
if path is None:
    print(finder.why_not(start, goal))
else:
    print(path.length, path.cost, path.seconds, path.rooms, path.doors, path.positions)
    follower = finder.follow(path, speed=0.5)
    command = follower.command(start, heading=0.0)
    print(command.forward, command.turn, command.waypoint, follower.left)
with grid.block(disc=((1.0, 1.5, 0.0), 0.3)):
    print(finder.is_navigable((1.0, 1.5, 0.0)))

# where a robot's base reaches a thing, and where many agents start
poses = finder.stand_poses("object:sofa", reach=(0.3, 0.6), start=start)
print(len(poses), poses.positions, poses.headings, poses.why_not)
spawns = finder.spawn(rng, 3)
print(spawns.positions, spawns.headings)

# episodes, and how well an agent does in one
episode_set = episodes.make_episodes(grid, "point", count=4, seed=1)
episode = episode_set.episodes[0]
measures = scores.Measures(finder, episode)
print(episode.start, episode.goals[0].position, episode.distance, measures.distance)
print(measures.step(episode.start), sorted(measures.scores(stopped=True)))

# a million positions at once
t = grid.tensors(goals=[start])
yaw = np.zeros(5)
pattern = rng.uniform(-1.0, 1.0, (3, 2))
print(t.shape.rows, t.rooms[0], tensors.is_navigable(t, goals), tensors.room(t, goals))
print(tensors.distance_to_goal(t, goals), tensors.heights(t, goals, yaw, pattern))

# pictures, maps and shapes for others
picture = grid.plot(layers=["rooms"], route=path)
print(picture.size, grid.plot("apartment.png").name, grid.to_nav2("map.yaml", radius=0.3))
print(grid.to_mesh().levels, grid.to_polygons()[0].name, grid.to_graph("rooms"))
