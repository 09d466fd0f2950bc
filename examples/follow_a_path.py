"""A wheeled robot crosses the apartment while a person walks through it.

python examples/follow_a_path.py
"""

from pathlib import Path

import mujoco
import numpy as np

import navbake

CONFIGS = Path(__file__).resolve().parents[1] / "configs"
RADIUS, WHEEL, TRACK = 0.18, 0.06, 0.30  # of the robot [m]: its hull, a wheel, from wheel to wheel
PERSON, PACE, KEEP = 0.25, 0.35, 0.15  # a person's radius [m], pace [m/s], how far to stay away [m]
SIDE = f"""<body pos="0 {{}} {WHEEL}"><joint name="{{}}" axis="0 1 0"/>
  <geom type="cylinder" size="{WHEEL} .015" zaxis="0 1 0" mass=".5"/></body>"""
ROBOT = f"""<mujoco><worldbody><body name="robot"><freejoint/>
  <geom type="cylinder" size="{RADIUS} .08" pos="0 0 .14" mass="8"/>
  <geom type="sphere" size=".03" pos=".13 0 .03" priority="1" condim="1"/>
  <geom type="sphere" size=".03" pos="-.13 0 .03" priority="1" condim="1"/>
  {SIDE.format(TRACK / 2, "left")}{SIDE.format(-TRACK / 2, "right")}</body></worldbody><actuator>
  <velocity joint="left" kv="2"/><velocity joint="right" kv="2"/></actuator></mujoco>"""

grid = navbake.bake(CONFIGS / "apartment.yaml").inflate(RADIUS + 0.04)  # it keeps to 4 cm
finder = navbake.PathFinder(grid)
start, goal = (-4.0, -2.0, 0.0), (3.5, 0.5, 0.0)
follower = finder.follow(finder.find_path(start, goal))
walk = finder.find_path((1.5, -2.5, 0.0), (0.1, 2.2, 0.0))  # the person's

spec = mujoco.MjSpec.from_file(str(CONFIGS / "scenes" / "apartment.xml"))
for key in list(spec.keys):
    spec.delete(key)  # it knows nothing of a robot
frame = spec.worldbody.add_frame(pos=start)
spec.attach(mujoco.MjSpec.from_string(ROBOT), prefix="my_", frame=frame)
body = spec.worldbody.add_body(name="person", mocap=True)
body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[PERSON, 0.85, 0])
spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # for stiff servos
model = spec.compile()
data, block, contacts, waited, nearest = mujoco.MjData(model), None, 0, 0.0, np.inf
robot = data.body("my_robot")
of_robot = model.body_rootid[model.geom_bodyid] == robot.id
mujoco.mj_forward(model, data)

while follower.state != "arrived" and data.time < 120.0:
    person = walk.at(PACE * data.time)
    data.mocap_pos[0] = person + (0.0, 0.0, 0.9)
    new = grid.block(disc=(person, PERSON + KEEP))  # as a sensor would see it
    block = block and block.free() or new
    command = follower.command(robot.xpos, np.arctan2(robot.xmat[3], robot.xmat[0]))
    data.ctrl = (command.forward + np.array([-0.5, 0.5]) * TRACK * command.turn) / WHEEL
    mujoco.mj_step(model, data, nstep=25)
    is_hit = of_robot[data.contact.geom].any(axis=1) & (data.contact.pos[:, 2] > 0.04)
    contacts += int(is_hit.sum())  # what is lower is floor, and rugs
    waited += 0.05 * (follower.state == "waiting")
    nearest = min(nearest, np.hypot(*(robot.xpos - person)[:2]) - RADIUS - PERSON)

print(f"{follower.state} after {data.time:.1f} s, {follower.num_replans} new paths")
print(f"waited {waited:.1f} s, {nearest:.2f} m from the person at least, {contacts} contacts")
