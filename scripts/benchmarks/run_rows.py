"""Rows of the run time and of tensors, on a grid of the main house, next to what others take."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import mujoco
import numpy as np
import orjson
from scipy import sparse
from scipy.sparse import csgraph

import navbake
from benchmarks.measure import Job, Row, Sample, beside, here
from benchmarks.scenes import APARTMENT, CELL, Scenes
from navbake.episodes import make_episodes
from navbake.formats.convert import encode_as

RADIUS = 0.3  # [m]
MILLION = 1_000_000
AGENTS, POINTS = 4096, 187  # a batch of environments, and the height scan that walkers use
EPISODES, COMPARED = 10_000, 2_000  # of a set, and of these with scipy's distances
CAST = 32  # agents whose rays are cast; all others are taken to cost as much
SCALAR = {"is_navigable": 0.55, "snap": 1.1, "clearance": 1.5, "try_step": 2.4, "find_path": 20.0}
"""What one answer may take, in look-ups of one place by numpy."""
SEARCHED = 50  # goals to which scipy searches; all others are taken to cost as much
ROUTES_RATIO = 45.0
BUILDING_RATIO = 60.0
"""What graphs of routes may take, in searches by scipy from one cell to all others."""
SEE_ABOVE = 0.6  # metres above an agent at which the rays begin


class House(NamedTuple):
    """The grid that all rows are about, and its file."""

    path: Path
    grid: navbake.SceneGrid2D | navbake.MultiLevelGrid


def make_rows(scenes: Scenes) -> dict[str, Callable[[], Row]]:
    """The rows by name, each made when it is asked for."""
    inflate = {
        "inflate": (f"inflate({RADIUS})", {}, 3.0),
        "step": (f"inflate({RADIUS}, 0.25)", {"clearance": 0.25}, None),
        "nav2": (f"inflate({RADIUS}, costs='nav2')", {"costs": "nav2"}, 2.0),
        "minos": (f"inflate({RADIUS}, mode='minos')", {"mode": "minos"}, None),
    }
    rows: dict[str, Callable[[House], Row]] = {
        "load": load_row,
        "user_data": user_data_row,
        **{name: partial(inflate_row, given=given) for name, given in inflate.items()},
        "footprint": footprint_row,
        "navigable": navigable_row,
        "path": path_row,
        "field": field_row,
        "thousand": thousand_row,
        **{f"scalar-{name}": partial(scalar_row, name=name) for name in SCALAR},
        "block": block_row,
        "spawn": spawn_row,
        "max_radius": max_radius_row,
        "routes": routes_row,
        "building": building_row,
        "episodes": partial(episodes_row, sampler="uniform", ratio=0.45),
        "episodes-habitat": partial(episodes_row, sampler="habitat", ratio=0.55),
        "tensors": tensors_row,
        "tensor-heights": lambda house: heights_row(house, scenes.main),
    }
    return {
        name: lambda make=make: make(house_of(scenes))  # type: ignore[misc]
        for name, make in rows.items()
    }


@cache
def house_of(scenes: Scenes) -> House:
    """The grid of the main house; baked once."""
    path = scenes.folder / "main.grid.json"
    if not path.exists():
        settings = {"scene": {"path": str(scenes.main)}, "grid": {"cell_size": CELL}}
        navbake.bake(settings).save(path)
    return House(path, navbake.load(path))


def load_row(house: House) -> Row:
    """Loading a grid, next to its parsers alone: they skip the user data of its cells."""
    content = house.path.read_bytes()

    def parse() -> None:
        fields = msgspec.json.decode(house.path.read_bytes(), type=dict[str, msgspec.Raw])
        for name, text in fields.items():
            if name != "userData":
                orjson.loads(memoryview(text))

    return Row(
        here("navbake.load, user data unread", lambda: navbake.load(house.path)),
        [
            here("msgspec and orjson, user data unread", parse),
            here("orjson.loads of the whole file", lambda: orjson.loads(content)),
        ],
        ratio=3.0,
    )


def user_data_row(house: House) -> Row:
    content = house.path.read_bytes()
    return Row(
        here("navbake.load and user_data", lambda: navbake.load(house.path).levels[0].user_data),
        [here("orjson.loads of the whole file", lambda: orjson.loads(content))],
        ratio=0.05,
    )


def inflate_row(house: House, given: tuple[str, dict[str, Any], float | None]) -> Row:
    name, options, ratio = given
    job = here(name, lambda: house.grid.inflate(RADIUS, **options))
    return _against_distance(house, job, ratio)


def footprint_row(house: House) -> Row:
    car = [(0.4, 0.25), (-0.4, 0.25), (-0.4, -0.25), (0.4, -0.25)]
    job = here("inflate_footprint, 16 headings", lambda: house.grid.inflate_footprint(car, 16))
    return _against_distance(house, job)


def navigable_row(house: House) -> Row:
    """One million positions all over the house, at heights below a storey's."""
    finder, level = navbake.PathFinder(house.grid), house.grid.levels[0]
    positions = random_positions(level)
    if not np.array_equal(plain_navigable(level, positions), finder.is_navigable(positions)):
        raise SystemExit("is_navigable and plain numpy differ")
    return Row(
        here("a million answers of is_navigable", lambda: finder.is_navigable(positions)),
        [here("plain numpy, for one level", lambda: plain_navigable(level, positions))],
        ratio=0.8,
    )


