"""Two objects in contact: a frame that pushes a crate to and fro, or a carrier with a load on its turntable."""

import math

from materials import drawn, drawn_pattern
from paths import drawn_loop, drawn_travel
from shapes import ball, box, cylinder, lathe, wheel
from subject import Part, Subject
from transforms import placed, rotation, translation


def make(rng):
    """Two instances each: the object that moves by itself, and the object that it moves."""
    return _push(rng) if rng.random() < 0.5 else _carry(rng)


def pushed(position, reach, play):
    """Where a crate is that a frame with `play` on both sides moves by oscillating in -`reach`..`reach`.

    `position` is (position, is it going forward) of the frame; the crate starts at the end of a stroke backward.
    """
    centre, forward = position
    return max(play - reach, centre - play) if forward else min(reach - play, centre + play)


def _push(rng):
    size, yaw = rng.uniform(1.1, 1.6), rng.uniform(-0.6, 0.6)
    reach, play, period_s = rng.uniform(0.4, 0.6), rng.uniform(0.06, 0.16), rng.uniform(2.6, 4.5)
    y, phase = rng.uniform(-0.35, 0.0), rng.uniform(0.0, 0.25)
    crate = (rng.uniform(0.24, 0.36) * size, rng.uniform(0.24, 0.36) * size, rng.uniform(0.2, 0.36) * size)
    plate, inner = 0.05 * size, crate[0] / 2 + play
    height = crate[2] + 0.16 * size
    paint, load = drawn_pattern(rng, (8, 16)), drawn(rng, (8, 16))
    side = box(plate, 0.44 * size, height)
    rail = box(2 * inner + 2 * plate, 0.08 * size, plate)
    parts = [Part(1, side, paint), Part(1, side, paint), Part(1, rail, drawn_pattern(rng, (8, 16)))]
    parts.append(Part(2, box(*crate), load))

    def pose(seconds):
        cycle = (seconds / period_s + phase) % 1.0
        frame = -reach * math.cos(2 * math.pi * cycle)
        along = pushed((frame, cycle < 0.5), reach, play)
        ground = placed(0, y, 0, yaw)
        at = lambda x, z: ground @ translation(x, 0, z)
        ends = [at(frame + k * (inner + plate / 2), height / 2) for k in (-1, 1)]
        return [*ends, at(frame, height + plate / 2), at(along, crate[2] / 2)]

    return Subject(("frame", "crate"), parts, pose, focus=(0.0, 0.0, 0.5))


def _carry(rng):
    size = rng.uniform(1.3, 1.9)
    loop, travel = drawn_loop(rng, (0.6, 0.9), (0.3, 0.4)), drawn_travel(rng, (0.35, 0.7))
    spin = rng.choice((0.0, 1.0)) * rng.choice((-1, 1)) * rng.uniform(0.5, 1.4)
    radius, base, track = 0.07 * size, 0.28 * size, 0.15 * size
    deck = box(0.46 * size, 0.3 * size, 0.08 * size)
    deck_z = radius + 0.07 * size
    table_z = deck_z + 0.04 * size + 0.02 * size
    tyre = drawn_pattern(rng, (12, 20))
    wheels = [(side_x * base / 2, side_y * track) for side_x in (-1, 1) for side_y in (-1, 1)]
    parts = [Part(1, deck, drawn(rng, (8, 16))), Part(1, cylinder(0.13 * size, 0.04 * size), drawn_pattern(rng, (10, 20)))]
    parts += [Part(1, wheel(radius, 0.05 * size), tyre) for _ in wheels]
    shape, rest_z = _load(rng, size)
    parts.append(Part(2, shape, drawn(rng, (8, 16))))
    load_z = table_z + 0.02 * size + rest_z

    def pose(seconds):
        l = travel(seconds)
        (x, y), yaw = loop.at(l), loop.heading(l)
        frame = placed(x, y, 0, yaw)
        turned = rotation("Z", spin * seconds)
        matrices = [frame @ translation(0, 0, deck_z), frame @ translation(0, 0, table_z) @ turned]
        for wheel_x, wheel_y in wheels:
            roll = rotation("Y", (l - wheel_y * yaw) / radius)
            matrices.append(frame @ translation(wheel_x, wheel_y, radius) @ roll)
        return [*matrices, frame @ translation(0, 0, load_z) @ turned]

    return Subject(("carrier", "load"), parts, pose, focus=(0.0, 0.0, 0.55))


def _load(rng, size):
    """A box, a ball or a vase, and the height of its origin over its base."""
    form, half = rng.integers(3), rng.uniform(0.11, 0.17) * size
    if form == 0:
        edges = (2 * half, rng.uniform(1.4, 2.0) * half, rng.uniform(1.6, 3.0) * half)
        return box(*edges), edges[2] / 2
    if form == 1:
        return ball(half), half
    vase = [(1e-5, 0), (0.6, 0), (1.0, 0.8), (0.85, 1.5), (0.4, 2.1), (0.6, 2.5), (1e-5, 2.5)]
    return lathe([(half * r, half * z) for r, z in vase]), 0.0
