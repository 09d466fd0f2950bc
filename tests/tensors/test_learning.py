"""The terms of docs/learning.md do what they say, in an environment that only stores poses."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from navbake import tensors
from project_paths import ROOT

pytest.importorskip("array_api_compat")


class Robot:
    """Stores poses as mjlab's and Isaac Lab's assets do."""

    def __init__(self, torch, count):
        self.data = SimpleNamespace(
            root_link_pos_w=torch.zeros(count, 3),
            root_link_lin_vel_w=torch.zeros(count, 3),
            heading_w=torch.zeros(count),
        )

    def write_root_link_pose_to_sim(self, pose, env_ids):
        self.data.root_link_pos_w[env_ids] = pose[:, :3]
        self.data.heading_w[env_ids] = 2 * pose[:, 6].atan2(pose[:, 3])
        norm = (pose[:, 3:] ** 2).sum(-1)
        np.testing.assert_allclose(norm, 1.0, rtol=1e-6)


def terms():
    page = (ROOT / "docs" / "learning.md").read_text()
    [block] = [text for text in page.split("```") if "def reset_to_free_place" in text]
    names = {}
    exec(compile(block.removeprefix("python\n"), "learning.md", "exec"), names)
    return SimpleNamespace(**names)


def test_terms_of_mjlab():
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    doc, count = terms(), 64
    robot = Robot(torch, count)
    origins = 30.0 * torch.arange(count)[:, None] * torch.tensor([1.0, 0.5, 0.0])
    scene = type("Scene", (dict,), {"env_origins": origins})(robot=robot)
    env = SimpleNamespace(scene=scene, device="cpu")
    goal = tensors.sample(doc.t, torch.tensor([0.5]), room=1)
    doc.reset_to_free_place(env, torch.arange(count), goal, 0.3)
    p = doc.in_scene(env)
    # far from the origin, float32 has moved them by some micrometres
    assert (tensors.clearance(doc.t, p, mode="nearest") > 0).all()
    np.testing.assert_allclose(p[:, 2] - tensors.floor(doc.t, p), 0.3, atol=1e-4)
    left = tensors.distance_to_goal(doc.t, p)
    assert torch.isfinite(left).all()
    assert robot.data.heading_w.min() < -1.5 and robot.data.heading_w.max() > 1.5

    robot.data.root_link_lin_vel_w[:, :2] = 0.5 * tensors.path_step(doc.t, p)
    inside = left == 0
    np.testing.assert_allclose(doc.towards_goal(env)[~inside], 0.5, rtol=1e-4)
    assert (doc.towards_goal(env)[inside] == 0).all()

    scan = doc.height_scan(env)
    assert scan.shape == (count, len(doc.pattern))
    np.testing.assert_allclose(scan[:, len(doc.pattern) // 2], -0.3, atol=1e-4)
