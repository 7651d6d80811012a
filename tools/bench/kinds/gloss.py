"""Glossy objects under a moving lamp: a ball that rolls, a vase that turns, and two static ones with moving highlights."""

import math

import numpy as np
from materials import PATTERNS, Pattern
from paths import drawn_loop, drawn_travel
from room import Fixed
from shapes import ball, box, lathe
from subject import Lamp, Part, Subject
from transforms import placed, rotation, translation


def make(rng):
    """Ball and vase are instances; the lamp goes round above them, out of the image."""
    radius, stand = rng.uniform(0.15, 0.22), rng.uniform(0.25, 0.45)
    side = rng.choice((-1, 1))
    loop = drawn_loop(rng, (0.4, 0.55), (0.22, 0.3), centre=(-0.4 * side, -0.45), eight=0.0)
    travel, spin = drawn_travel(rng, (0.4, 0.8)), rng.choice((-1, 1)) * rng.uniform(0.6, 2.0)
    at = (0.6 * side, rng.uniform(-0.1, 0.25))
    belly, waist, height = rng.uniform(0.16, 0.22), rng.uniform(0.06, 0.12), rng.uniform(0.45, 0.65)
    outline = [(1e-5, 0), (0.6 * belly, 0), (belly, 0.3 * height), (0.9 * belly, 0.5 * height), (waist, 0.8 * height)]
    # Profiles are smoothed by cubic steps between their corners, so that highlights run over them.
    vase = lathe(_rounded([*outline, (1.5 * waist, height), (1e-5, height)]), 48)
    parts = [Part(1, ball(radius), _glossy(rng)), Part(2, vase, _glossy(rng))]
    fixed = [Fixed(box(0.36, 0.36, stand), _glossy(rng), (*at, stand / 2), (0, 0, rng.uniform(0, 1.5)))]
    big = rng.uniform(0.2, 0.3)
    fixed.append(Fixed(ball(big), _glossy(rng), (-0.5 * side, 0.5, big)))
    reach, lamp_z, period_s, phase = rng.uniform(1.1, 1.6), rng.uniform(2.1, 2.6), rng.uniform(3, 6), rng.uniform(0, 6.28)

    def pose(seconds):
        l = travel(seconds)
        rolling = placed(*loop.at(l), radius, loop.heading(l)) @ rotation("Y", l / radius)
        return [rolling, translation(*at, stand) @ rotation("Z", spin * seconds)]

    def lamp(seconds):
        angle = 2 * math.pi * seconds / period_s + phase
        return np.array([reach * math.cos(angle), -0.4 + 0.8 * reach * math.sin(angle), lamp_z])

    light = Lamp(rng.uniform(140, 220), 0.12, lamp)
    return Subject(("ball", "vase"), parts, pose, fixed, focus=(0.0, 0.0, 0.5), lamp=light, sun=0.3)


def _glossy(rng):
    """A smooth pattern, of metal in two cases of five."""
    first, second = rng.random((2, 3)) * 0.8 + 0.1
    kind = PATTERNS[rng.integers(len(PATTERNS))]
    metallic = 1.0 if rng.random() < 0.4 else 0.0
    return Pattern(kind, tuple(first), tuple(second), rng.uniform(5, 12), rng.uniform(0.05, 0.22), metallic)


def _rounded(profile, steps=6):
    """The corners of `profile` joined by Catmull-Rom curves; radii stay positive."""
    p = np.array([profile[0], *profile, profile[-1]], float)
    u = np.linspace(0, 1, steps, endpoint=False)[:, None]
    curves = []
    for a, b, c, d in zip(p, p[1:], p[2:], p[3:]):
        curves.append(0.5 * (2 * b + (c - a) * u + (2 * a - 5 * b + 4 * c - d) * u**2 + (3 * b - a - 3 * c + d) * u**3))
    curve = np.concatenate([*curves, p[-1:]])
    return np.stack([np.maximum(curve[:, 0], 1e-5), np.clip(curve[:, 1], 0, p[:, 1].max())], 1)
