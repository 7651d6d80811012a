"""Transforms as 4x4 matrices of float64: metres, radians, column vectors."""

import math

import numpy as np


def translation(x, y, z):
    m = np.eye(4)
    m[:3, 3] = x, y, z
    return m


def rotation(axis, angle):
    """The rotation by `angle` about the axis "X", "Y" or "Z"."""
    i = "XYZ".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    m = np.eye(4)
    m[j, j] = m[k, k] = math.cos(angle)
    m[k, j] = math.sin(angle)
    m[j, k] = -math.sin(angle)
    return m


def scaling(x, y, z):
    return np.diag([x, y, z, 1.0])


def euler(x, y, z):
    """Rotations about X, then Y, then Z."""
    return rotation("Z", z) @ rotation("Y", y) @ rotation("X", x)


def placed(x, y, z, yaw=0.0):
    """An object at a point, turned about the vertical axis."""
    return translation(x, y, z) @ rotation("Z", yaw)


def quaternion(x, y, z, w):
    """The rotation of a unit quaternion, the real part last."""
    m = np.eye(4)
    m[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return m


def slerp(a, b, share):
    """The quaternion at `share` of the shorter arc from `a` to `b`."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    cosine = a @ b
    if cosine < 0:
        b, cosine = -b, -cosine
    if cosine > 1 - 1e-9:
        mixed = (1 - share) * a + share * b
        return mixed / np.linalg.norm(mixed)
    angle = math.acos(cosine)
    return (math.sin((1 - share) * angle) * a + math.sin(share * angle) * b) / math.sin(angle)


def segment(start, end, forward=(1.0, 0.0, 0.0)):
    """The frame in the middle of a segment: z from `start` to `end`, x as near to `forward` as possible."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    z = (end - start) / np.linalg.norm(end - start)
    y = np.cross(z, forward)
    if np.linalg.norm(y) < 1e-6:
        y = np.cross(z, (0.0, 1.0, 0.0))
    y /= np.linalg.norm(y)
    m = np.eye(4)
    m[:3, :3] = np.stack([np.cross(y, z), y, z], 1)
    m[:3, 3] = (start + end) / 2
    return m


def apply(matrix, points):
    """`points` [n][3] transformed by `matrix`."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]