def random_positions(level: navbake.SceneGrid2D) -> np.ndarray:
    x0, y0, x1, y1 = level.lattice.bounds
    low, high = (x0, y0, level.ground), (x1, y1, level.ground + 0.6)
    return np.random.default_rng(0).uniform(low, high, size=(MILLION, 3))


def plain_navigable(level: navbake.SceneGrid2D, positions: np.ndarray) -> np.ndarray:
    """The same answers by numpy alone: a cell that is free, and at most 0.5 m below."""
    rows, cols = level.lattice.rows_cols(positions)
    inside = (rows >= 0) & (rows < level.height) & (cols >= 0) & (cols < level.width)
    rows, cols = np.where(inside, rows, 0), np.where(inside, cols, 0)
    rise = positions[:, 2] - level.floor_height[rows, cols]
    return inside & level.free[rows, cols] & (rise <= 0.5) & (rise >= -0.25)


def path_row(house: House) -> Row:
    """Eight paths between random places, smooth ones."""
    finder = navbake.PathFinder(house.grid)
    pairs = random_pairs(finder, 8)
    job = here("8 × find_path", lambda: [finder.find_path(a, b) for a, b in pairs])
    level = house.grid.levels[0]
    weights = level.weights.astype(np.float32)
    ends = [[tuple(int(v) for v in level.lattice.rows_cols(p)) for p in pair] for pair in pairs]

    def peer(pyastar2d: Any) -> Job:
        def search() -> None:
            for start, goal in ends:
                if pyastar2d.astar_path(weights, start, goal, allow_diagonal=True) is None:
                    raise SystemExit("pyastar2d finds no path")

        return here("8 × pyastar2d, diagonals cost 1", search)

    return beside(job, "pyastar2d", peer, ratio=1.0)


def field_row(house: House) -> Row:
    """The whole distance field of one goal, without what is kept of the last."""
    finder = navbake.PathFinder(house.grid)
    goal = finder.random_point(np.random.default_rng(0), island=1)
    cells = finder.search.flat.free.nonzero()[0]
    level = house.grid.levels[0]
    row, col = (int(v) for v in level.lattice.rows_cols(goal))
    source = row * level.width + col
    graph = step_graph(finder)
    own = finder.search.compute_cost_field(np.array([source]))
    if not np.allclose(own[cells], csgraph.dijkstra(graph, indices=source)[cells]):
        raise SystemExit("distance_field and scipy differ")
    job = here("distance field", lambda: finder.search.compute_cost_field(np.array([source])))
    other = here("scipy csgraph, its graph given", lambda: csgraph.dijkstra(graph, indices=source))
    costs = np.where(level.free, 1.0, np.inf).astype(np.float32)

    def peer(dijkstra3d: Any) -> Job:
        search = partial(dijkstra3d.distance_field, costs, source=(row, col), connectivity=8)
        return here("dijkstra3d, node costs", search)

    return beside(job, "dijkstra3d", peer, other, ratio=1.0)


