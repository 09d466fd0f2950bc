"""A Gymnasium environment over a set of episodes: drive to the goal, round the furniture.

python examples/gymnasium_env.py
"""

import gymnasium
import numpy as np
from gymnasium.utils.env_checker import check_env

from navbake import PathFinder, bake, episodes, samples, scores, tensors

GRID = bake(samples.path("apartment")).inflate(0.2)
FINDER, T = PathFinder(GRID), GRID.tensors()
SET = episodes.make_episodes(GRID, "point", "habitat", count=50)


class Navigate(gymnasium.Env):
    action_space = gymnasium.spaces.Box(-1, 1, (3,))  # ahead, turn, stop if > 0.9
    near = gymnasium.spaces.Box(0, 1, (16, 16), np.uint8)  # what is free around it
    goal = gymnasium.spaces.Box(-50, 50, (2,))  # ahead of it, and left [m]
    observation_space = gymnasium.spaces.Dict(near=near, goal=goal)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        chosen = self.np_random.integers(len(SET))
        self.episode = SET.episodes[(options or {}).get("episode", chosen)]
        self.measures = scores.Measures(FINDER, self.episode)
        self.position, self.yaw = np.array(self.episode.start), self.episode.heading
        return self.observe(), {"episode": self.episode.id}

    def step(self, action):
        before, stopped = self.measures.distance, bool(action[2] > 0.9)
        self.yaw += 0.5 * float(action[1])
        move = 0.1 * action[0] * np.array([np.cos(self.yaw), np.sin(self.yaw), 0.0])
        self.position = FINDER.try_step(self.position, self.position + move)
        progress = before - self.measures.step(self.position)  # along the shortest path [m]
        found = self.measures.scores(stopped=True) if stopped else {}
        return self.observe(), progress, stopped, False, found

    def observe(self):
        cos, sin, way = np.cos(self.yaw), np.sin(self.yaw), self.episode.goals[0].position
        goal = np.array([[cos, sin], [-sin, cos]]) @ (way - self.position)[:2]
        near = tensors.patch(T, self.position, np.array(self.yaw), (16, 16), 0.1, "free")
        return {"near": near.astype(np.uint8), "goal": goal.astype(np.float32)}


check_env(Navigate(), skip_render_check=True)
envs = gymnasium.vector.SyncVectorEnv([Navigate] * 4)
print(f"{len(SET)} episodes, four at a time: {', '.join(envs.reset(seed=3)[1]['episode'])}")
print(f"a step ahead is worth {envs.step(np.eye(4, 3))[1][0]:+.2f} m")
