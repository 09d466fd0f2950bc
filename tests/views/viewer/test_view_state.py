"""What is shown follows from what is chosen, without a browser."""

from dataclasses import replace
from itertools import combinations

import msgspec
import numpy as np
import pytest

import navbake
from navbake.episodes.goals import find_goal_cells
from navbake.episodes.sampler import make_episodes
from navbake.errors import QueryError
from navbake.navgrid.colors import FREE_TINT, rgb_of
from navbake.scores import Trajectory, score_set
from navbake.views.layers import DISAGREEMENTS, Panel
from navbake.views.viewer import controls as texts
from navbake.views.viewer.meshes import Pick
from navbake.views.viewer.view import make_view_state
from navbake.views.viewer.view_state import (
    INSPECT_TEXT,
    NAME_HEIGHT,
    REACH_TEXT,
    ROUTE_TEXT,
    EpisodeRun,
    ViewState,
    first_choices,
    list_runs,
    select_triangles,
    transfer_choices,
)
from project_paths import GOLDEN
from viewer_scenes import ROOM, room_view_state


@pytest.fixture(scope="module")
def room():
    return room_view_state()


@pytest.fixture(scope="module")
def chosen(room):
    return first_choices(room.grid)


def at(view_state, x, y, level=0, geom=None):
    cell = view_state.grid.cell_at((x, y), level)
    return Pick(cell, (x, y, 0.0), geom)


def test_the_radius_frees_what_inflate_frees(room, chosen):
    for radius in (0.0, 0.2, 0.35):
        now = replace(chosen, inflation=(radius, 0.1))
        expected = room.grid.inflate(radius, 0.1)
        free, _, area = counts = room.count(now)
        assert free == np.count_nonzero(expected.free)
        assert area == pytest.approx(free * 0.01)
        assert f"{free:,} free cells" in texts.describe_free_space(counts, room.count(chosen))
        np.testing.assert_array_equal(room.shown_grid(now).weights, expected.weights)


def test_a_path_follows_two_clicks(room, chosen):
    now = replace(chosen, click=ROUTE_TEXT)
    assert texts.describe_route(now, room.route(now)) == texts.HINT_START
    now = now.with_click(at(room, -1.5, -1.0))
    assert texts.describe_route(now, room.route(now)) == texts.HINT_GOAL
    now = now.with_click(at(room, 1.5, -1.0))
    route = room.route(now)
    expected = navbake.PathFinder(room.grid).find_path((-1.5, -1.0), (1.5, -1.0))
    np.testing.assert_array_equal(route.positions, expected.positions)
    assert f"{expected.length:.2f}".replace(".", "\\.") in texts.describe_route(now, route)
    # too wide for the opening: the reason is the finder's
    wide = replace(now, inflation=(0.9, 0.0))
    assert isinstance(room.route(wide), str)
    assert "No path" in texts.describe_route(wide, room.route(wide))
    # the third click begins again
    again = now.with_click(at(room, 0.5, 1.3))
    assert again.goal is None and again.start.position[0] == 0.5


def test_a_click_a_little_inside_a_wall_counts_as_beside_it(room, chosen):
    """The wall has its face at x = 0.05."""
    now = replace(chosen, click=ROUTE_TEXT).with_click(at(room, 1.5, -1.0))
    inside = now.with_click(at(room, -0.01, -1.0))
    assert not room.grid.free[room.grid.lattice.rows_cols((-0.01, -1.0))]
    route = room.route(inside)
    assert room.grid.free[room.grid.lattice.rows_cols(route.positions[-1, :2])]
    moved = abs(route.positions[-1, 0] + 0.01)
    assert 0 < moved < 0.3
    text = texts.describe_route(inside, route).replace("\\", "")
    assert (
        f"The goal is {np.hypot(moved, route.positions[-1, 1] + 1.0):.2f} m from the click" in text
    )
    assert "from the click" not in texts.describe_route(
        now, room.route(now.with_click(at(room, 1.0, -1.0)))
    )
    far = now.with_click(at(room, 1.0, 0.5))  # in the middle of a table
    assert isinstance(room.route(far), str)


def test_a_cell_tells_what_blocks_it_and_that_is_lit(room, chosen):
    inspection = room.inspect(replace(chosen, inspected=at(room, 1.02, 0.52, geom=4)))
    assert inspection.facts.items() >= room.grid.describe_cell((1.02, 0.52), 0).items()
    assert inspection.clicked == "table"
    text = texts.describe_inspection(inspection, None)
    assert "**blocked** by <code>table</code>" in text
    corners = inspection.highlighted.reshape(-1, 3)
    np.testing.assert_allclose(corners.min(axis=0), [0.7, 0.2, 0], atol=0.02)
    np.testing.assert_allclose(corners.max(axis=0), [1.3, 0.8, 0.7], atol=0.02)
    free = room.inspect(replace(chosen, inspected=at(room, -1.5, 1.0)))
    assert "**free**" in texts.describe_inspection(free, None) and not len(free.highlighted)
    near = replace(chosen, inspected=at(room, 0.15, -0.5), inflation=(0.3, 0.0))
    assert "nearer to something than the radius" in texts.describe_inspection(
        room.inspect(near), (0.3, 0.0)
    )
    assert texts.describe_inspection(room.inspect(chosen), None) == texts.HINT_INSPECT


