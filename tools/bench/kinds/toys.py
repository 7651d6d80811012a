"""Nine balls and boxes that fall, bounce and collide."""

import pathlib

from materials import PHOTOS, Pattern, Photo
from shapes import cube, sphere
from subject import Part, Subject
from transforms import quaternion, slerp, translation

HALF_M = 0.13
# Physics are in slow motion: 7 steps of 1/240 s per 1/24 s.
STEP_S, STEPS, RATE_HZ = 1 / 240, 7, 24


class Simulation:
    """The toys' positions and quaternions 24 times a second, computed when asked for."""

    def __init__(self, starts):
        import pybullet
        import pybullet_data

        self.bullet, self.world = pybullet, pybullet.connect(pybullet.DIRECT)
        of = {"physicsClientId": self.world}
        pybullet.setGravity(0, 0, -9.8, **of)
        pybullet.setTimeStep(STEP_S, **of)
        ground = pybullet.loadURDF(str(pathlib.Path(pybullet_data.getDataPath()) / "plane.urdf"), **of)
        self.bodies = []
        for i, (position, angles) in enumerate(starts):
            if i % 2:
                shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[HALF_M] * 3, **of)
            else:
                shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=HALF_M, **of)
            turned = pybullet.getQuaternionFromEuler(angles)
            body = pybullet.createMultiBody(0.4, shape, basePosition=position, baseOrientation=turned, **of)
            pybullet.changeDynamics(body, -1, restitution=0.75, rollingFriction=0.002, **of)
            pybullet.changeDynamics(ground, -1, restitution=0.8, **of)
            self.bodies.append(body)
        self.states = [self._state()]

    def at(self, index):
        """The state at `index` / 24 s: (position, quaternion) per toy."""
        while len(self.states) <= index:
            for _ in range(STEPS):
                self.bullet.stepSimulation(physicsClientId=self.world)
            self.states.append(self._state())
        return self.states[index]

    def _state(self):
        return [self.bullet.getBasePositionAndOrientation(b, physicsClientId=self.world) for b in self.bodies]


def make(rng, _clip_s):
    """Start positions and colours are drawn; the simulation starts with the first pose."""
    starts, parts = [], []
    for i in range(9):
        position = [rng.uniform(-0.5, 0.5), rng.uniform(-0.4, 0.4), 0.6 + 0.34 * i]
        starts.append((position, rng.uniform(0, 3, 3)))
        if i % 2:
            parts.append(Part(i + 1, cube(2 * HALF_M), Photo(PHOTOS[i % 6])))
        else:
            first, second = rng.random(3), rng.random(3)
            material = Pattern(("voronoi", "checker")[i % 4 // 2], tuple(first), tuple(second), 9)
            parts.append(Part(i + 1, sphere(HALF_M, 48), material))
    simulation = []

    def pose(seconds):
        if not simulation:
            simulation.append(Simulation(starts))
        x = max(seconds, 0) * RATE_HZ
        index = int(x)
        before, after = simulation[0].at(index), simulation[0].at(index + 1)
        matrices = []
        for (p, q), (p1, q1) in zip(before, after):
            share = x - index
            where = [(1 - share) * c + share * d for c, d in zip(p, p1)]
            matrices.append(translation(*where) @ quaternion(*slerp(q, q1, share)))
        return matrices

    return Subject(tuple(f"toy {i + 1}" for i in range(9)), parts, pose)
