"""A pinwheel that turns fast, and a ball that rolls in front of it."""

import math

from materials import Pattern
from room import Fixed
from shapes import cylinder, plane, sphere
from subject import Part, Subject
from transforms import rotation, scaling, translation

COLOURS = ((0.9, 0.1, 0.1), (0.1, 0.6, 0.2), (0.1, 0.3, 0.9), (0.95, 0.8, 0.1), (0.7, 0.2, 0.8), (0.1, 0.8, 0.8))
TURNS = 2.2
BALL_M = 0.2


def make(_rng, clip_s):
    """Six blades (one object) and a ball; nothing is drawn."""
    parts, blades = [], []
    for i, colour in enumerate(COLOURS):
        dark = tuple(0.35 * c for c in colour)
        parts.append(Part(1, plane(0.5), Pattern(("voronoi", "checker")[i % 2], colour, dark, 14)))
        tilted = translation(0.36, 0, 0) @ rotation("X", math.radians(70)) @ scaling(1, 0.55, 1)
        blades.append(rotation("Y", i * math.pi / 3) @ tilted)
    parts.append(Part(2, sphere(BALL_M, 48), Pattern("voronoi", (0.95,) * 3, (0.05,) * 3, 5)))
    post = Fixed(cylinder(0.04, 1.2), Pattern("noise", (0.5, 0.3, 0.1), (0.3, 0.15, 0.05), 30), (0, 0.14, 0.6))

    def pose(seconds):
        t = seconds / clip_s
        hub = translation(0, 0, 1.2) @ rotation("Y", 2 * math.pi * TURNS * t)
        x = -1.4 + 2.8 * t
        return [*(hub @ blade for blade in blades), translation(x, -0.7, BALL_M) @ rotation("Y", x / BALL_M)]

    return Subject(("pinwheel", "ball"), parts, pose, [post])
