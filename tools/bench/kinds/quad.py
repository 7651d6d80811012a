"""A quadruped robot that trots and turns: the A1 of pybullet_data, 1.6 times its size."""

import math
import pathlib

from materials import Pattern
from shapes import ObjFile
from subject import Part, Subject
from transforms import quaternion, scaling, translation

SCALE = 1.6
STEPS = 5
COLOURS = (
    Pattern("noise", (0.8, 0.2, 0.15), (0.95, 0.9, 0.2), 20),
    Pattern("checker", (0.1, 0.2, 0.5), (0.7, 0.8, 0.9), 25),
)


class Robot:
    """A URDF of pybullet_data in a world of its own: its visual meshes and their poses."""

    def __init__(self, urdf, position):
        import pybullet
        import pybullet_data

        self.bullet, self.world = pybullet, pybullet.connect(pybullet.DIRECT)
        data = pathlib.Path(pybullet_data.getDataPath())
        self.body = pybullet.loadURDF(str(data / urdf), position, useFixedBase=True, physicsClientId=self.world)
        of = {"physicsClientId": self.world}
        shapes = [(data / v[4].decode(), v) for v in pybullet.getVisualShapeData(self.body, **of)]
        self.visuals = [(str(file), v[1], v[3], v[5], v[6]) for file, v in shapes if file.suffix == ".obj"]
        joints = range(pybullet.getNumJoints(self.body, **of))
        self.joints = [j for j in joints if pybullet.getJointInfo(self.body, j, **of)[2] == pybullet.JOINT_REVOLUTE]

    def pose(self, angles, position, orientation):
        """A matrix per visual mesh, of joint angles and the base's position and quaternion."""
        bullet, of = self.bullet, {"physicsClientId": self.world}
        bullet.resetBasePositionAndOrientation(self.body, position, orientation, **of)
        for joint, angle in zip(self.joints, angles):
            bullet.resetJointState(self.body, joint, angle, **of)
        matrices = []
        for _, link, scale, local_position, local_orientation in self.visuals:
            if link < 0:
                base = bullet.getBasePositionAndOrientation(self.body, **of)
                inertial = bullet.invertTransform(*bullet.getDynamicsInfo(self.body, -1, **of)[3:5])
                frame = bullet.multiplyTransforms(*base, *inertial)
            else:
                frame = bullet.getLinkState(self.body, link, computeForwardKinematics=True, **of)[4:6]
            where, turned = bullet.multiplyTransforms(*frame, local_position, local_orientation)
            matrices.append(translation(*where) @ quaternion(*turned) @ scaling(*scale))
        return matrices


def make(_rng, clip_s):
    """The robot as one object; nothing is drawn."""
    robot = Robot("a1/a1.urdf", [0, 0, 0.31])
    parts = [Part(1, ObjFile(visual[0]), COLOURS[i % 2]) for i, visual in enumerate(robot.visuals)]

    def pose(seconds):
        t = seconds / clip_s
        step = 2 * math.pi * t * STEPS
        angles = []
        for leg in range(4):
            phase = step + (0 if leg in (0, 3) else math.pi)
            angles += [0.05 * math.sin(phase), 0.75 + 0.4 * math.sin(phase), -1.5 + 0.3 * math.cos(phase)]
        position = [-1.1 + 2.2 * t, -0.1 + 0.3 * math.sin(2 * math.pi * t), 0.30 + 0.015 * math.sin(2 * step)]
        euler = [0, 0.04 * math.sin(step), 0.5 * math.sin(2 * math.pi * t)]
        orientation = robot.bullet.getQuaternionFromEuler(euler)
        return [scaling(SCALE, SCALE, SCALE) @ m for m in robot.pose(angles, position, orientation)]

    return Subject(("robot",), parts, pose)
