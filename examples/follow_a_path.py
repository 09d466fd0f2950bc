"""A wheeled robot crosses the apartment while a person walks through it.

python examples/follow_a_path.py
"""

import mujoco
import numpy as np

import navbake

SETTINGS = navbake.samples.path("apartment")
ROBOT = """<mujoco><worldbody><body name="robot"><freejoint/>
<geom type="cylinder" size=".18 .08" pos="0 0 .14" mass="8"/>
<geom type="sphere" size=".03" pos=".13 0 .03" priority="1" condim="1"/>
<geom type="sphere" size=".03" pos="-.13 0 .03" priority="1" condim="1"/>
<body pos="0 .15 .06"><joint name="left" axis="0 1 0"/>
<geom type="cylinder" size=".06 .015" zaxis="0 1 0" mass=".5"/></body>
<body pos="0 -.15 .06"><joint name="right" axis="0 1 0"/>
<geom type="cylinder" size=".06 .015" zaxis="0 1 0" mass=".5"/></body></body></worldbody>
<actuator><velocity joint="left" kv="2"/><velocity joint="right" kv="2"/></actuator></mujoco>"""
grid = navbake.bake(SETTINGS).inflate(0.22)  # it keeps to its path within 4 cm
finder = navbake.PathFinder(grid)
follower = finder.follow(finder.find_path((-4.0, -2.0, 0.0), (3.5, 0.5, 0.0)))
walk = finder.find_path((1.5, -2.5, 0.0), (0.1, 2.2, 0.0))  # the person's

spec = mujoco.MjSpec.from_file(str(SETTINGS.parent / "scenes" / "apartment.xml"))
_ = [spec.delete(key) for key in list(spec.keys)]  # keyframes know of no robot
frame = spec.worldbody.add_frame(pos=follower.path.positions[0])
spec.attach(mujoco.MjSpec.from_string(ROBOT), prefix="my_", frame=frame)
cylinder = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": [0.25, 0.85, 0.0]}
spec.worldbody.add_body(name="person", mocap=True).add_geom(pos=[0.0, 0.0, 0.9], **cylinder)
spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # for stiff servos
model = spec.compile()
data, robot, hits, nearest = mujoco.MjData(model), model.body("my_robot").id, 0, np.inf
mujoco.mj_forward(model, data)
while follower.state != "arrived" and data.time < 60.0:
    person = data.mocap_pos[0] = walk.at(0.35 * data.time)
    with grid.block(disc=(person, 0.25 + 0.15)):  # as sensors would see it, to keep 0.15 m away
        x, y, heading = *data.xpos[robot, :2], np.arctan2(*data.xmat[robot, [3, 0]])
        command = follower.command(data.xpos[robot], heading)
    data.ctrl = (command.forward + np.array([-0.15, 0.15]) * command.turn) / 0.06
    mujoco.mj_step(model, data, nstep=25)  # 0.05 s
    touches = (model.body_rootid[model.geom_bodyid][data.contact.geom] == robot).any(axis=1)
    hits += int((touches & (data.contact.pos[:, 2] > 0.04)).sum())  # lower is floor, and rugs
    nearest = min(nearest, np.hypot(x - person[0], y - person[1]) - 0.18 - 0.25)
print(f"{follower.state} after {data.time:.1f} s, {follower.num_replans} new paths")
print(f"at least {nearest:.2f} m from the person, contacts: {hits}")
