"""Measures the run time on house-100 at 0.05 m, a million cells, next to what others take.

Each row is a baseline and a figure of our own, measured in turns in one process after a warm-up,
so that a noisy machine is as noisy for both. Medians are printed, of the wall and of the
processor, and the ratio of the medians. A baseline whose package is missing is left out, with the
reason.

    pip install -e ".[bench]"
    python scripts/bench_run.py [--repeats 15] [--only load inflate] [--grid house-100.grid.json]
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from scipy import sparse
from scipy.sparse import csgraph

import navbake
from make_house import make_house

CELL = 0.05  # [m]
ROOMS = 100
RADIUS = 0.3  # [m]
APARTMENT = Path(__file__).parents[1] / "configs" / "apartment.yaml"


@dataclass(frozen=True)
class Job:
    """Something to be measured.

    Attributes:
        name: what it is.
        run: does it once.
    """

    name: str
    run: Callable[[], Any]


@dataclass(frozen=True)
class Row:
    """A figure and what it is compared with.

    Attributes:
        baselines: what others take, or our own slow way; none where a package is missing.
        job: ours.
        limit: what is asked for, in words.
        missing: which baseline is left out, and why.
    """

    baselines: list[Job]
    job: Job
    limit: str
    missing: str = ""


@dataclass(frozen=True)
class House:
    """The grid that all rows are about, and its file."""

    path: Path
    grid: navbake.SceneGrid2D | navbake.MultiLevelGrid


# --- rows ----------------------------------------------------------------------------------


def load_row(house: House) -> Row:
    content = house.path.read_bytes()
    return Row(
        [Job("orjson.loads of the whole file", lambda: orjson.loads(content))],
        Job("navbake.load, user data unread", lambda: navbake.load(house.path)),
        "at most 60 ms",
    )


def user_data_row(house: House) -> Row:
    content = house.path.read_bytes()
    return Row(
        [Job("orjson.loads of the whole file", lambda: orjson.loads(content))],
        Job("navbake.load and user_data", lambda: navbake.load(house.path).levels[0].user_data),
        "nothing asked",
    )


def inflate_row(house: House) -> Row:
    job = Job(f"grid.inflate({RADIUS})", lambda: house.grid.inflate(RADIUS))
    return _against_distance(house, job, "at most 3 × OpenCV")


def step_costs_row(house: House) -> Row:
    job = Job(f"grid.inflate({RADIUS}, 0.25)", lambda: house.grid.inflate(RADIUS, 0.25))
    return _against_distance(house, job)


def nav2_costs_row(house: House) -> Row:
    name = f"grid.inflate({RADIUS}, costs='nav2')"
    return _against_distance(house, Job(name, lambda: house.grid.inflate(RADIUS, costs="nav2")))


def minos_row(house: House) -> Row:
    name = f"grid.inflate({RADIUS}, mode='minos')"
    return _against_distance(house, Job(name, lambda: house.grid.inflate(RADIUS, mode="minos")))


def footprint_row(house: House) -> Row:
    car = [(0.4, 0.25), (-0.4, 0.25), (-0.4, -0.25), (0.4, -0.25)]
    run = lambda: house.grid.inflate_footprint(car, 16)  # noqa: E731
    return _against_distance(house, Job("grid.inflate_footprint, 16 headings", run))


def navigable_row(house: House) -> Row:
    """One million positions all over the house, at heights below a storey's."""
    finder = navbake.PathFinder(house.grid)
    level = house.grid.levels[0]
    x0, y0, x1, y1 = level.lattice.bounds
    low, high = (x0, y0, level.ground), (x1, y1, level.ground + 0.6)
    positions = np.random.default_rng(0).uniform(low, high, size=(1_000_000, 3))
    if not np.array_equal(plain_navigable(level, positions), finder.are_navigable(positions)):
        raise SystemExit("are_navigable and plain numpy differ")
    return Row(
        [Job("plain numpy, for one level", lambda: plain_navigable(level, positions))],
        Job("a million answers of are_navigable", lambda: finder.are_navigable(positions)),
        "at most 30 ms",
    )


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
    job = Job("8 × find_path", lambda: [finder.find_path(a, b) for a, b in pairs])
    limit = "at most pyastar2d"
    try:
        import pyastar2d
    except ImportError:
        return Row([], job, limit, 'no pyastar2d to compare with: pip install -e ".[bench]"')
    level = house.grid.levels[0]
    weights = level.weights.astype(np.float32)
    ends = [[tuple(int(v) for v in level.lattice.rows_cols(p)) for p in pair] for pair in pairs]

    def search() -> None:
        for start, goal in ends:
            if pyastar2d.astar_path(weights, start, goal, allow_diagonal=True) is None:
                raise SystemExit("pyastar2d finds no path")

    return Row([Job("8 × pyastar2d, diagonals cost 1", search)], job, limit)


