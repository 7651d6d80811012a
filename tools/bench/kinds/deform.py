"""A deforming object: a cloth that waves from a bar, a jelly that wobbles or hops, or a worm that winds along a path."""

import math

import numpy as np
from materials import PHOTOS, Photo, drawn, drawn_pattern
from paths import SAMPLES, ClosedPath, drawn_loop
from room import Fixed
from shapes import ball, box, grid
from subject import Part, Subject

GRAVITY = 9.81


def make(rng):
    """One instance, whose vertices are a function of time; the matrix of its part is the identity."""
    return (_cloth, _jelly, _worm)[rng.integers(3)](rng)


def _subject(name, shape, material, vertices, **more):
    part = Part(1, shape, material, vertices)
    return Subject((name,), [part], lambda _seconds: [np.eye(4)], **more)


def _cloth(rng):
    """A sheet pinned to a bar; travelling waves grow from the bar to the free edge."""
    width, drop, bar_z, yaw = rng.uniform(1.0, 1.5), rng.uniform(0.8, 1.1), rng.uniform(1.6, 1.8), rng.uniform(-0.4, 0.4)
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 41), np.linspace(0, 1, 31))
    waves = []
    for i in range(4):
        across, along = rng.uniform(-6, 6), rng.uniform(2, 5)
        waves.append((rng.uniform(0.07, 0.13) / (1 + 0.3 * i), across, along, rng.uniform(2.5, 6), rng.uniform(0, 6.28)))
    gust, gust_phase = rng.uniform(0.8, 1.6), rng.uniform(0, 6.28)
    cos, sin = math.cos(yaw), math.sin(yaw)

    def points(seconds):
        wind = 1 + 0.4 * math.sin(gust * seconds + gust_phase)
        phases = [across * u + along * v - rate * seconds + phase for _, across, along, rate, phase in waves]
        out = wind * v**1.2 * sum(wave[0] * np.cos(phase) for wave, phase in zip(waves, phases))
        sway = 0.5 * wind * v * sum(wave[0] * np.sin(phase) for wave, phase in zip(waves, phases))
        x = width * u + sway
        # What hangs out of the plane hangs less far down.
        z = bar_z - drop * v * np.sqrt(1 - np.minimum(np.abs(out) / drop, 0.9) ** 2)
        return np.stack([cos * x - sin * out, sin * x + cos * out, z], -1)

    wood = drawn_pattern(rng, (10, 30))
    ends = [(side * (width / 2 + 0.08) * cos, side * (width / 2 + 0.08) * sin) for side in (-1, 1)]
    fixed = [Fixed(box(0.06, 0.06, bar_z + 0.03), wood, (x, y, (bar_z + 0.03) / 2), (0, 0, yaw)) for x, y in ends]
    fixed.append(Fixed(box(width + 0.22, 0.05, 0.05), wood, (0, 0, bar_z + 0.025), (0, 0, yaw)))
    material = Photo(PHOTOS[rng.integers(5)]) if rng.random() < 0.6 else drawn_pattern(rng, (5, 12), "UV")
    # Photographs have their first row at the top: v of the texture runs upward.
    sheet = grid(points(0.0)[::-1])
    return _subject("cloth", sheet, material, lambda s: points(s)[::-1].reshape(-1, 3), fixed=fixed, focus=(0, 0.1, 0.95))