def test_a_click_shows_where_a_base_reaches_the_thing(room, chosen):
    now = replace(chosen, click=REACH_TEXT, inflation=(0.2, 0.0))
    assert room.stands(now) is None and texts.describe_stands(None) == texts.HINT_REACH
    now = now.with_click(at(room, 1.02, 0.52, geom=4))
    stand_view = room.stands(now)
    finder = navbake.PathFinder(room.grid.inflate(0.2))
    expected = finder.stand_poses("object:table")
    np.testing.assert_array_equal(stand_view.poses.positions, expected.positions)
    (region,) = finder.stand_region("object:table")
    rows, cols = np.nonzero(region)
    middles = room.grid.lattice.positions(rows, cols)
    np.testing.assert_allclose(stand_view.region.mean(axis=1)[:, :2], middles)
    np.testing.assert_allclose(np.ptp(stand_view.region[..., :2], axis=1), 0.1)
    corners = stand_view.highlighted.reshape(-1, 3)
    np.testing.assert_allclose(corners.max(axis=0), [1.3, 0.8, 0.7], atol=0.02)
    text = texts.describe_stands(stand_view).replace("\\", "")
    assert f"<code>table</code> is in reach from **{len(rows)} cells**" in text
    nearer = room.stands(replace(now, reach=(0.2, 0.4)))
    assert 0 < len(nearer.region) < len(rows) and nearer.poses.distances.max() <= 0.4
    place = room.stands(now.with_click(at(room, -1.5, 1.0)))  # a place on the floor
    assert place.poses.targets == ("-1.5, 1, 0",) and not len(place.highlighted)
    none = room.stands(replace(now, reach=(0.0, 0.05)))
    assert not len(none.poses) and not len(none.region)
    assert "**no pose**: no cell at 0 to 0.05 m" in texts.describe_stands(none).replace("\\", "")
    assert room.stands(replace(now, click=INSPECT_TEXT)) is None
    assert now.without_clicks().reached is None
    alone = ViewState(room.grid)  # without a scene, the cell's object counts
    assert alone.stands(now).poses.targets == ("table",)


def test_what_is_lit_obeys_the_cut_and_goes_with_the_mode(room, chosen):
    now = replace(chosen, inspected=at(room, 1.02, 0.52, geom=4), cut=0.4)
    inspection = room.inspect(now)
    assert inspection.highlighted[..., 2].max() <= 0.4 + 1e-6
    row, col = now.inspected.cell[1:]
    corners = inspection.outline[:4, :2]
    np.testing.assert_allclose(corners.mean(axis=0), room.grid.lattice.positions(row, col))
    np.testing.assert_allclose(np.ptp(corners, axis=0), 0.1)
    assert room.inspect(replace(now, click=ROUTE_TEXT)) is None
    assert len(room.inspect(replace(now, with_scene=False)).highlighted) == 0
    assert now.without_clicks().inspected is None


def test_free_cells_are_tinted_and_counted_by_storey():
    grid = navbake.load(GOLDEN / "house.grid.json.gz")
    view_state, chosen = ViewState(grid), first_choices(grid)
    panel = view_state.panel(chosen, 0)
    assert dict(panel.legend)["free"] == FREE_TINT
    assert (panel.rgb[grid.levels[0].free] == rgb_of(FREE_TINT)).all()
    frees = [view_state.count(chosen.with_level(grid, k))[0] for k in (0, 1, None)]
    assert frees == [*(np.count_nonzero(level.free) for level in grid.levels), sum(frees[:2])]


def test_names_fit_their_rooms_and_keep_clear_of_each_other():
    grid = navbake.load(GOLDEN / "house.grid.json.gz")
    for layer, level in (("rooms", None), ("doors", 0), ("doors", 1)):
        chosen = replace(first_choices(grid), layer=layer).with_level(grid, level)
        names = ViewState(grid).names(chosen)
        assert len(names) >= 3 and all(0 < name.height <= NAME_HEIGHT for name in names)
        for one, other in combinations(names, 2):
            if abs(one.position[2] - other.position[2]) < 1:
                wide = (one.width + other.width) / 2
                apart = np.abs(np.subtract(one.position, other.position))
                assert apart[0] >= wide or apart[1] >= (one.height + other.height) / 2


