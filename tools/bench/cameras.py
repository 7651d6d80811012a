"""Camera paths: functions of seconds to a `View`. Only `matrix` needs Blender."""

import math
from dataclasses import dataclass

import numpy as np

FAR_DEG = (-15, 13)
FAR_HEIGHT_M = (1.55, 1.0)
FOCUS = (0.0, 0.1, 0.75)


@dataclass(frozen=True)
class View:
    """Where a camera is, the point in the middle of its image, and its roll; metres and radians."""

    eye: tuple
    target: tuple
    roll: float = 0.0

    def around(self, pivot, degrees):
        """The view turned about the vertical axis through `pivot`."""
        angle = math.radians(degrees)
        cos, sin = math.cos(angle), math.sin(angle)

        def turned(point):
            x, y = point[0] - pivot[0], point[1] - pivot[1]
            return (pivot[0] + cos * x - sin * y, pivot[1] + sin * x + cos * y, point[2])

        return View(turned(self.eye), turned(self.target), self.roll)


def matrix(view):
    """Camera to world, OpenGL's axes, as Blender's single-precision `Matrix`: the numbers of earlier scenes are those."""
    import bpy  # noqa: F401, mathutils comes with it
    from mathutils import Matrix, Vector

    direction = (Vector(view.target) - Vector(view.eye)).normalized()
    turned = direction.to_track_quat("-Z", "Y").to_matrix().to_4x4()
    return Matrix.Translation(view.eye) @ turned @ Matrix.Rotation(view.roll, 4, "Z")


class Rig:
    """What all scenes share: a lens, and two static held-out cameras at a distance."""

    def __init__(self, focus, distance_m, lens_rad):
        # Blender keeps the angle in single precision.
        self.focus, self.distance_m, self.lens_rad = focus, distance_m, float(np.float32(lens_rad))

    def far(self, k):
        """Held-out camera `k`, 0 or 1."""
        angle = math.radians(FAR_DEG[k])
        eye = (self.distance_m * math.sin(angle), -self.distance_m * math.cos(angle), FAR_HEIGHT_M[k])
        return View(eye, self.focus)


class Original(Rig):
    """The hand-held camera of the kinds `mill`, `quad` and `toys`: 48 degrees of an arc, whatever the clip's length."""

    def __init__(self, rng, seed, clip_s):
        lens_rad = math.radians(58 + 8 * rng.random())
        self.phases = rng.uniform(0, 6.28, 8)
        super().__init__(FOCUS, rng.uniform(2.7, 3.1), lens_rad)
        self.side, self.clip_s = (1 if seed % 2 else -1), clip_s

    def train(self, seconds):
        """The training camera at a time."""
        t = seconds / self.clip_s
        shake = lambda k: self._shake(t, k)
        azimuth = self.side * math.radians(-24 + 48 * t) + 0.02 * shake(0)
        r = self.distance_m + 0.25 * math.sin(2 * math.pi * t) + 0.02 * shake(1)
        height = 1.25 + 0.2 * math.sin(4 * t + self.phases[3]) + 0.02 * shake(2)
        eye = (r * math.sin(azimuth), -r * math.cos(azimuth), height)
        return View(eye, (0.04 * shake(3), 0.1 + 0.03 * shake(4), 0.75 + 0.03 * shake(5)), 0.012 * shake(6))

    def _shake(self, t, k):
        waves = (math.sin(2 * math.pi * (1.3 + 1.7 * i) * t + self.phases[(k + i) % 8]) / (i + 1.5) for i in range(4))
        return sum(waves)


class Handheld(Rig):
    """The hand-held camera of the other kinds: it swings to and fro around the focus, at a walking pace, and shakes."""

    def __init__(self, rng, focus):
        super().__init__(focus, rng.uniform(2.6, 3.2), math.radians(rng.uniform(56, 68)))
        self.middle, self.swing = math.radians(rng.uniform(-6, 6)), math.radians(rng.uniform(16, 25))
        # Half a period, and a full sweep, in 3.3 to 4.5 s, begun near one end.
        self.rate, self.start = math.pi / rng.uniform(3.3, 4.5), rng.choice((-1, 1)) * (math.pi / 2 + rng.uniform(-0.3, 0.4))
        self.height, self.drift = rng.uniform(1.0, 1.5), rng.uniform(0.05, 0.25, 2)
        self.drift_rates, self.drift_phases = rng.uniform(0.5, 1.2, 2), rng.uniform(0, 2 * math.pi, 2)
        self.firmness, self.phases = rng.uniform(0.6, 1.3), rng.uniform(0, 2 * math.pi, (7, 4))
        self.shake_rates = 2 * math.pi * np.array([0.4, 0.9, 1.5, 2.1]) * rng.uniform(0.8, 1.2, 4)

    def train(self, seconds):
        """The training camera at a time."""
        weights = self.firmness / np.array([1.5, 2.5, 3.5, 4.5])
        shake = np.sin(self.shake_rates * seconds + self.phases) @ weights
        near, rise = self.drift * np.sin(self.drift_rates * seconds + self.drift_phases)
        azimuth = self.middle + self.swing * math.sin(self.rate * seconds + self.start) + 0.015 * shake[0]
        r = self.distance_m + near + 0.02 * shake[1]
        eye = (r * math.sin(azimuth), -r * math.cos(azimuth), self.height + rise + 0.02 * shake[2])
        target = np.array(self.focus) + np.array([0.04, 0.03, 0.03]) * shake[3:6]
        return View(eye, tuple(target), 0.012 * shake[6])
