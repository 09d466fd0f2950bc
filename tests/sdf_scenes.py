"""Worlds of SDF that tests write of compiled models: nested frames, meshes, height maps."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np
from PIL import Image

# of the frames that the links of a model are relative to, each on the one before
AROUND = (0.7, -1.3, 0.4, 0.3, -0.2, 1.1)


def numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


def matrix_of(pose: Any) -> Any:
    """A pose x, y, z, roll, pitch, yaw as a matrix, by elementary turns."""

    def turn(axis: int, angle: float) -> Any:
        a, b = [k for k in range(3) if k != axis]
        matrix, sign = np.eye(3), -1.0 if axis == 1 else 1.0
        matrix[a, a] = matrix[b, b] = np.cos(angle)
        matrix[a, b], matrix[b, a] = -sign * np.sin(angle), sign * np.sin(angle)
        return matrix

    place = np.eye(4)
    place[:3, :3] = turn(2, pose[5]) @ turn(1, pose[4]) @ turn(0, pose[3])
    place[:3, 3] = pose[:3]
    return place


def pose_of(matrix: Any) -> str:
    """A matrix as <pose> by a quaternion, to all digits."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(matrix[:3, :3]).ravel())
    return numbers([*matrix[:3, 3], *quat[1:], quat[0]])


def write_world(model: Any, folder: Path) -> Path:
    """Write a model of static bodies as a world that includes a model for each body.

    Bodies' places are those of includes; inside, a link hangs on a frame that hangs on another one.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    lines, folder = ['<sdf version="1.9"><world name="w"><light name="sun"/>'], folder / "world"
    folder.mkdir()
    for body in range(model.nbody):
        geoms = np.flatnonzero(model.geom_bodyid == body)
        if not len(geoms):
            continue
        name, own = model.body(body).name if body else "of_world", f"body_{body}"
        place = np.eye(4)
        place[:3, :3], place[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
        lines.append(
            f"<include><uri>model://{own}</uri><name>{name}</name>"
            f'<pose rotation_format="quat_xyzw">{pose_of(place)}</pose></include>'
        )
        home = folder / "models" / own
        home.mkdir(parents=True)
        around = matrix_of(AROUND)
        back = np.linalg.inv(around @ around)
        text = [
            '<sdf version="1.9"><model name="m"><static>1</static><!-- <link name="x"/> -->',
            f'<frame name="a"><pose>{numbers(AROUND)}</pose></frame>',
            f'<frame name="b" attached_to="a"><pose>{numbers(AROUND)}</pose></frame>',
            '<link name="l"><pose relative_to="b" rotation_format="quat_xyzw">',
            f"{pose_of(back)}</pose>",
        ]
        for geom in geoms.tolist():
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
            matrix = np.linalg.solve(place, matrix)
            shape = _write_shape(model, geom, home, matrix)
            text.append(
                f"<collision name={quoteattr(f'c{geom}')}>"
                f'<pose rotation_format="quat_xyzw">{pose_of(matrix)}</pose>'
                f"<geometry>{shape}</geometry></collision>"
            )
        text.append("</link></model></sdf>")
        (home / "model-1_9.sdf").write_text("".join(text))
        (home / "model.config").write_text(
            '<model><sdf version="1.4">old.sdf</sdf><sdf version="1.9">model-1_9.sdf</sdf></model>'
        )
    lines.append("<plugin name='p' filename='q'/></world></sdf>")
    (folder / "worlds").mkdir()
    path = folder / "worlds" / "scene.sdf"
    path.write_text("\n".join(lines))
    return path


def _write_shape(model: Any, geom: int, home: Path, matrix: Any) -> str:
    """The <geometry> of a geom; of a height field, the pose is moved to its lowest point."""
    types, size = mujoco.mjtGeom, model.geom_size[geom].tolist()
    kind, number = int(model.geom_type[geom]), int(model.geom_dataid[geom])
    if kind == types.mjGEOM_BOX:
        return f"<box><size>{numbers(2 * np.array(size))}</size></box>"
    if kind == types.mjGEOM_SPHERE:
        return f"<sphere><radius>{size[0]!r}</radius></sphere>"
    if kind in (types.mjGEOM_CYLINDER, types.mjGEOM_CAPSULE):
        tag = "cylinder" if kind == types.mjGEOM_CYLINDER else "capsule"
        return f"<{tag}><radius>{size[0]!r}</radius><length>{2 * size[1]!r}</length></{tag}>"
    if kind == types.mjGEOM_PLANE:
        return "<plane><normal>0 0 1</normal></plane>"
    if kind == types.mjGEOM_HFIELD:
        rows, cols = int(model.hfield_nrow[number]), int(model.hfield_ncol[number])
        first = int(model.hfield_adr[number])
        heights = model.hfield_data[first : first + rows * cols].reshape(rows, cols)
        half_x, half_y, rise, _ = model.hfield_size[number].tolist()
        # the image's first row of pixels is at the largest y
        pixels = np.round(heights[::-1] * 65535).astype(np.uint16)
        Image.fromarray(pixels).save(home / f"heights_{geom}.png")
        return (
            f"<heightmap><uri>file://heights_{geom}.png</uri>"
            f"<size>{numbers([2 * half_x, 2 * half_y, rise])}</size></heightmap>"
        )
    mesh = model.mesh(number)
    first, start = int(mesh.vertadr[0]), int(mesh.faceadr[0])
    vertices = model.mesh_vert[first : first + int(mesh.vertnum[0])].astype(float)
    faces = model.mesh_face[start : start + int(mesh.facenum[0])]
    (home / "meshes").mkdir(exist_ok=True)
    # in millimetres, which <scale> makes metres
    lines = [f"v {numbers(1000 * vertex)}" for vertex in vertices]
    lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in faces.tolist()]
    (home / "meshes" / f"{geom}.obj").write_text("\n".join(lines))
    uri = f"model://{home.name}/meshes/{geom}.obj"
    return f"<mesh><uri>{uri}</uri><scale>0.001 0.001 0.001</scale></mesh>"