def test_episodes_and_trajectories_of_the_scene_are_listed():
    grid = navbake.load(GOLDEN / "house.grid.json.gz")
    episodes = make_episodes(grid, count=3)
    own = episodes.episodes[0]
    ran = Trajectory(episode=own.id, positions=[own.start, (0.0, 0.0, 0.0)])
    other = Trajectory(episode="another", positions=[])
    runs = list_runs(grid, episodes, [ran, other])
    assert list(runs) == [each.id for each in episodes.episodes]
    assert runs[own.id] == (own, ran)
    assert list_runs(grid, None, [other]) == {"another": (None, other)}
    assert f"{own.distance:.2f}".replace(".", "\\.") in texts.describe_episode(own)


def test_a_trajectory_has_its_scores():
    grid = navbake.load(GOLDEN / "apartment.grid.json.gz")
    episodes = make_episodes(grid, "point", count=2)
    first, second = episodes.episodes
    path = navbake.PathFinder(grid).find_path(first.start, [first.goals[0].position])
    ran = Trajectory(episode=first.id, positions=path.positions.tolist())
    lost = Trajectory(episode=second.id, positions=[(99.0, 99.0, 0.0)])
    runs = list_runs(grid, episodes, [ran, lost])
    view_state = ViewState(grid, runs=runs, episodes=episodes)
    chosen = replace(first_choices(grid), episode=first.id)
    [expected] = score_set(episodes, [ran], grid, partial=True)
    assert view_state.scores(chosen) == expected
    text = texts.describe_scores(expected)
    assert "Trajectory: success" in text and "| SPL |" in text and "| collisions | 0 |" in text
    assert "nan" not in text
    reason = view_state.scores(replace(chosen, episode=second.id))
    assert "Not scored" in texts.describe_scores(reason)
    assert view_state.scores(replace(chosen, episode="")) is None
    assert texts.describe_scores(None) == ""


def test_names_of_stops_at_one_place_stand_apart():
    grid = navbake.load(GOLDEN / "tower.grid.json.gz")
    chosen = replace(first_choices(grid).with_level(grid, 1), layer="links")
    names = ViewState(grid).names(chosen)
    assert {name.text for name in names} == {"stair 1", "stair 2", "lift_a", "lift_b"}
    for one, other in combinations(names, 2):
        apart = np.abs(np.subtract(one.position, other.position))
        wide = (one.width + other.width) / 2
        assert apart[0] >= wide or apart[1] >= one.height or apart[2] >= 2 * one.height - 1e-9


def test_an_episode_without_a_path_has_a_shortest_one():
    grid = navbake.load(GOLDEN / "apartment.grid.json.gz")
    (bare,) = make_episodes(grid, "point", count=1).episodes
    stored = msgspec.structs.replace(bare, id="stored", path=((0, 0, 0), (1, 0, 0)))
    lost = msgspec.structs.replace(bare, id="lost", start=(99.0, 99.0, 0.0))
    runs = {each.id: EpisodeRun(each, None) for each in (bare, stored, lost)} | {
        "driven": EpisodeRun(None, None)
    }
    view_state = ViewState(grid, runs=runs)
    chosen = first_choices(grid)
    path = view_state.episode_path(replace(chosen, episode=bare.id))
    goal = [bare.goals[0].position]
    expected = navbake.PathFinder(grid).find_path(bare.start, goal)
    np.testing.assert_array_equal(path, expected.positions)
    assert view_state.episode_path(replace(chosen, episode="stored")).tolist() == [
        [0, 0, 0],
        [1, 0, 0],
    ]
    paths = [
        view_state.episode_path(replace(chosen, episode=episode))
        for episode in ("lost", "driven", "")
    ]
    assert [len(path) for path in paths] == [0, 0, 0]


@pytest.mark.parametrize("task", ["object", "reach"])
def test_the_path_to_an_object_ends_where_it_is_reached(task):
    grid = navbake.load(GOLDEN / "apartment.grid.json.gz")
    episodes = make_episodes(grid, task, count=4)
    view_state = ViewState(grid, runs=list_runs(grid, episodes, []), episodes=episodes)
    finder = navbake.PathFinder(grid)
    for episode in episodes.episodes:
        path = view_state.episode_path(replace(first_choices(grid), episode=episode.id))
        assert len(path) > 1
        goals = np.concatenate([find_goal_cells(finder, goal) for goal in episode.goals])
        assert finder.search.flat.cells_at(path[-1]) in goals


