"""A Gymnasium environment in a baked apartment: drive to the kitchen, round the furniture.

python examples/gymnasium_env.py
"""

import gymnasium
import numpy as np
from gymnasium.utils.env_checker import check_env

import navbake
from navbake import tensors


class DriveToKitchen(gymnasium.Env):
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)  # ahead, turn
    observation_space = gymnasium.spaces.Box(0, 1, (16, 16), np.uint8)  # free around it

    def __init__(self):
        grid = navbake.bake(navbake.samples.path("apartment")).inflate(0.2)
        finder, rng = navbake.PathFinder(grid), np.random.default_rng(0)
        self.kitchen = finder.random_point(rng, room="kitchen")
        self.t = grid.tensors(goals=[self.kitchen])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        u = self.np_random.random(1)  # one number: the centre of a cell
        self.position = tensors.sample(self.t, u, reachable_from=self.kitchen)
        self.yaw = self.np_random.uniform(-np.pi, np.pi)
        return self.observe(), {}

    def step(self, action):
        before = tensors.distance_to_goal(self.t, self.position)
        self.yaw += 0.5 * float(action[1])
        ahead = np.array([np.cos(self.yaw), np.sin(self.yaw), 0.0])
        moved = self.position + 0.1 * action[0] * ahead
        if tensors.is_navigable(self.t, moved):  # else it stops there
            self.position = moved
        left = tensors.distance_to_goal(self.t, self.position)
        return self.observe(), float(before - left), bool(left < 0.2), False, {}

    def observe(self):
        free = tensors.patch(self.t, self.position, np.array(self.yaw), (16, 16), 0.1, "free")
        return free.astype(np.uint8)


env = DriveToKitchen()
check_env(env, skip_render_check=True)
env.reset(seed=3)
print(f"{tensors.distance_to_goal(env.t, env.position):.1f} m to the kitchen")
print(f"a step ahead is worth {env.step((1.0, 0.0))[1]:+.2f} m")
