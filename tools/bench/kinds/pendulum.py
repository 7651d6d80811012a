"""Bobs that swing from a beam and never touch the ground: single ones in a plane or an ellipse, or a double pendulum."""

import math

import numpy as np
from materials import drawn, drawn_pattern
from room import Fixed
from shapes import ball, box, capsule, lathe
from subject import Part, Subject
from transforms import rotation, segment

GRAVITY = 9.81
BEAM_M = 1.95
STEP_S = 1 / 480
ROD_M = 0.018


class Swing:
    """A solution of `rates(state)` from `start` by Runge-Kutta of fourth order with a fixed step, computed as far as needed."""

    def __init__(self, rates, start):
        self.rates, self.states = rates, [np.array(start, float)]

    def at(self, seconds):
        """The state at a time, linear between steps."""
        index, share = divmod(max(seconds, 0.0) / STEP_S, 1.0)
        index = int(index)
        while len(self.states) < index + 2:
            self.states.append(self._next(self.states[-1]))
        return (1 - share) * self.states[index] + share * self.states[index + 1]

    def _next(self, y):
        a = self.rates(y)
        b = self.rates(y + STEP_S / 2 * a)
        c = self.rates(y + STEP_S / 2 * b)
        return y + STEP_S / 6 * (a + 2 * b + 2 * c + self.rates(y + STEP_S * c))


def single(length):
    """Rates of (a, b, a', b') for a bob at length (sin a, cos a sin b, -cos a cos b)."""

    def rates(state):
        a, b, da, db = state
        dda = -math.sin(a) * math.cos(a) * db * db - GRAVITY / length * math.sin(a) * math.cos(b)
        ddb = 2 * math.tan(a) * da * db - GRAVITY / length * math.sin(b) / math.cos(a)
        return np.array([da, db, dda, ddb])

    return rates


def double(length, ratio):
    """Rates of (upper, lower, upper', lower') for two rods of `length`, the lower bob `ratio` times as heavy."""

    def rates(state):
        a, b, da, db = state
        c, s = math.cos(a - b), math.sin(a - b)
        share = ratio / (1 + ratio)
        mass = np.array([[1.0, share * c], [c, 1.0]])
        force = [-share * s * db * db - GRAVITY / length * math.sin(a), s * da * da - GRAVITY / length * math.sin(b)]
        return np.array([da, db, *np.linalg.solve(mass, force)])

    return rates


def make(rng):
    """One to three single pendulums, or a double one; `names` has one object per bob with its rod."""
    is_double, azimuth = rng.random() < 0.3, rng.uniform(0, math.pi)
    fixed = _stand(rng)
    if is_double:
        length, ratio = rng.uniform(0.42, 0.5), rng.uniform(0.5, 1.0)
        start = [rng.uniform(0.5, 1.0), -rng.uniform(0.2, 0.9), 0, 0]
        swing = Swing(double(length, ratio), start)
        parts = [p for i in (1, 2) for p in _bob(rng, i, length, rng.uniform(0.1, 0.15))]
        plane = rotation("Z", azimuth)

        def pose(seconds):
            pivot, matrices = np.array([0, 0, BEAM_M]), []
            for angle in swing.at(seconds)[:2]:
                end = pivot + plane[:3, :3] @ (length * math.sin(angle), 0, -length * math.cos(angle))
                matrices += _rod_and_bob(pivot, end, plane[:3, 1], 0.0)
                pivot = end
            return matrices

        return Subject(("upper bob", "lower bob"), parts, pose, fixed, focus=(0.0, 0.1, 1.0))

    count = rng.integers(1, 4)
    parts, swings = [], []
    for i in range(count):
        length, radius = rng.uniform(0.75, 1.05), rng.uniform(0.13, 0.2)
        # Several swing across the beam, so that they do not meet.
        angle = azimuth if count == 1 else math.pi / 2 + rng.uniform(-0.15, 0.15)
        amplitude, sideways = rng.uniform(0.35, 0.65), rng.uniform(0, 0.8) * (count == 1)
        start = [amplitude * math.cos(angle), amplitude * math.sin(angle)]
        speed = sideways * math.sqrt(GRAVITY / length) * amplitude
        start += [-speed * math.sin(angle), speed * math.cos(angle)]
        twist = (rng.uniform(0.3, 1.5), rng.uniform(1.0, 3.0))
        swings.append(((i - (count - 1) / 2) * 0.62, length, Swing(single(length), start), twist))
        parts += _bob(rng, i + 1, length, radius)

    def pose(seconds):
        matrices = []
        for x, length, swing, (twist, rate) in swings:
            a, b = swing.at(seconds)[:2]
            pivot = np.array([x, 0, BEAM_M])
            end = pivot + length * np.array([math.sin(a), math.cos(a) * math.sin(b), -math.cos(a) * math.cos(b)])
            matrices += _rod_and_bob(pivot, end, (0, 1, 0), twist * math.sin(rate * seconds))
        return matrices

    return Subject(tuple(f"bob {i + 1}" for i in range(count)), parts, pose, fixed, focus=(0.0, 0.1, 1.0))


def _stand(rng):
    """A beam on two posts."""
    wood = drawn_pattern(rng, (10, 30))
    x = 1.45
    posts = [Fixed(box(0.09, 0.09, BEAM_M), wood, (side * x, 0.0, BEAM_M / 2)) for side in (-1, 1)]
    return [*posts, Fixed(box(2 * x + 0.2, 0.09, 0.09), wood, (0, 0, BEAM_M + 0.045))]


def _bob(rng, instance, length, radius):
    """A rod and a ball, box or spindle."""
    form = rng.integers(3)
    if form == 0:
        shape = ball(radius)
    elif form == 1:
        shape = box(1.5 * radius, 1.5 * radius, 1.5 * radius)
    else:
        spindle = [(1e-5, -1.2), (0.7, -0.7), (1.0, 0.0), (0.55, 0.6), (0.25, 1.0), (1e-5, 1.1)]
        shape = lathe([(radius * r, radius * z) for r, z in spindle])
    rod = Part(instance, capsule(ROD_M, length), drawn_pattern(rng, (15, 30)))
    return [rod, Part(instance, shape, drawn(rng, (8, 16)) if form < 2 else drawn_pattern(rng, (8, 16)))]


def _rod_and_bob(pivot, end, forward, twist):
    """Matrices of a rod from `pivot` to `end`, and of the bob at its end, twisted about it."""
    frame = segment(end, pivot, forward)
    bob = frame.copy()
    bob[:3, 3] = end
    return [frame, bob @ rotation("Z", twist)]