def _jelly(rng):
    """A ball with oscillating modes of its shape, squashed at constant volume; it hops in two cases of three."""
    radius = rng.uniform(0.3, 0.42)
    shape = ball(1.0)
    x, y, z = shape.vertices.T
    forms = np.stack([x * x - y * y, x * z, y * z, x * y, z * (5 * z * z - 3) / 2, x * (5 * z * z - 1) / 2])
    sizes, rates, phases = rng.uniform(0.04, 0.12, 6), rng.uniform(3, 9, 6), rng.uniform(0, 6.28, 6)
    hops = rng.random() < 2 / 3
    air_s, ground_s, squash = rng.uniform(0.3, 0.42), rng.uniform(0.35, 0.6), rng.uniform(0.15, 0.3)
    loop, step = drawn_loop(rng, (0.35, 0.6), (0.2, 0.3), eight=0.0), rng.uniform(0.25, 0.45)
    turn = rng.uniform(-0.6, 0.6)
    material = drawn(rng, (5, 12), "UV")

    def vertices(seconds):
        hop, phase_s = divmod(seconds, air_s + ground_s)
        in_air_s = phase_s - ground_s
        if not hops:
            flat, up, progress = 0.1 * math.sin(5 * seconds), 0.0, 0.0
        elif in_air_s < 0:
            flat, up, progress = squash * math.sin(math.pi * phase_s / ground_s), 0.0, hop
        else:
            flat = -0.4 * squash * math.sin(math.pi * in_air_s / air_s)
            up, progress = GRAVITY / 2 * in_air_s * (air_s - in_air_s), hop + in_air_s / air_s
        size = radius * (1 + (sizes * np.cos(rates * seconds + phases)) @ forms)[:, None]
        p = shape.vertices * size * (1 / math.sqrt(1 - flat), 1 / math.sqrt(1 - flat), 1 - flat)
        angle = turn * seconds
        cos, sin = math.cos(angle), math.sin(angle)
        centre = loop.at(step * progress)
        # It stands on a flat foot: the lowest part is pressed to a plane.
        foot = 0.85 * p[:, 2].min()
        z = np.maximum(p[:, 2], foot) - foot + up
        return np.stack([cos * p[:, 0] - sin * p[:, 1] + centre[0], sin * p[:, 0] + cos * p[:, 1] + centre[1], z], 1)

    return _subject("jelly", shape, material, vertices, focus=(0.0, 0.0, 0.5))


def _worm(rng):
    """A tube that follows a winding closed path, every ring on the track of the head."""
    waves, depth = rng.integers(4, 7), rng.uniform(0.12, 0.2)
    a, b, start = rng.uniform(0.65, 0.9), rng.uniform(0.33, 0.42), rng.uniform(0, 6.28)
    turn = rng.choice((-1, 1)) * np.linspace(0, 2 * math.pi, SAMPLES, endpoint=False) + start
    ripple = 1 + depth * np.sin(waves * turn)
    path = ClosedPath(np.stack([a * ripple * np.cos(turn), b * ripple * np.sin(turn) - 0.1], 1))
    length, radius, speed = rng.uniform(1.0, 1.5), rng.uniform(0.075, 0.115), rng.uniform(0.4, 0.9)
    breath, breath_rate = rng.uniform(0.1, 0.2), rng.uniform(4, 8)
    along = np.linspace(0, 1, 64)
    taper = radius * np.clip(np.minimum(np.sqrt(np.maximum(along, 0) / 0.06), np.sqrt((1 - along) / 0.35)), 1e-3, 1)
    around = np.linspace(0, 2 * math.pi, 21)

    def points(seconds):
        lengths = speed * seconds - length * along
        wide = taper * (1 + breath * np.sin(breath_rate * seconds - 14 * along))
        centre = np.array([path.at(l) for l in lengths])
        angle = np.array([path.heading(l) for l in lengths])
        side = np.stack([-np.sin(angle), np.cos(angle)], 1)
        ring = centre[:, None, :] + (wide[:, None] * np.cos(around))[..., None] * side[:, None, :]
        return np.concatenate([ring, (wide[:, None] * (1 + np.sin(around)))[..., None]], -1)

    material = drawn_pattern(rng, (10, 20), "UV")
    vertices = lambda s: points(s).reshape(-1, 3)
    return _subject("worm", grid(points(0.0), closed=True), material, vertices, focus=(0.0, 0.0, 0.45))
