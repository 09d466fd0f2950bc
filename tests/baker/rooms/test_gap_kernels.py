"""The kernels that find and measure gaps, against plain oracles, and spaces that are joined."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from scipy import ndimage

from navbake.baker.rooms import gap_kernels as kernels
from navbake.baker.rooms.gap_limits import (
    DECIDING_CELLS,
    DECIDING_SHARES,
    JAMB_JITTER,
    MAX_LINE_EXTENSION,
    MAX_WALL_DISTANCE,
    WIDENING_FACTOR,
)
from navbake.baker.rooms.gaps import SpaceMerger, find_gaps, mark_lines_along
from navbake.baker.rooms.walls import (
    RAY_HEIGHT,
    CastRays,
    WallRays,
    both_scan_orders,
    find_directions,
    make_direction,
    mark_wall_nodes,
    measure_squared_distances,
    measure_squared_distances_at,
)
from offices import make_plan
from offices_truth import bake_plan, overlaps

CELL = 0.1
ANGLES = (0.0, 7.0, 26.5, 44.0, -12.0, -38.0, 90.0, 61.0, 118.0)


def blobs(rng, rows=38, cols=46, smooth=1.6, most=0.1):
    """A random map; as many cells as that are closed depends on `most`."""
    noise = ndimage.gaussian_filter(rng.normal(size=(rows, cols)), smooth)
    return noise > most * noise.std() - noise.std() / 2


def gap_limits(max_width, only_doorways):
    """Limits of gaps in a floor plan."""
    return kernels.GapLimits(
        max_width=max_width,
        widening_factor=WIDENING_FACTOR,
        min_widening=2.0,
        max_thickness=5,
        marks_only_doorways=only_doorways,
    )


def floor_plan(rng, rows=60, cols=70):
    """Rooms at random: walls with openings, and pillars."""
    is_open = np.ones((rows, cols), dtype=np.bool_)
    is_open[[0, -1]] = is_open[:, [0, -1]] = False
    for _ in range(3):
        row, col = rng.integers(8, rows - 8), rng.integers(8, cols - 8)
        is_open[row : row + 2] = is_open[:, col : col + 2] = False
        for at in rng.integers(2, cols - 20, 3):
            is_open[row : row + 2, at : at + rng.integers(6, 20)] = True
        for at in rng.integers(2, rows - 20, 3):
            is_open[at : at + rng.integers(6, 20), col : col + 2] = True
    for _ in range(4):
        row, col = rng.integers(4, rows - 8), rng.integers(4, cols - 8)
        is_open[row : row + 3, col : col + 3] = False
    return is_open


@numba.njit
def measure_runs(is_open, shift, marked):
    return kernels.measure_runs(is_open, shift, marked)


def line_of(row, col, shift):
    """The cells of the line through a cell, by column."""
    return {c: row + int(shift[c] - shift[col]) for c in range(len(shift))}


@pytest.mark.parametrize("angle", ANGLES)
def test_runs_are_as_long_as_lines_go_on(angle):
    rng = np.random.default_rng(0)
    is_open = blobs(rng)
    shift = make_direction(angle, is_open.shape).shift[: is_open.shape[1]]
    shift = np.concatenate([shift, np.repeat(shift[-1:], max(0, is_open.shape[1] - len(shift)))])
    marks = rng.random(is_open.shape) < 0.02
    marked = marks.copy()
    run = measure_runs(is_open, shift, marked)
    for row, col in np.ndindex(is_open.shape):
        line = line_of(row, col, shift)
        length, has_mark = 0, marks[row, col]
        if is_open[row, col]:
            length = 1
            for way in (-1, 1):
                c = col + way
                while 0 <= c < len(shift) and 0 <= line[c] < len(run) and is_open[line[c], c]:
                    if not (is_open[line[c], c - way] or is_open[line[c - way], c]):
                        break  # between two closed cells that touch at their corners
                    length += 1
                    has_mark |= marks[line[c], c]
                    c += way
        assert run[row, col] == length
        assert not is_open[row, col] or marked[row, col] == has_mark


@pytest.mark.parametrize("only_doorways", [True, False])
def test_gaps_are_beside_longer_runs(only_doorways):
    rng = np.random.default_rng(1)
    limits = gap_limits(14, only_doorways)
    for _ in range(4):
        is_open = np.asfortranarray(floor_plan(rng))
        scanned = is_open, np.zeros(70, dtype=np.int64), np.ones_like(is_open)
        run = measure_runs(*scanned)
        marks = np.zeros_like(is_open, dtype=np.uint8)
        kernels.mark_gaps(*scanned, limits, marks)

        def widens(here, there):
            return there >= max(WIDENING_FACTOR * here, here + limits.min_widening)

        expected = np.zeros_like(marks)
        for row, col in np.ndindex(run.shape):
            lane, here = run[:, col], run[row, col]
            if not 0 < here <= limits.max_width:
                continue
            above = row > 0 and widens(here, lane[row - 1])
            below = row + 1 < len(lane) and widens(here, lane[row + 1])
            if not only_doorways and (above or below):
                expected[row, col] = max(expected[row, col], 1)
            if not above:
                continue
            for other in range(row, min(row + limits.max_thickness, len(lane))):
                there = lane[other]
                least = there + limits.min_widening + JAMB_JITTER
                narrower = max(WIDENING_FACTOR * there, least) < here
                if not 0 < there <= limits.max_width or narrower:
                    break
                if other + 1 < len(lane) and widens(there, lane[other + 1]):
                    for between in range(row, other + 1):
                        runs, _ = ndimage.label(is_open[between])
                        expected[between, runs == runs[col]] = 2
                    break
        np.testing.assert_array_equal(marks, expected)
        assert (marks > 0).any()


@pytest.mark.parametrize("angle", [0.0, 9.0, 33.0, -21.0])
def test_bridges_lead_from_wall_to_wall(angle):
    rng = np.random.default_rng(2)
    marked = 0
    for _ in range(6):
        wall = np.asfortranarray(~blobs(rng, smooth=1.2, most=-0.6))
        low = np.asfortranarray(blobs(rng, smooth=1.0)) & ~wall
        shift = make_direction(angle, low.shape).shift
        bridge = np.zeros_like(low)
        kernels.mark_sills(low, wall, shift, bridge)
        expected = bridges(low, wall, shift)
        np.testing.assert_array_equal(bridge, expected)
        marked += bridge.sum()
    assert marked > 50


def bridges(low, wall, shift):
    """Ways from wall to wall along each line: exact ones, and ones in a band without walls."""
    rows, cols = low.shape
    expected = np.zeros_like(low)
    reach = int(np.abs(shift).max()) + rows
    for base in range(-reach, reach + rows):
        line = base + shift

        def at(mask, side, col, line=line):
            row = line[col] + side
            return 0 <= line[col] < rows and 0 <= row < rows and bool(mask[row, col])

        exact = {(0, col) for col in range(cols) if at(low, 0, col)}
        band = {
            (side, col)
            for col in range(cols)
            if not any(at(wall, side, col) for side in (-1, 0, 1))
            for side in (-1, 0, 1)
            if at(low, side, col)
        }
        for cells, drift in ((exact, 0), (band, 1)):
            held = []
            for way in (-1, 1):
                found = set()
                for col in range(cols) if way < 0 else range(cols - 1, -1, -1):
                    before = col + way
                    for side in (-1, 0, 1):
                        if (side, col) not in cells or not 0 <= before < cols:
                            continue
                        near = [s for s in (-1, 0, 1) if abs(s - side) <= drift]
                        if at(wall, 0, before) or any((s, before) in found for s in near):
                            found.add((side, col))
                held.append(found)
            for side, col in held[0] & held[1]:
                expected[line[col] + side, col] = True
    return expected


def parted(is_open):
    """The gaps of a map, and the spaces between them before any are joined."""
    return find_gaps(is_open, np.zeros_like(is_open), CELL, None)


def turned_plan(seed, angle):
    """A floor plan at an angle to the lattice."""
    is_open = floor_plan(np.random.default_rng(seed))
    return ndimage.rotate(is_open.astype(np.uint8), angle, order=0) > 0


def share_of(scan, gaps, k, side, depth, whole):
    """The share of a line behind a gap, as `measure_gaps` says it, and what spaces it met."""
    sides = whole[gaps.label_above[k]], whole[gaps.label_below[k]]
    own, other = sides if side == 0 else sides[::-1]
    sign = 1 if side == 0 else -1
    rows, cols = scan.label.shape
    width = int(gaps.last_col[k] - gaps.first_col[k]) + 1
    whole_width, met = width, set()
    for is_last in (False, True):
        length = through = width
        starts = (-1, int(gaps.first_col[k])), (1, int(gaps.last_col[k]))
        for end, (way, start) in enumerate(starts):
            top, bottom = int(gaps.top_row[k, end]), int(gaps.bottom_row[k, end])

            def cell(row, col, start=start):
                row = row + int(scan.shift[col] - scan.shift[start]) if 0 <= col < cols else -1
                return (row, col) if 0 <= row < rows else None

            opened = reached = passed = 0
            for step in range(1, cols):
                col, lean = start + way * step, sign * int(scan.leans[depth])
                down = sign * int(scan.depths[depth])
                near = cell((top if side == 0 else bottom) - down, col + lean)
                most = max(whole_width, width + opened) if is_last else cols
                if step > MAX_LINE_EXTENSION * most or not 0 <= col + lean < cols:
                    break
                if near is None or not scan.is_open[near]:
                    before = cell((top if side == 0 else bottom) - down, col + lean - way)
                    if step > 1 or (before and scan.is_open[before]):
                        reached, passed = step - 1, opened
                    break
                here = scan.label[near]
                if here and whole[here] != own:
                    met.add(int(whole[here]))
                    break
                between = [cell(row, col) for row in range(top, bottom + 1)]
                far = cell((bottom if side == 0 else top) + down, col - lean)
                is_through = far and all(at and scan.is_open[at] for at in between)
                if is_through and scan.is_open[far]:
                    if whole[scan.label[far]] in (other, 0):
                        opened += 1
                    else:
                        met.add(int(whole[scan.label[far]]))
                if here:
                    reached, passed = step, opened
                if not is_last and opened < step:
                    break
            length, through = length + reached, through + passed
            whole_width += 0 if is_last else opened
    return through / length, met


@pytest.mark.parametrize("angle", [0, 24, 45])
def test_the_share_that_a_gap_has(angle):
    rng = np.random.default_rng(3)
    measured = 0
    for seed in range(3):
        spaces = parted(turned_plan(seed, angle))
        count = len(spaces.num_cells)
        whole = np.arange(count, dtype=np.int32)
        for _ in range(count // 3):
            one, other = whole[rng.integers(1, count, 2)]
            whole[whole == max(one, other)] = min(one, other)
        for _, scan, gaps in spaces.direction_gaps:
            chosen = np.arange(len(gaps.first_col))
            walls = kernels.GapWalls(
                end_distance=np.full((len(chosen), 2), 0.5),
                max_distance=np.full(len(chosen), MAX_WALL_DISTANCE),
                rays_of_cell=np.zeros(scan.label.size, dtype=np.int32),
                coded_distance=np.full((1, 2), 1.5),
            )
            lines, shares, waits, met = kernels.measure_gaps(scan, gaps, chosen, whole, walls)
            assert not waits.any()
            unknown = walls._replace(coded_distance=np.zeros((1, 2)))
            waits = kernels.measure_gaps(scan, gaps, chosen, whole, unknown)[2]
            ends_at_wall = (lines.wall_cell >= 0).any(axis=(1, 2, 3))
            has_openings = (lines.opening_cell >= 0).any(axis=(1, 2, 3))
            off = np.abs(shares[..., None] - DECIDING_SHARES).min(axis=2)
            off_cells = off * lines.length.min(axis=2)
            is_apart = whole[gaps.label_above] != whole[gaps.label_below]
            needs_walls = (off_cells <= DECIDING_CELLS).any(axis=1)
            assert (waits == (needs_walls & ends_at_wall | has_openings))[is_apart].all()
            for k in chosen:
                listed = {space for gap, space in met if gap == k}
                if whole[gaps.label_above[k]] == whole[gaps.label_below[k]]:
                    assert shares[k].tolist() == [1, 1] and not listed
                    continue
                lines = [
                    [share_of(scan, gaps, k, side, d, whole) for d in range(len(scan.depths))]
                    for side in (0, 1)
                ]
                expected = [min(1.0, *(share for share, _ in side)) for side in lines]
                np.testing.assert_allclose(shares[k], expected)
                assert listed == set().union(*(m for side in lines for _, m in side))
                measured += 1
    assert measured > 30


class Remeasured(SpaceMerger):
    """Measures all gaps again whenever two spaces are joined."""

    def join(self, gap):
        before = self._shares.copy()
        super().join(gap)
        apart = list(filter(self.separates, range(len(before))))
        self.measure(np.array(apart, dtype=np.int64))
        return [k for k in apart if (before[k] != self._shares[k]).any()]


@pytest.mark.parametrize("angle", [0, 24, 45])
def test_spaces_are_joined_as_if_all_gaps_were_measured_after_each(angle):
    joined = 0
    for seed in range(5):
        spaces = parted(turned_plan(seed, angle))
        fast = SpaceMerger(spaces, CELL, None)
        slow = Remeasured(spaces, CELL, None)
        for merger in (fast, slow):
            merger.join_spaces()
        np.testing.assert_array_equal(fast.space_of_label, slow.space_of_label)
        assert fast.list_close_calls() == slow.list_close_calls()
        joined += len(spaces.num_cells) - len(np.unique(fast.space_of_label))
    assert joined > 25


def test_what_is_far_from_a_change_is_not_measured_again():
    """A hall with many niches: each is joined to it, and hardly any gap is measured twice."""
    counts = []
    for niches in (20, 80):
        is_open = np.zeros((80, 17 * niches + 4), dtype=np.bool_)
        is_open[2:52, 2:-2] = True
        for k in range(niches):
            is_open[52:62, 2 + 17 * k : 17 + 17 * k] = True
        measured = 0

        class Counted(SpaceMerger):
            def measure(self, gaps):
                nonlocal measured
                measured += len(gaps)
                super().measure(gaps)

        merger = Counted(parted(is_open), CELL, None)
        merger.join_spaces()
        assert len(np.unique(merger.space_of_label)) == 2  # the hall, and 0 for none
        counts.append(measured)
    assert counts[1] <= 5 * counts[0]


@pytest.mark.parametrize("reach", [0, 1, 7, 40])
@pytest.mark.parametrize("shape", [(1, 1), (3, 300), (70, 41)])
def test_distances_are_those_of_scipy(reach, shape):
    rng = np.random.default_rng(reach)
    for share in (0.0, 0.001, 0.02, 0.5):
        target = rng.random(shape) < share
        expected = np.full(shape, (reach + 1) ** 2)
        if target.any():
            exact = np.rint(ndimage.distance_transform_edt(~target) ** 2)
            expected = np.minimum(exact, expected)
        np.testing.assert_array_equal(measure_squared_distances(target, reach), expected)


@pytest.mark.parametrize("reach", [0, 1, 8, 21])
def test_distances_at_some_nodes(reach):
    rng = np.random.default_rng(reach)
    for shape in ((1, 1), (3, 50), (31, 20)):
        is_open = rng.random(shape) < 0.99
        every = measure_squared_distances(mark_wall_nodes(is_open), reach)
        nodes = rng.integers(0, every.shape, (200, 2)).T
        distances = measure_squared_distances_at(is_open, reach, *nodes)
        np.testing.assert_array_equal(distances, every[tuple(nodes)])


@pytest.mark.parametrize("only_doorways", [True, False])
@pytest.mark.parametrize("angle", [7.0, 30.0, 45.0, 62.0, 100.0, 140.0])
def test_gaps_near_a_wall_are_those_that_the_whole_lattice_shows(angle, only_doorways):
    rng = np.random.default_rng(2)
    limits = gap_limits(10, only_doorways)
    shape = (150, 170)
    window = np.s_[70:84, 90:108]
    is_near_wall = np.zeros(shape, dtype=np.bool_)
    is_near_wall[window] = rng.random(is_near_wall[window].shape) < 0.5
    direction = make_direction(angle, shape)
    for share in (0.9, 0.95, 0.97):
        is_open = rng.random(shape) < share
        scanned_is_open = both_scan_orders(is_open)[direction.is_swapped]
        marks = np.zeros_like(scanned_is_open, dtype=np.uint8)
        expected = marks.copy(order="F")
        scanned_window, is_marked = mark_lines_along(
            direction._replace(window=window, is_near_wall=is_near_wall[window]),
            scanned_is_open,
            limits,
            marks,
        )
        assert is_marked.size < is_open.size
        _, is_expected = mark_lines_along(
            direction._replace(is_near_wall=is_near_wall), scanned_is_open, limits, expected
        )
        np.testing.assert_array_equal(marks, expected)
        np.testing.assert_array_equal(is_marked, is_expected[scanned_window])
        assert is_marked.any() and is_marked.sum() == is_expected.sum()


@pytest.mark.parametrize("turn", [0.0, 7.4, 26.0, 39.15, 50.67, 71.0])
def test_directions_are_those_of_the_walls(turn):
    """In a hall with a partition, to half a degree."""
    x, y = np.meshgrid(np.arange(-75, 75) * CELL, np.arange(-75, 75) * CELL)
    angle = np.deg2rad(turn)
    u, v = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    is_open = (np.abs(u) < 5.0) & (np.abs(v) < 3.5) & ((np.abs(u - 1) > 0.1) | (v > 1.5))
    found = []
    for direction in find_directions(is_open, CELL):
        slope = np.rad2deg(np.arctan(direction.slope))
        found.append((90 - slope if direction.is_swapped else slope) % 180)
    assert sorted(found) == pytest.approx(sorted([turn, turn + 90]), abs=0.5)


def test_rooms_at_any_angle_are_those_along_the_lattice(tmp_path):
    """A plan that came apart in single cells between the lines of its gaps."""
    plan = make_plan(5041)
    stages = bake_plan(plan, tmp_path, as_mesh=False)
    assert min(overlaps(stages.rooms.index[0], plan.truth(stages.lattice))) > 0.85


@pytest.mark.parametrize("is_cut", [False, True])
@pytest.mark.parametrize("as_mesh", [False, True])
def test_rays_to_walls(as_mesh, is_cut, tmp_path):
    """Level rays from cells meet the faces of a turned plan's boxes where plain ones do.

    Also walls outside of the lattice, where it is cut to a part of the cells.
    """
    plan = make_plan(1001)
    plan.turn = 0.4
    flags = bake_plan(plan, tmp_path, as_mesh=as_mesh).room_flags
    lattice, is_open, floor = flags.lattice, flags.levels[0].is_open, flags.levels[0].floor
    if is_cut:
        part = tuple(slice(count // 4, count // 2) for count in lattice.shape)
        lattice, is_open, floor = lattice.cut(*part), is_open[part], floor[part]
    rays = WallRays(flags.wall_shapes, lattice, floor)
    rng = np.random.default_rng(1)
    row, col = rng.permutation(np.argwhere(is_open))[:400].T
    upright = [box for box in plan.boxes if abs(box[1][2] - RAY_HEIGHT) < box[2][2]]
    if not as_mesh:  # furniture and pillars are no walls
        upright = [box for box in upright if box[0].startswith("wall")]
    met = 0
    for angle in (0.0, np.rad2deg(-plan.turn), 60.0):
        direction = make_direction(angle, lattice.shape)
        step = np.array([1.0, -direction.slope])
        step = (-step[::-1] if direction.is_swapped else step) * lattice.cell_size
        across = np.array([-step[1], step[0]]) / np.hypot(*step) * lattice.cell_size
        for is_after in (False, True):
            cells = (
                col * lattice.height + row if direction.is_swapped else row * lattice.width + col
            )
            sides = np.full((len(row), 2), -1)
            sides[:, int(is_after)] = cells
            cast_rays = rays.measure(direction, sides)
            pairs = cast_rays.rays_of_cell[cells]
            assert (pairs > 0).all()
            assert not cast_rays.is_unmeasured(cells, np.full(len(cells), int(is_after))).any()
            found = cast_rays.coded_distance[pairs, int(is_after)] - 1.0
            found = np.where(found <= MAX_WALL_DISTANCE, found, 0.5)
            way = step if is_after else -step
            here = lattice.positions(row, col)
            nearest = np.full(len(row), np.inf)
            for box in upright:
                for part in (-0.5, 0.0, 0.5):
                    nearest = np.minimum(nearest, first_hits(plan, box, here + part * across, way))
            expected = np.where(nearest <= MAX_WALL_DISTANCE, nearest, 0.5)
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-4)
            met += (nearest <= MAX_WALL_DISTANCE).sum()
    assert met > 100


def test_measured_distances_are_those_of_a_table_of_all_cells():
    """Rays are added in many small batches, some to a cell that has the other ray already."""
    rng = np.random.default_rng(7)
    cast_rays = CastRays(500)
    table = np.zeros((500, 2))
    for _ in range(60):
        cells = rng.integers(0, 500, 9)
        ray_ends = rng.integers(0, 2, 9)
        is_unmeasured = cast_rays.is_unmeasured(cells, ray_ends)
        assert (is_unmeasured == (table[cells, ray_ends] == 0.0)).all()
        distance = np.where(cells % 5 == 0, np.inf, 1.0 + cells + ray_ends)
        cast_rays.add(cells, ray_ends, distance)
        table[cells, ray_ends] = distance
        assert (cast_rays.coded_distance[cast_rays.rays_of_cell] == table).all()
    num_pairs = np.count_nonzero(table.any(axis=1)) + 1
    assert cast_rays.rays_of_cell.max() == num_pairs - 1
    assert len(cast_rays.coded_distance) <= 2 * num_pairs


def first_hits(plan, box, points, way):
    """How many ways from each point, seen from above, a box's outline is; inf where none is."""
    _, center, half, turn = box
    turn += plan.turn
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    offset, along = (points - plan.to_world(center[:2])) @ axes.T, axes @ way
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.sort([(side * half[:2] - offset) / along for side in (-1, 1)], axis=0)
    enter, leave = ends[0].max(axis=1), ends[1].min(axis=1)
    hit = np.where(enter >= 0.0, enter, leave)
    return np.where((enter <= leave) & (leave >= 0.0), hit, np.inf)
