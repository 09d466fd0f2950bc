"""The agent that drives planned paths in MuJoCo touches nothing; off its paths it does."""

import mujoco
import numpy as np
import pytest

import baselines
import drive_agent
import navbake
from navbake.baker.scene.scene import load_scene
from navbake.config.settings import load_config
from navbake.episodes import make_episodes
from navbake.scores import score_set
from project_paths import CONFIGS


@pytest.mark.parametrize("name", ["apartment", "house", "warehouse", "terrain", "clutter"])
def test_planned_paths_touch_nothing(name):
    config = load_config(CONFIGS / f"{name}.yaml", [])
    result = drive_agent.drive(config, num_paths=4, radius=drive_agent.RADIUS, seed=0)
    assert result.num_paths == 4
    assert result.length > 4.0
    assert result.num_contacts == 0, result.touched
    assert result.off < 0.01


def test_a_line_through_a_wall_touches_it():
    config = load_config(CONFIGS / "apartment.yaml", [])
    scene = load_scene(config)
    model = drive_agent.make_model(config, scene, 0.18)
    result = drive_agent.Drive()
    line = np.array([[0.0, -6.0, 0.0], [0.0, 6.0, 0.0]])
    drive_agent.drive_line(model, mujoco.MjData(model), scene.data.qpos, line, result, 45.0)
    assert result.num_contacts > 0
    assert any("wall" in name for name in result.touched)


def test_a_follower_reaches_all_goals_of_a_set():
    config = load_config(CONFIGS / "apartment.yaml", [])
    scene = load_scene(config)
    grid = navbake.bake(config).inflate(drive_agent.RADIUS)
    content = make_episodes(grid, "point", "habitat", count=3)
    finder = navbake.PathFinder(grid)
    model = drive_agent.make_model(config, scene, drive_agent.RADIUS)
    runs, result = baselines.run(content, finder, "follower", model, scene.data.qpos, 45.0)
    rows = score_set(content, runs, grid)
    assert result.num_contacts == 0
    assert [row["success"] for row in rows] == [1.0] * 3
    for episode in content.episodes:
        for walk in (baselines.walk_greedily, baselines.walk_randomly):
            line = walk(finder, episode, np.random.default_rng(0))
            assert tuple(line[0]) == episode.start and finder.is_navigable(line).all()


def test_it_runs_from_rest_to_rest():
    for length in (0.0, 0.01, 0.3, 4.0):
        distance = drive_agent.ride(length)
        assert distance[0] == pytest.approx(0.0, abs=1e-9)
        assert distance[-1] == length
        speed = np.diff(distance) / drive_agent.TIME_STEP
        assert (speed >= -1e-9).all()
        assert speed.max(initial=0.0) <= drive_agent.SPEED + 1e-9
        assert np.abs(np.diff(speed[:-1])).max(initial=0.0) <= 2.1 * drive_agent.TIME_STEP