def thousand_row(house: House) -> Row:
    """A thousand smooth paths in the apartment, which has 5 rooms."""
    finder = navbake.PathFinder(navbake.bake(str(APARTMENT)))
    pairs = random_pairs(finder, 1000)
    job = here("1,000 × find_path, apartment", lambda: [finder.find_path(*p) for p in pairs])
    level = finder.grid.levels[0]
    rows, cols = level.lattice.rows_cols(np.array([goal for _, goal in pairs]))
    peer = search_job(step_graph(finder), rows * level.width + cols)
    return Row(job, [peer], ratio=0.65)


def scalar_row(house: House, name: str) -> Row:
    """A thousand answers in the apartment, one a call; some places to snap are in something.

    They are held against as many look-ups of the place's cell by numpy.
    """
    finder, rng = navbake.PathFinder(navbake.bake(str(APARTMENT))), np.random.default_rng(0)
    starts = finder.random_point(rng, 1000, island=1)
    ends = starts[::-1] if name == "find_path" else starts + np.array([0.3, 0.1, 0.0])
    asked = [(p,) for p in (ends if name == "snap" else starts)]
    if name in ("try_step", "find_path"):
        asked = list(zip(starts, ends, strict=True))
    ask = getattr(finder, name)
    job = here(f"1,000 × {name}, apartment", lambda: [ask(*given) for given in asked])
    level = finder.grid.levels[0]
    look_up = here(
        "1,000 × plain numpy, is it navigable",
        lambda: [plain_navigable(level, place[None]) for place in starts],
    )
    return Row(job, [look_up], ratio=SCALAR[name])


def block_row(house: House) -> Row:
    """Something of 0.3 m comes and goes, with paths right after each."""
    finder = navbake.PathFinder(house.grid)
    place = finder.random_point(np.random.default_rng(0), island=1)

    def come_and_go() -> None:
        with house.grid.block(disc=(place, 0.3)):
            finder.search.update()
        finder.search.update()

    return Row(
        here("block a disc, and free it", come_and_go),
        [here("a new PathFinder", lambda: navbake.PathFinder(house.grid))],
        ratio=1.0,
    )


def spawn_row(house: House) -> Row:
    """A hundred agents, 0.5 m apart, all over the house."""
    finder, rng = navbake.PathFinder(house.grid), np.random.default_rng(0)

    def throw_darts() -> np.ndarray:
        places = np.empty((0, 3))
        while len(places) < 100:
            place = finder.random_point(rng)
            if not len(places) or np.hypot(*(places - place)[:, :2].T).min() >= 0.5:
                places = np.vstack([places, place])
        return places

    job = here("spawn, 100 agents 0.5 m apart", lambda: finder.spawn(rng, 100, min_distance=0.5))
    return Row(job, [here("random_point until it is far from all", throw_darts)])


def max_radius_row(house: House) -> Row:
    """The widest agent between two rooms far from each other, and where it only just fits."""
    finder = navbake.PathFinder(house.grid)
    (start, goal), *_ = random_pairs(finder, 1)

    def passes(radius: float) -> bool:
        larger = navbake.PathFinder(house.grid.inflate(radius))
        return larger.same_island(start, goal)

    def bisect() -> float:
        low, high = 0.0, 2.0
        while high - low > 1e-3:
            middle = (low + high) / 2
            low, high = (middle, high) if passes(middle) else (low, middle)
        return low

    found = finder.max_radius(start, goal)
    if found is None or abs(found.radius - bisect()) > 2e-3:
        raise SystemExit("max_radius and bisection differ")
    job = here("max_radius, exact", lambda: finder.max_radius(start, goal))
    return Row(job, [here("bisection over inflate, to 1 mm", bisect)], ratio=1.0)


def routes_row(house: House) -> Row:
    """The graph of routes of about half a million free cells."""
    job = here("make_routes, half a million free cells", house.grid.routes)
    return Row(job, [search_all_job(house)], ratio=ROUTES_RATIO)


def building_row(house: House) -> Row:
    """The same grid as a building of Open-RMF, with its routes."""
    encode = partial(encode_as, house.grid, "house.building.yaml")
    job = here("building of half a million free cells", encode)
    return Row(job, [search_all_job(house)], ratio=BUILDING_RATIO)


