"""Numbers of enums are MuJoCo's own."""

from __future__ import annotations

import mujoco
import pytest

from navbake.baker.core import constants

GEOMS = ("PLANE", "HFIELD", "SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX", "MESH", "SDF")
JOINTS = ("FREE", "BALL", "SLIDE", "HINGE")


@pytest.mark.parametrize("name", GEOMS)
def test_geom_types_are_mujoco_s(name):
    assert getattr(constants, name) == int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))


@pytest.mark.parametrize("name", JOINTS)
def test_joint_types_are_mujoco_s(name):
    assert getattr(constants, name) == int(getattr(mujoco.mjtJoint, f"mjJNT_{name}"))
