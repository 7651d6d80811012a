"""Surfaces as data, in coordinates of their own (metres). `stage.py` makes Blender's objects of them."""

import math
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Primitive:
    """A primitive of Blender: `kind` is plane, cube, uv_sphere or cylinder, `arguments` those of the operator."""

    kind: str
    arguments: dict
    smooth: bool = False


@dataclass(frozen=True)
class ObjFile:
    """A Wavefront OBJ file that holds one object, y forward and z up."""

    path: str


@dataclass(frozen=True)
class Mesh:
    """Vertices [n][3], faces as lists of indices, texture coordinates [n][2]."""

    vertices: np.ndarray = field(repr=False)
    faces: list = field(repr=False)
    uv: np.ndarray = field(repr=False)
    smooth: bool = True


def plane(size):
    return Primitive("plane", {"size": size})


def cube(size):
    return Primitive("cube", {"size": size})


def cylinder(radius, depth):
    return Primitive("cylinder", {"radius": radius, "depth": depth})


def sphere(radius, segments=32):
    return Primitive("uv_sphere", {"radius": radius, "segments": segments, "ring_count": segments // 2}, smooth=True)


def box(x, y, z):
    """A box around the origin with these edges; every face shows the whole texture."""
    vertices, faces, uv = [], [], []
    for axis in range(3):
        for side in (-0.5, 0.5):
            for u, v in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)):
                vertices.append(np.roll([side, u, v], axis))
                uv.append((u + 0.5, v + 0.5))
            corners = list(range(len(vertices) - 4, len(vertices)))
            faces.append(corners if side > 0 else corners[::-1])
    return Mesh(np.array(vertices) * (x, y, z), faces, np.array(uv), smooth=False)


def grid(points, closed=False, smooth=True):
    """A surface through `points` [rows][columns][3]; `closed`: the last column is the first one again."""
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    faces = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], -1).reshape(-1, 4)
    v, u = np.mgrid[0:rows, 0:columns]
    uv = np.stack([u / (columns - 1) * (2 if closed else 1), v / (rows - 1)], -1)
    return Mesh(points.reshape(-1, 3), faces.tolist(), uv.reshape(-1, 2), smooth)


def lathe(profile, segments=32, smooth=True):
    """The surface of revolution about z of a `profile` of (radius, z), from the bottom up."""
    turn = np.linspace(0, 2 * math.pi, segments + 1)
    radius, z = np.array(profile, float).T
    points = np.stack([radius[:, None] * np.cos(turn), radius[:, None] * np.sin(turn), z[:, None] + 0 * turn], -1)
    return grid(points, closed=True, smooth=smooth)


def capsule(radius, length):
    """A capsule along z around the origin; `length` is that of the axis between the centres of its ends."""
    cap = np.linspace(0, math.pi / 2, 9)
    top = np.stack([radius * np.cos(cap), length / 2 + radius * np.sin(cap)], 1)
    top[-1, 0] = POLE_M
    return lathe(np.concatenate([top[::-1] * (1, -1), top]), 24)


def ball(radius):
    """A sphere with texture coordinates."""
    angle = np.linspace(-math.pi / 2, math.pi / 2, 33)
    profile = np.stack([np.maximum(radius * np.cos(angle), POLE_M), radius * np.sin(angle)], 1)
    return lathe(profile, 48)


def wheel(radius, width):
    """A wheel whose axle is y."""
    rim = [(POLE_M, -width / 2), (0.6 * radius, -width / 2), (0.65 * radius, -0.35 * width), (0.8 * radius, -0.35 * width)]
    rim += [(0.85 * radius, -width / 2), (radius, -width / 2)]
    mesh = lathe(rim + [(r, -z) for r, z in rim[::-1]], 40, smooth=False)
    return Mesh(mesh.vertices[:, [0, 2, 1]] * (1, -1, 1), mesh.faces, mesh.uv, smooth=False)


# The radius of the rings at the poles of a surface of revolution: small, and no fan of triangles is needed.
POLE_M = 1e-5
