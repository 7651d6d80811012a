"""Closed paths on the ground by arc length, and quantities that vary smoothly along them."""

import math

import numpy as np

SAMPLES = 4096
# Headings are differences of positions so far ahead and behind.
REACH_M = 0.02


class ClosedPath:
    """A closed curve through `points` [n][2], by arc length in metres; lengths beyond a lap go on with the next."""

    def __init__(self, points):
        ring = np.concatenate([points, points[:1]])
        self.points = ring
        self.lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ring, axis=0), axis=1))])
        self.length_m = self.lengths[-1]
        raw = np.array([self._direction(l) for l in self.lengths[:-1]])
        self.angles = np.unwrap(np.append(raw, raw[0]))

    def at(self, l):
        """The point (x, y) at arc length `l`."""
        l = l % self.length_m
        return np.array([np.interp(l, self.lengths, self.points[:, k]) for k in (0, 1)])

    def heading(self, l):
        """The angle of the direction of travel to the x axis, continuous over laps."""
        laps, rest = divmod(l, self.length_m)
        return laps * (self.angles[-1] - self.angles[0]) + np.interp(rest, self.lengths, self.angles)

    def curvature(self, l):
        """Radians per metre, positive to the left."""
        return (self.heading(l + 3 * REACH_M) - self.heading(l - 3 * REACH_M)) / (6 * REACH_M)

    def beside(self, l, left):
        """The point `left` metres to the left of the path."""
        angle = self.heading(l)
        return self.at(l) + left * np.array([-math.sin(angle), math.cos(angle)])

    def _direction(self, l):
        dx, dy = self.at(l + REACH_M) - self.at(l - REACH_M)
        return math.atan2(dy, dx)


def drawn_loop(rng, x_range, y_range, centre=(0.0, -0.1), eight=0.4):
    """An ellipse, or with probability `eight` a figure of eight, with drawn half axes, direction and start."""
    a, b = rng.uniform(*x_range), rng.uniform(*y_range)
    turn = rng.choice((-1, 1)) * np.linspace(0, 2 * math.pi, SAMPLES, endpoint=False) + rng.uniform(0, 2 * math.pi)
    is_eight = rng.random() < eight
    y = np.sin(2 * turn) if is_eight else np.sin(turn)
    return ClosedPath(np.stack([centre[0] + a * np.cos(turn), centre[1] + b * y], 1))


def drawn_travel(rng, speed_range):
    """A function of seconds to metres travelled: a drawn mean speed, which rises and falls by up to half."""
    speed, share, period_s = rng.uniform(*speed_range), rng.uniform(0.1, 0.5), rng.uniform(2.0, 4.0)
    rate, phase = 2 * math.pi / period_s, rng.uniform(0, 2 * math.pi)
    return lambda s: speed * (s + share / rate * (math.sin(rate * s + phase) - math.sin(phase)))
