"""A cart with rolling and steered wheels, and a trailer or a boom."""

import math

import numpy as np
from materials import drawn, drawn_pattern
from paths import drawn_loop, drawn_travel
from shapes import box, capsule, wheel
from subject import Part, Subject
from transforms import placed, rotation, segment, translation

STEER_LIMIT = 0.7


def make(rng):
    """One articulated object; sizes, path, speed and surfaces are drawn. The path is that of the rear axle."""
    size = rng.uniform(0.9, 1.2)
    loop = drawn_loop(rng, (0.5, 0.7), (0.26, 0.34), centre=(0.0, -0.12))
    travel = drawn_travel(rng, (0.45, 0.85))
    base, track, radius = 0.36 * size, 0.17 * size, rng.uniform(0.085, 0.11) * size
    body = box(0.56 * size, 0.26 * size, rng.uniform(0.1, 0.16) * size)
    cabin = box(0.2 * size, 0.22 * size, rng.uniform(0.14, 0.24) * size)
    body_z = radius + 0.07 * size
    cabin_z = body_z + (body.vertices[:, 2].max() + cabin.vertices[:, 2].max())
    wheels = [(x, side * track) for x in (0.0, base) for side in (-1, 1)]
    tyre = drawn_pattern(rng, (12, 20))
    parts = [Part(1, body, drawn(rng, (8, 16))), Part(1, cabin, drawn(rng, (8, 16)))]
    parts += [Part(1, wheel(radius, 0.06 * size), tyre) for _ in wheels]
    extra = _trailer(rng, size, radius, tyre) if rng.random() < 0.5 else _boom(rng, size, cabin_z)
    parts += extra[0]

    def pose(seconds):
        l = travel(seconds)
        (x, y), yaw, curvature = loop.at(l), loop.heading(l), loop.curvature(l)
        rear = placed(x, y, 0, yaw)
        matrices = [rear @ translation(base / 2, 0, body_z), rear @ translation(0.62 * base, 0, cabin_z)]
        for wheel_x, wheel_y in wheels:
            steer = np.clip(math.atan(base * curvature), -STEER_LIMIT, STEER_LIMIT) if wheel_x > 0 else 0.0
            # A wheel on the left travels less in a left turn.
            roll = (l - wheel_y * yaw) / radius
            matrices.append(rear @ placed(wheel_x, wheel_y, radius, steer) @ rotation("Y", roll))
        return matrices + extra[1](rear, l, loop, seconds)

    return Subject(("cart",), parts, pose, focus=(0.0, 0.0, 0.5))


def _trailer(rng, size, radius, tyre):
    """Parts of a trailer with two wheels behind the cart, and their matrices."""
    length, track = 0.34 * size, 0.15 * size
    bed = box(0.34 * size, 0.24 * size, rng.uniform(0.1, 0.2) * size)
    bed_z = radius + bed.vertices[:, 2].max()
    parts = [Part(1, bed, drawn(rng, (8, 16))), Part(1, capsule(0.015, length), tyre)]
    parts += [Part(1, wheel(radius, 0.05 * size), tyre) for _ in range(2)]

    def pose(rear, l, loop, _seconds):
        hitch = rear @ (-0.12 * size, 0, radius, 1)
        dx, dy = hitch[:2] - loop.at(l - 0.12 * size - length)
        yaw = math.atan2(dy, dx)
        axle = hitch[:3] - length * np.array([math.cos(yaw), math.sin(yaw), 0])
        frame = placed(axle[0], axle[1], 0, yaw)
        roll = rotation("Y", (l - 0.12 * size - length) / radius)
        wheels = [frame @ translation(0, side * track, radius) @ roll for side in (-1, 1)]
        return [frame @ translation(0, 0, bed_z), segment(axle, hitch[:3]), *wheels]

    return parts, pose


def _boom(rng, size, cabin_z):
    """Parts of a boom of two arms on the cabin, and their matrices."""
    lengths = rng.uniform(0.22, 0.3, 2) * size
    rates, phases = rng.uniform(1.2, 3.0, 3), rng.uniform(0, 2 * math.pi, 3)
    paint = drawn_pattern(rng, (10, 25))
    parts = [Part(1, capsule(0.035 * size, length), paint) for length in lengths]

    def pose(rear, _l, _loop, seconds):
        swing, lift, bend = np.sin(rates * seconds + phases)
        foot = rear @ translation(0.36 * 0.62 * size, 0, cabin_z + 0.1 * size) @ rotation("Z", 1.2 * swing)
        first, second = 0.9 + 0.35 * lift, -0.5 + 0.6 * bend
        points = [np.zeros(3)]
        for angle, length in zip((first, second), lengths):
            points.append(points[-1] + length * np.array([math.cos(angle), 0, math.sin(angle)]))
        return [foot @ segment(a, b, (0, 1, 0)) for a, b in zip(points, points[1:])]

    return parts, pose