def search_all_job(house: House) -> Job:
    """The costs from one cell of the largest island to all others by scipy."""
    graph = house.grid.to_graph()
    place = navbake.PathFinder(house.grid).random_point(np.random.default_rng(0), island=1)
    search = partial(csgraph.dijkstra, graph.matrix, indices=graph.node_at(place))
    return here("scipy csgraph from one cell, its graph given", search)


def search_job(matrix: Any, sources: np.ndarray) -> Job:
    """The costs from many cells to all others by scipy, extrapolated from some of the cells."""
    few = sources[:: max(1, len(sources) // SEARCHED)]

    def measure() -> Sample:
        begin = time.perf_counter()
        for source in few:
            csgraph.dijkstra(matrix, indices=source)
        seconds = time.perf_counter() - begin
        return Sample(seconds * len(sources) / len(few), None, {"from searches": len(few)})

    return Job("scipy csgraph, its graph given, extrapolated", measure)


def episodes_row(house: House, sampler: str, ratio: float) -> Row:
    """Ten thousand point episodes, and some of their distances by scipy."""
    content = make_episodes(house.grid, "point", sampler, count=EPISODES)
    if len(content) < EPISODES:
        raise SystemExit(f"only {len(content)} episodes")
    graph = house.grid.to_graph()
    few = content.episodes[:: EPISODES // COMPARED]
    goals = {e.goals[0].position: graph.node_at(e.goals[0].position) for e in few}
    costs = dict(zip(goals, csgraph.dijkstra(graph.matrix, indices=[*goals.values()]), strict=True))
    theirs = [costs[e.goals[0].position][graph.node_at(e.start)] for e in few]
    if not np.allclose(theirs, [e.distance for e in few], rtol=1e-6, atol=0.0):
        raise SystemExit("episodes' distances and scipy differ")
    draw = partial(make_episodes, house.grid, "point", sampler, count=EPISODES)
    job = here(f"{EPISODES:,} episodes, {sampler}", draw)
    every_goal = {graph.node_at(e.goals[0].position) for e in content.episodes}
    return Row(job, [search_job(graph.matrix, np.array([*every_goal]))], ratio=ratio)


def random_pairs(finder: navbake.PathFinder, count: int) -> list[np.ndarray]:
    """Pairs of places that a path joins, on the largest island."""
    points = finder.random_point(np.random.default_rng(0), 2 * count, island=1)
    return list(points.reshape(count, 2, 3))


def step_graph(finder: navbake.PathFinder) -> Any:
    """All steps of a grid of one level as scipy wants them: lengths times weights."""
    flat, moves = finder.search.flat, finder.search.graph.moves
    width, size = int(flat.layout.width[0]), float(flat.layout.cell_size[0])
    steps = [1, -width, -1, width, 1 - width, -1 - width, width - 1, width + 1]
    sources = [np.flatnonzero(moves >> way & 1) for way in range(8)]
    targets = [source + step for source, step in zip(sources, steps, strict=True)]
    lengths = np.repeat([size] * 4 + [size * 2**0.5] * 4, [len(source) for source in sources])
    source, target = np.concatenate(sources), np.concatenate(targets)
    shape = (flat.num_cells, flat.num_cells)
    return sparse.csr_array((lengths * flat.weight[target], (source, target)), shape=shape)


def _against_distance(house: House, job: Job, ratio: float | None = None) -> Row:
    """Compare with OpenCV's precise distance transform of the same occupancy."""
    free = (house.grid.levels[0].occupancy == 0).astype(np.uint8)

    def peer(cv2: Any) -> Job:
        transform = partial(cv2.distanceTransform, free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        return here("OpenCV distanceTransform, precise", transform)

    return beside(job, "cv2", peer, ratio=ratio)


# --- tensors: numpy, and PyTorch and JAX where they are installed ----------------------------


def tensors_row(house: House) -> Row:
    """A million `is_navigable`, as arrays of each library that is installed."""
    exact = random_positions(house.grid.levels[0])
    finder = navbake.PathFinder(house.grid)
    peer = here("PathFinder.is_navigable", lambda: finder.is_navigable(exact))
    ask, given = navbake.tensors.is_navigable, [exact.astype(np.float32)]
    return _of_libraries(house, "a million is_navigable", ask, given, [peer], ratio=2.7)


def heights_row(house: House, scene: Path) -> Row:
    """Height scans of many agents at once, and MuJoCo's rays for the same points."""
    finder, rng = navbake.PathFinder(house.grid), np.random.default_rng(0)
    agents = finder.random_point(rng, AGENTS).astype(np.float32)
    yaw = rng.uniform(-np.pi, np.pi, AGENTS).astype(np.float32)
    ahead, left = np.meshgrid(np.linspace(-0.8, 0.8, 17), np.linspace(-0.5, 0.5, 11))
    pattern = np.stack([ahead.ravel(), left.ravel()], axis=1).astype(np.float32)
    assert len(pattern) == POINTS
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    few = slice(0, AGENTS, AGENTS // CAST)
    cos, sin = np.cos(yaw[few])[:, None], np.sin(yaw[few])[:, None]
    x = agents[few, :1] + cos * pattern[:, 0] - sin * pattern[:, 1]
    y = agents[few, 1:2] + sin * pattern[:, 0] + cos * pattern[:, 1]
    z = np.broadcast_to(agents[few, 2:] + SEE_ABOVE, x.shape)
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float64)
    rays = Job("mj_multiRay, a ray a point, extrapolated", lambda: cast_all(model, data, points))
    level = house.grid.levels[0]
    look_up = here("plain numpy, for one level", lambda: plain_heights(level, agents, yaw, pattern))
    ask, given = navbake.tensors.heights, [agents, yaw, pattern]
    what = f"{AGENTS:,} × {POINTS} heights"
    return _of_libraries(house, what, ask, given, [look_up, rays], ratio=1.8)


def plain_heights(
    level: navbake.SceneGrid2D, agents: np.ndarray, yaw: np.ndarray, pattern: np.ndarray
) -> np.ndarray:
    """The floors under a pattern of points round each agent, by numpy alone; edges are repeated."""
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x = agents[:, :1] + cos * pattern[:, 0] - sin * pattern[:, 1]
    y = agents[:, 1:2] + sin * pattern[:, 0] + cos * pattern[:, 1]
    rows, cols = level.lattice.rows_cols(np.stack([x, y], axis=-1))
    rows, cols = rows.clip(0, level.height - 1), cols.clip(0, level.width - 1)
    return level.floor_height[rows, cols]


def cast_all(model: Any, data: Any, points: np.ndarray) -> Sample:
    """Find the height under each point by MuJoCo, whose rays of one call share their origin."""
    down = np.array([0.0, 0.0, -1.0])
    geom, distance, normal = np.zeros(1, np.int32), np.zeros(1), np.zeros(3)
    heights = np.empty(len(points))
    begin = time.perf_counter()
    for number, point in enumerate(points):
        mujoco.mj_multiRay(
            model, data, point, down, None, 1, -1, geom, distance, normal, 1, mujoco.mjMAXVAL
        )
        heights[number] = point[2] - distance[0]
    seconds = time.perf_counter() - begin
    return Sample(seconds * AGENTS / CAST, None, {"from agents": CAST})


def _of_libraries(
    house: House,
    what: str,
    ask: Callable[..., Any],
    given: list[Any],
    peers: list[Job],
    ratio: float,
) -> Row:
    """A question to the tensors of each library; numpy's is ours."""
    jobs = []
    for name in ("numpy", "torch", "jax.numpy"):
        try:
            xp = importlib.import_module(name)
        except ImportError:
            continue
        question = partial(ask, house.grid.tensors(xp, dtype="float32"))
        if name == "jax.numpy":
            question = importlib.import_module("jax").jit(question)
        values = [xp.asarray(value) for value in given]
        # np.asarray waits for the answer where a library computes behind one's back
        run = lambda question=question, values=values: np.asarray(question(*values))  # noqa: E731
        jobs.append(here(f"{name}: {what}", run))
    missing = "" if len(jobs) == 3 else "torch or jax is not installed: pip install torch jax"
    return Row(jobs[0], [*peers, *jobs[1:]], ratio=ratio, missing=missing)