def test_layers_levels_and_cut_change_what_is_drawn(room, chosen):
    assert set(room.layers) == {*room.layers} and DISAGREEMENTS in room.layers
    drawn = {name: room.overlay(replace(chosen, layer=name), 0) for name in room.layers}
    assert drawn["occupancy"] != drawn["floor"] != drawn["rooms"]
    assert room.overlay(chosen, 0) is room.overlay(chosen, 0)
    assert room.overlay(replace(chosen, opacity=0.5), 0) != drawn["occupancy"]
    whole, low = (room.surfaces(replace(chosen, cut=cut)) for cut in (None, 0.5))
    assert max(one.vertices[:, 2].max() for one in whole) == pytest.approx(2.0)
    assert max(one.vertices[:, 2].max() for one in low) == pytest.approx(0.5)
    assert room.surfaces(replace(chosen, with_scene=False)) == ()


def test_a_verification_fills_its_layer(room, chosen):
    view_state = ViewState(room.grid, room.scene, room.config)
    view_state.verify()
    assert view_state.report.ok
    assert "agree" in texts.describe_report(view_state)
    assert view_state.panel(replace(chosen, layer=DISAGREEMENTS), 0).rgb.shape[2] == 3
    with pytest.raises(QueryError, match="no scene"):
        ViewState(room.grid).verify()


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_a_level_is_looked_into_from_over_its_ground():
    grid = navbake.bake(navbake.samples.path("house"))
    chosen = first_choices(grid)
    assert chosen.levels == (0, 1)
    one = chosen.with_level(grid, 0)
    assert one.levels == (0,) and one.cut < grid.levels[1].ground < chosen.cut
    assert one.with_level(grid, None) == chosen


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_doors_move_in_grid_and_scene():
    apartment = navbake.samples.path("apartment")
    view_state = make_view_state(navbake.bake(apartment), apartment)
    chosen, door = first_choices(view_state.grid), view_state.grid.doors[0]
    closed = chosen.with_door(view_state.grid, [door.id], "closed")
    gone = chosen.with_door(view_state.grid, [door.id], "removed")
    expected = view_state.grid.with_doors({door.id: "closed"})
    for level, other in zip(view_state.shown_grid(closed).levels, expected.levels, strict=True):
        np.testing.assert_array_equal(level.weights, other.weights)
    before, after, without = (view_state.drawing(one) for one in (chosen, closed, gone))

    def places(drawing):
        geoms = [g for g, name in enumerate(drawing.names) if name == door.id]
        return select_triangles(drawing.surfaces, geoms)

    assert len(places(before)) and len(places(after)) and not len(places(without))
    if door.like != "closed":
        assert not np.allclose(places(before), places(after))
    assert closed.with_door(view_state.grid, [door.id], door.state) == chosen


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_choices_outlive_another_bake_as_far_as_it_has_them(room, chosen):
    now = replace(
        chosen, levels=(0, 3), doors=(("gone", "open"),), layer="rooms",
        inspected=at(room, 1.0, 1.0, geom=4), start=at(room, -1.5, 1),
        click=INSPECT_TEXT,
    )  # fmt: skip
    kept = transfer_choices(now, room.grid)
    assert kept.levels == (0,) and kept.doors == () and kept.layer == "rooms"
    assert kept.inspected.cell == now.inspected.cell and kept.inspected.geom is None
    apartment = navbake.samples.path("apartment")
    small = navbake.bake(apartment, grid={"cell_size": 0.5})
    far = replace(now, inspected=Pick(now.inspected.cell, (99.0, 99.0, 0.0), None))
    assert transfer_choices(far, small).inspected is None


def test_a_grid_of_another_scene_is_refused(room):
    import mujoco

    other = mujoco.MjModel.from_xml_string(ROOM.replace('size=".05 1.1 1"', 'size=".05 1 1"'))
    with pytest.raises(QueryError, match="isn't the scene that the grid was baked from"):
        make_view_state(room.grid, other)
    assert "digests differ" in make_view_state(room.grid, other, force=True).note


def test_a_grid_without_its_scene_is_shown_alone(room, tmp_path):
    room.grid.save(tmp_path / "room.grid.json")
    alone = make_view_state(tmp_path / "room.grid.json")
    assert alone.scene is None and "Without its scene" in alone.note
    assert alone.surfaces(first_choices(alone.grid)) == ()
    assert DISAGREEMENTS not in alone.layers


def test_names_from_files_are_text_on_the_page():
    assert texts.escape_markdown("a_b *c* <img src=x>") == r"a\_b \*c\* \<img src=x\>"
    assert texts.escape_markdown("&lt; a\r\n\r b") == r"\&lt; a b"
    panel = Panel("room", np.zeros((1, 1, 3), np.uint8), legend=(("<b>bold</b>", "#ffffff"),))
    legend = texts.render_legend([panel])
    assert "<b>" not in legend