def field_row(house: House) -> Row:
    """The whole distance field of one goal, without what is kept of the last."""
    finder = navbake.PathFinder(house.grid)
    goal = finder.random_point(np.random.default_rng(0), island=1)
    cells = finder.search.flat.free.nonzero()[0]
    level = house.grid.levels[0]
    row, col = (int(v) for v in level.lattice.rows_cols(goal))
    source = row * level.width + col
    graph = step_graph(finder)
    own = finder.search.field(np.array([source]))
    if not np.allclose(own[cells], csgraph.dijkstra(graph, indices=source)[cells]):
        raise SystemExit("distance_field and scipy differ")
    baselines = [
        Job("scipy csgraph, its graph made before", lambda: csgraph.dijkstra(graph, indices=source))
    ]
    job = Job("distance field", lambda: finder.search.field(np.array([source])))
    limit = "at most dijkstra3d"
    try:
        import dijkstra3d
    except ImportError:
        missing = 'no dijkstra3d to compare with: pip install -e ".[bench]"'
        return Row(baselines, job, limit, missing)
    costs = np.where(level.free, 1.0, np.inf).astype(np.float32)
    run = lambda: dijkstra3d.distance_field(costs, source=(row, col), connectivity=8)  # noqa: E731
    return Row([Job("dijkstra3d, node costs", run), *baselines], job, limit)


def thousand_row(house: House) -> Row:
    """A thousand smooth paths in the apartment, which has 5 rooms."""
    finder = navbake.PathFinder(navbake.bake(str(APARTMENT)))
    pairs = random_pairs(finder, 1000)
    run = lambda: [finder.find_path(a, b) for a, b in pairs]  # noqa: E731
    return Row([], Job("1,000 × find_path in the apartment", run), "at most 1 s")


def block_row(house: House) -> Row:
    """Something of 0.3 m comes and goes, with paths right after each."""
    finder = navbake.PathFinder(house.grid)
    place = finder.random_point(np.random.default_rng(0), island=1)

    def come_and_go() -> None:
        with house.grid.block(disc=(place, 0.3)):
            finder.search.update()
        finder.search.update()

    return Row(
        [Job("a new PathFinder", lambda: navbake.PathFinder(house.grid))],
        Job("block a disc, and free it", come_and_go),
        "cheaper than a new grid",
    )


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


def _against_distance(house: House, job: Job, limit: str = "nothing asked") -> Row:
    """Compare with OpenCV's precise distance transform of the same occupancy."""
    try:
        import cv2
    except ImportError:
        missing = 'no OpenCV to compare with: pip install -e ".[bench]"'
        return Row([], job, limit, missing)
    free = (house.grid.levels[0].occupancy == 0).astype(np.uint8)

    def transform() -> Any:
        return cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)

    return Row([Job("OpenCV distanceTransform, precise", transform)], job, limit)


ROWS: dict[str, Callable[[House], Row]] = {
    "load": load_row,
    "user_data": user_data_row,
    "inflate": inflate_row,
    "step": step_costs_row,
    "nav2": nav2_costs_row,
    "minos": minos_row,
    "footprint": footprint_row,
    "navigable": navigable_row,
    "path": path_row,
    "field": field_row,
    "thousand": thousand_row,
    "block": block_row,
}


# --- the report ----------------------------------------------------------------------------


def measure(jobs: list[Job], repeats: int) -> list[tuple[float, float]]:
    """Medians of jobs that run in turns: seconds of the wall and of the processor."""
    taken: list[list[tuple[float, float]]] = [[] for _ in jobs]
    for job in jobs:
        job.run()
    for _ in range(repeats):
        for job, times in zip(jobs, taken, strict=True):
            wall, processor = time.perf_counter(), time.process_time()
            job.run()
            times.append((time.perf_counter() - wall, time.process_time() - processor))
    return [
        (statistics.median(t[0] for t in times), statistics.median(t[1] for t in times))
        for times in taken
    ]


def report(name: str, row: Row, repeats: int) -> None:
    print(f"\n{name}  (asked for: {row.limit})")
    if row.missing:
        print(f"  {row.missing}")
    times = measure([*row.baselines, row.job], repeats)
    wall, processor = times[-1]
    for job, (other, busy) in zip(row.baselines, times, strict=False):
        print(f"  {job.name:<36} {other * 1e3:9.2f} ms {busy * 1e3:9.2f} ms of processor")
    ratios = ", ".join(f"{wall / other:.2f} × the baseline" for other, _ in times[:-1])
    print(
        f"  {row.job.name:<36} {wall * 1e3:9.2f} ms {processor * 1e3:9.2f} ms of processor"
        + (f"   {ratios}" if ratios else "")
    )


def make_grid(folder: Path) -> Path:
    """Bake the house, names included, and save it."""
    scene, path = folder / "house.xml", folder / "house.grid.json"
    scene.write_text(make_house(ROOMS), encoding="utf-8")
    navbake.bake({"scene": {"path": str(scene)}, "grid": {"cell_size": CELL}}).save(path)
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure what grids do at run time.")
    parser.add_argument("--repeats", type=int, default=15, help="runs of each job")
    parser.add_argument("--only", nargs="+", choices=list(ROWS), help="rows to measure")
    parser.add_argument("--grid", type=Path, help="a grid of house-100, instead of a new bake")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = arguments.grid or make_grid(Path(folder))
        house = House(path, navbake.load(path))
        num_cells = sum(level.width * level.height for level in house.grid.levels)
        size = path.stat().st_size / 2**20
        print(f"house-{ROOMS} at {CELL} m: {num_cells:,} cells, {size:.1f} MiB, medians")
        for name in arguments.only or ROWS:
            report(name, ROWS[name](house), arguments.repeats)


if __name__ == "__main__":
    main()
