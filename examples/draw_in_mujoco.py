"""Films a robot that drives past a person, with its grid and its path as they change.

python examples/draw_in_mujoco.py
"""

import os
import sys

if sys.platform == "linux" and "DISPLAY" not in os.environ:
    os.environ.setdefault("MUJOCO_GL", "egl")  # or osmesa; before mujoco is imported
import mujoco
import numpy as np
from PIL import Image

import navbake

settings = navbake.samples.path("apartment")
spec = mujoco.MjSpec.from_file(str(settings.parent / "scenes" / "apartment.xml"))
_ = [spec.delete(key) for key in list(spec.keys)]  # keyframes know of no robot
cylinder = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER}
body = spec.worldbody.add_body(name="robot", mocap=True, pos=[-4.0, -1.8, 0.0])
body.add_geom(size=[0.18, 0.15, 0.0], pos=[0.0, 0.0, 0.15], rgba=[0.9, 0.3, 0.1, 1.0], **cylinder)
body = spec.worldbody.add_body(name="person", mocap=True, pos=[2.2, -2.2, 0.0])
body.add_geom(size=[0.25, 0.85, 0.0], pos=[0.0, 0.0, 0.85], rgba=[0.2, 0.4, 0.9, 1.0], **cylinder)
model = spec.compile()
data = mujoco.MjData(model)
robot, person = data.mocap_pos  # views: writing moves the bodies
baker = navbake.Baker(model, data, robot="robot", grid={"cell_size": 0.05})
finder = navbake.PathFinder(baker.grid.inflate(0.22))
renderer = mujoco.Renderer(model, 300, 480)
camera = mujoco.MjvCamera()
camera.lookat, camera.distance, camera.azimuth, camera.elevation = (0.0, -1.9, 0.0), 6.5, 90, -80
frames, heading, state = [], 0.0, ""
while state != "arrived" and len(frames) < 100:
    for _ in range(4):  # 0.1 s each
        person += (-0.03, 0.02, 0.0) if person[0] > 0.9 else 0.0
        finder.use(baker.update(data).grid.inflate(0.22))
        path = finder.find_path(robot, (3.0, -0.7, 0.0))
        if path is not None:  # else the person is too near, and the robot waits
            follower = finder.follow(path)
            command, state = follower.command(robot, heading), follower.state
            heading += 0.1 * command.turn
            robot += 0.1 * command.forward * np.array([np.cos(heading), np.sin(heading), 0.0])
    mujoco.mj_forward(model, data)
    renderer.update_scene(data, camera)
    _ = [navbake.draw(renderer.scene, content) for content in (finder, path) if content]
    frames.append(Image.fromarray(renderer.render()))
renderer.close()  # while MuJoCo and OpenGL are loaded
frames[0].save("film.gif", save_all=True, append_images=frames[1:], duration=200, loop=0)
print(f"{state} after {0.4 * len(frames):.1f} s, {len(frames)} frames in film.gif")
