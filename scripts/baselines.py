"""Drives three baselines through a set of episodes in MuJoCo, and prints a table of their scores.

    python scripts/baselines.py [configs/house.yaml] [--count 50] [--only follower]

The follower takes the shortest path. The greedy walker heads for the goal through the air, slides
along what is in its way, and stops where no step brings it nearer. The random walker goes straight
on until something is in its way, then into another direction, and stops at the goal or out of
patience. Each is the agent of `drive_agent.py`: a cylinder that servos move in real physics steps.
SPL counts by the shortest path over cells; the last column by that of any angle, which is shorter.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import navbake
from drive_agent import BAKED_RADIUS, Drive, drive_line, make_model
from navbake.baker.scene.scene import load_scene
from navbake.config.settings import load_config
from navbake.episodes import Episode, EpisodeSet, make_episodes
from navbake.scores import Trajectory, path_length, score_set, summarize

ROOT = Path(__file__).resolve().parents[1]
STEP = 0.1  # of the walkers [m]
PATIENCE = 4.0  # a walker gives up when it went so many times the shortest path, and 5 m
COLUMNS = ("success", "spl", "soft_spl", "distance", "collisions")


def follow(finder: navbake.PathFinder, episode: Episode, *_: object) -> np.ndarray:
    """The shortest path, pulled straight."""
    path = finder.find_path(episode.start, episode.goals[0].position)
    assert path is not None  # all episodes can be solved
    return path.positions


def walk_greedily(finder: navbake.PathFinder, episode: Episode, *_: object) -> np.ndarray:
    """Steps towards the goal, that slide along obstacles; it stays where none brings it nearer."""
    goal, line = np.array(episode.goals[0].position), [np.array(episode.start)]
    while np.linalg.norm(goal - line[-1]) > STEP / 2 and _is_patient(line, episode):
        way = (goal - line[-1])[:2]
        ahead = np.append(way * min(1.0, STEP / np.hypot(*way)), 0.0) if way.any() else np.zeros(3)
        moved = finder.try_step(line[-1], line[-1] + ahead)
        if np.linalg.norm(goal - moved) > np.linalg.norm(goal - line[-1]) - 1e-4:
            break
        line.append(moved)
    return np.array(line)


def walk_randomly(
    finder: navbake.PathFinder, episode: Episode, rng: np.random.Generator
) -> np.ndarray:
    """Straight on until something is in the way, then another way at random; stops at the goal."""
    goal, line, heading = episode.goals[0], [np.array(episode.start)], episode.heading
    while np.linalg.norm(goal.position - line[-1]) > goal.radius and _is_patient(line, episode):
        ahead = STEP * np.array([np.cos(heading), np.sin(heading), 0.0])
        moved = finder.try_step(line[-1], line[-1] + ahead, slide=False)
        if np.linalg.norm((moved - line[-1])[:2]) < STEP / 2:
            heading = rng.uniform(-np.pi, np.pi)
        else:
            line.append(moved)
    return np.array(line)


def _is_patient(line: list[np.ndarray], episode: Episode) -> bool:
    return (len(line) - 1) * STEP < PATIENCE * (episode.distance or 0.0) + 5.0


WALKERS: dict[str, Callable[..., np.ndarray]] = {
    "follower": follow,
    "greedy": walk_greedily,
    "random": walk_randomly,
}


def run(
    content: EpisodeSet, finder: navbake.PathFinder, name: str, model: Any, pose: np.ndarray,
    max_slope: float,
) -> tuple[list[Trajectory], Drive]:  # fmt: skip
    """Drive one baseline through all episodes: where it was, and what it touched."""
    result, rng, found = Drive(), np.random.default_rng(0), []
    data = mujoco.MjData(model)
    for episode in content.episodes:
        line = WALKERS[name](finder, episode, rng)
        places = drive_line(model, data, pose, line, result, max_slope) if len(line) > 1 else line
        result.num_paths += 1
        result.length += path_length(line)
        found.append(Trajectory(episode=episode.id, positions=places.tolist()))
    return found, result


def main() -> None:
    parser = argparse.ArgumentParser(description="Drive baselines through episodes in MuJoCo.")
    config_file = ROOT / "configs" / "house.yaml"
    parser.add_argument("config", type=Path, nargs="?", default=config_file, help="settings (YAML)")
    parser.add_argument("--count", type=int, default=50, help="episodes")
    parser.add_argument("--radius", type=float, default=0.18, help="of the agent [m]")
    parser.add_argument("--only", nargs="+", choices=WALKERS, default=[*WALKERS], help="which")
    given = parser.parse_args()
    config = load_config(given.config, [f"agent.radius={BAKED_RADIUS}"])
    grid = navbake.bake(config).inflate(given.radius)
    finder = navbake.PathFinder(grid)
    content = make_episodes(grid, "point", "habitat", count=given.count)
    scene = load_scene(config)
    model = make_model(config, scene, given.radius)
    pose = scene.data.qpos.copy() if config.scene.path.suffix == ".xml" else np.empty(0)
    print("| baseline | " + " | ".join(COLUMNS) + " | contacts | of any angle |")
    print("|---" * (len(COLUMNS) + 3) + "|")
    best = [path_length(follow(finder, e)) for e in content.episodes]
    for name in given.only:
        runs, drive = run(content, finder, name, model, pose, config.agent.max_slope)
        rows = score_set(content, runs, grid)
        (means,) = summarize(rows)
        shares = [
            row["success"] * length / max(length, row["length"])
            for row, length in zip(rows, best, strict=True)
        ]
        cells = [f"{means[key].mean:.2f}" for key in COLUMNS]
        cells += [str(drive.num_contacts), f"{np.mean(shares):.3f}"]
        print("| " + " | ".join([name, *cells]) + " |", flush=True)


if __name__ == "__main__":
    main()
