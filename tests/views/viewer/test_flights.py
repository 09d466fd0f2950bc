"""What the viewer shows of flights: voxels below a cut, tubes, and the scores of flights."""

from __future__ import annotations

import io
import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import navbake
from navbake.episodes import make_flight_episodes
from navbake.scores import Trajectory, score_set
from navbake.views.boxes import merge_voxels
from navbake.views.viewer.flights import VOXEL_MARGIN, draw_tube, draw_voxels
from navbake.views.viewer.view import make_view_state
from navbake.views.viewer.view_state import first_choices
from project_paths import GOLDEN

RADIUS = 0.15


def read(content):
    return trimesh.load_scene(io.BytesIO(content), file_type="glb", process=False)


def volume(content):
    """Volume of the boxes in a GLB, which don't overlap but for their margins."""
    (mesh,) = read(content).geometry.values()
    sizes = np.ptp(mesh.vertices.reshape(-1, 24, 3), axis=1) - 2 * VOXEL_MARGIN
    return np.prod(sizes, axis=1).sum()


@pytest.fixture(scope="module")
def voxels():
    occupied = np.random.default_rng(2).random((12, 9, 7)) < 0.2
    return navbake.VoxelGrid(values=occupied, origin=(-1.0, 2.0, 0.5), res=0.2)


@pytest.fixture(scope="module")
def state(tmp_path_factory):
    """The apartment's grid with its voxels, flights in it, and two of them flown."""
    folder = tmp_path_factory.mktemp("flights")
    voxels = navbake.create_voxel_grid(navbake.samples.path("apartment"), res=0.1)
    voxels.save(folder / "apartment.npz")
    finder = navbake.VoxelFinder(voxels, RADIUS)
    episodes = make_flight_episodes(finder, count=3, scene="apartment")
    first = episodes.episodes[0]
    flight = finder.find_path(first.start, first.goals[0].position)
    flight.save(folder / "flight.json")
    flown = [Trajectory(episode=first.id, positions=flight.positions.tolist())]
    return make_view_state(
        navbake.load(GOLDEN / "apartment.grid.json.gz"),
        episodes=episodes,
        trajectories=flown,
        voxels=folder / "apartment.npz",
        flight=folder / "flight.json",
    )


@pytest.mark.parametrize("height", [None, 0.4, 0.5, 0.7, 0.83, 1.9, 5.0])
def test_voxels_are_drawn_up_to_the_cut(voxels, height):
    layer_tops = 0.5 + 0.2 * np.arange(1, 8)
    shares = np.ones(7) if height is None else np.clip((height - layer_tops) / 0.2 + 1.0, 0.0, 1.0)
    expected = 0.2**3 * (voxels.occupied.sum(axis=(0, 1)) * shares).sum()
    content = draw_voxels(merge_voxels(voxels), height)
    if expected > 1e-9:
        assert volume(content) == pytest.approx(expected, rel=1e-5)
        assert read(content).bounds[1, 2] <= (height or 5.0) + VOXEL_MARGIN + 1e-6
    else:
        assert not read(content).geometry


def test_what_is_cut_is_dark_there(voxels):
    full = navbake.VoxelGrid(values=np.ones((2, 2, 5), dtype=bool), origin=(0, 0, 0), res=0.2)
    brightness = []
    for height in (0.9, 1.0):
        (mesh,) = read(draw_voxels(merge_voxels(full), height)).geometry.values()
        is_top = np.isclose(mesh.vertices[:, 2], height + VOXEL_MARGIN) & (
            mesh.vertex_normals[:, 2] > 0.9
        )
        brightness.append(mesh.visual.vertex_attributes["color"][is_top, :3].mean())
    assert brightness[0] < 0.6 * brightness[1]


def test_a_tube_is_as_wide_as_the_ball_and_has_a_joint_only_where_it_turns():
    positions = np.array([(0, 0, 1), (0.5, 0, 1), (1, 0, 1), (1, 0, 1), (1, 2, 1.5)], dtype=float)
    scene = read(draw_tube(positions, 0.2, "#00ff00", "#0000ff"))
    assert len(scene.geometry) == 2 + 1 + 2  # balls at the ends, a joint, legs
    assert scene.bounds[0] == pytest.approx([-0.23, -0.23, 0.77], abs=1e-2)
    assert scene.bounds[1] == pytest.approx([1.23, 2.23, 1.73], abs=1e-2)
    assert len(read(draw_tube(positions[:1], 0.2, "#00ff00", "#0000ff")).geometry) == 2


def test_voxels_and_the_flight_are_shown_and_can_be_hidden(state):
    chosen = first_choices(state.grid)
    assert read(state.voxel_glb(chosen)).bounds[1, 2] == pytest.approx(chosen.cut + VOXEL_MARGIN)
    assert state.voxel_glb(replace(chosen, with_voxels=False)) == b""
    whole = read(state.voxel_glb(replace(chosen, cut=None)))
    assert whole.bounds[1, 2] > chosen.cut + 0.5
    [tube] = state.flight_glbs(chosen)
    assert read(tube).bounds[:, 2] == pytest.approx(
        [
            state.flight.positions[:, 2].min() - 1.15 * RADIUS,
            state.flight.positions[:, 2].max() + 1.15 * RADIUS,
        ],
        abs=0.05,
    )


def test_a_chosen_flight_is_a_tube_too_and_is_scored_in_the_voxels(state):
    first, second, _ = state.episodes.episodes
    chosen = replace(first_choices(state.grid), episode=first.id)
    assert len(state.flight_glbs(chosen)) == 2
    assert state.shown_flight_episode(chosen) == first
    assert len(state.episode_path(chosen)) == len(first.path)
    [expected] = score_set(
        state.episodes, [state.runs[first.id].trajectory], state.voxels, partial=True
    )
    scores = state.scores(chosen)
    assert scores["success"] == 1.0 and math.isnan(scores.pop("coverage"))
    assert scores.items() <= expected.items()
    assert state.scores(replace(chosen, episode=second.id)) is None


def test_without_voxels_flights_are_drawn_and_not_scored(state):
    episodes = state.episodes
    first = episodes.episodes[0]
    flown = [Trajectory(episode=first.id, positions=())]
    alone = make_view_state(state.grid, episodes=episodes, trajectories=flown)
    chosen = replace(first_choices(alone.grid), episode=first.id)
    assert alone.voxel_glb(chosen) == b"" and len(alone.flight_glbs(chosen)) == 1
    assert "--voxels" in alone.scores(chosen)
    with pytest.raises(TypeError, match="voxel_file"):
        make_view_state(state.grid, voxel_file="a.npz")
