"""The static part of a scene: ground, walls, posters, props and light, drawn from the generator of the scene.

The room is 3 m around the origin, where the objects move: x to the right, y away from the camera, z up. Objects have
the ground for x in -1.5..1.5 and y in -1.15..0.95 for themselves.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from materials import PATTERNS, PHOTOS, SURFACES, Pattern, Photo, drawn, drawn_pattern
from shapes import Primitive, cube, cylinder, plane
from transforms import euler, translation

UPRIGHT = math.pi / 2


@dataclass
class Fixed:
    """A static object: shape, material, position, Euler angles XYZ."""

    shape: object
    material: object
    position: tuple
    angles: tuple = (0.0, 0.0, 0.0)

    def matrix(self):
        return translation(*self.position) @ euler(*self.angles)


@dataclass
class Room:
    """Static objects, a sun (Euler angles, strength in W/m^2) and a sky (RGB, strength)."""

    fixed: list = field(default_factory=list)
    sun_angles: tuple = (0.0, 0.0, 0.0)
    sun_w: float = 2.6
    sky: tuple = (0.75, 0.85, 1.0)
    sky_w: float = 0.7


def original(seed, rng):
    """The room of the kinds `mill`, `quad` and `toys`; the order of the draws is part of those scenes."""
    ground = SURFACES[seed % 3]
    wall = ("brick.png", "gravel.png", "brick.png")[seed % 3]
    side = "coins.png" if seed % 2 else "text.png"
    room = Room()
    put = lambda *fixed: room.fixed.append(Fixed(*fixed))
    put(plane(10), Photo(ground, 5), (0, 0, 0))
    put(plane(10), Photo(wall, 3), (0, 3.2, 2), (UPRIGHT, 0, 0))
    put(plane(10), Photo(side, 2), (-4.2, 0, 2), (UPRIGHT, 0, UPRIGHT))
    for i, x in enumerate((-2.2, -0.4, 1.5)):
        size = 1.1 + 0.3 * rng.random()
        put(plane(size), Photo(PHOTOS[(seed + 2 * i) % 6]), (x, 3.15, 1.2 + 0.5 * rng.random()), (UPRIGHT, 0, 0))
    for i in range(7):
        x, y, half = rng.uniform(-2.6, 2.6), rng.uniform(1.1, 2.7), rng.uniform(0.15, 0.45)
        first, second = rng.random(3) * 0.8 + 0.1, rng.random(3) * 0.8 + 0.1
        material = Pattern(PATTERNS[i % 3], tuple(first), tuple(second), rng.uniform(4, 14))
        put(_prop(i % 3, half), material, (x, y, half), (0, 0, rng.uniform(0, 3)))
    room.sun_angles = (math.radians(40), math.radians(20), rng.uniform(0, 1))
    return room


def varied(rng):
    """A room of the other kinds: walls at other distances, other surfaces, more or fewer props, another sun."""
    room = Room()
    put = lambda *fixed: room.fixed.append(Fixed(*fixed))
    surface = lambda low, high: Photo(SURFACES[rng.integers(3)], rng.uniform(low, high))
    back_m, side_m, side = rng.uniform(2.9, 3.8), rng.uniform(3.6, 4.8), rng.choice((-1, 1))
    put(plane(12), surface(4, 8), (0, 0, 0))
    put(plane(12), surface(2, 5), (0, back_m, 2), (UPRIGHT, 0, 0))
    put(plane(12), surface(2, 5) if rng.random() < 0.5 else Photo("coins.png", 3), (side * side_m, 0, 2), (UPRIGHT, 0, UPRIGHT))
    for x in np.arange(-2.4, 2.5, rng.uniform(1.5, 2.4)):
        size, z = rng.uniform(0.8, 1.4), rng.uniform(1.1, 1.8)
        put(plane(size), Photo(PHOTOS[rng.integers(6)]), (x + rng.uniform(-0.2, 0.2), back_m - 0.05, z), (UPRIGHT, 0, 0))
    for _ in range(rng.integers(5, 11)):
        half, form = rng.uniform(0.12, 0.4), rng.integers(3)
        x, y = rng.uniform(-2.6, 2.6), rng.uniform(0.95 + 1.42 * half, back_m - half - 0.1)
        material = drawn(rng, (4, 12)) if form == 0 else drawn_pattern(rng, (4, 12))
        put(_prop(form, half), material, (x, y, half), (0, 0, rng.uniform(0, 3)))
    # In some rooms a post in front of the objects hides them at times.
    if rng.random() < 0.3:
        x, height = rng.choice((-1, 1)) * rng.uniform(0.4, 0.9), rng.uniform(0.4, 0.8)
        put(cylinder(0.04, height), drawn_pattern(rng, (8, 20)), (x, rng.uniform(-1.4, -1.2), height / 2))
    room.sun_angles = (math.radians(rng.uniform(25, 50)), math.radians(rng.uniform(-25, 25)), rng.uniform(-1, 1))
    room.sun_w = rng.uniform(2.0, 3.2)
    warmth = rng.uniform(-0.15, 0.15)
    room.sky, room.sky_w = (0.85 + warmth, 0.85, 0.85 - warmth), rng.uniform(0.5, 0.9)
    return room


def _prop(form, half):
    """A cube, cylinder or sphere of `half` the given size."""
    if form == 2:
        return Primitive("uv_sphere", {"radius": half}, smooth=True)
    return cube(2 * half) if form == 0 else cylinder(half, 2 * half)
