"""True tracks: points of the dynamic surfaces, followed through the clip."""

import numpy as np

# A point is visible where the depth map is not nearer by more than this: relief within a pixel, and a share of depth.
TOLERANCE_M, TOLERANCE_SHARE = 0.008, 0.008


def drawn_points(vertices, triangles, count, rng):
    """`count` points by area: triangle [n], weights of its corners [n][3]."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = rng.choice(len(triangles), count, p=areas / areas.sum())
    u, v = rng.random((2, count))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    return chosen, np.stack([1 - u - v, u, v], 1)


def area(vertices, triangles):
    """The area of a surface, in square metres."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


def visible(points, c2w, focal_px, depth, instance, own):
    """Which of `points` [n][3] a camera sees, of its depth map (metres) and instance map; `own` [n] are their instances."""
    height, width = depth.shape
    x, y, z = ((points - c2w[:3, 3]) @ c2w[:3, :3]).T
    z = -z
    ahead = np.where(z > 0.05, z, 1.0)
    column = np.floor(width / 2 + focal_px * x / ahead).astype(int)
    row = np.floor(height / 2 - focal_px * y / ahead).astype(int)
    inside = (z > 0.05) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    at = row.clip(0, height - 1), column.clip(0, width - 1)
    near_enough = z <= depth[at] * (1 + TOLERANCE_SHARE) + TOLERANCE_M
    return inside & near_enough & (instance[at] == own)


class Tracks:
    """Points of every instance of a stage, `count` each, shared among its parts by area."""

    def __init__(self, stage, count, rng):
        self.stage, self.choices = stage, []
        parts = stage.scene.subject.parts
        surfaces = [stage.surface(i) for i in range(len(parts))]
        areas = np.array([area(*surface) for surface in surfaces])
        instances = np.array([part.instance for part in parts])
        for i, surface in enumerate(surfaces):
            own = max(round(count * areas[i] / areas[instances == instances[i]].sum()), 1)
            self.choices.append(drawn_points(*surface, own, rng))
        counts = [len(chosen) for chosen, _ in self.choices]
        self.instance = np.repeat(instances, counts).astype(np.uint8)
        self.part = np.repeat(np.arange(len(parts)), counts).astype(np.uint16)

    def points(self):
        """The points [n][3] in the world as the stage shows them."""
        all_points = []
        for i, (chosen, weights) in enumerate(self.choices):
            vertices, triangles = self.stage.surface(i)
            all_points.append((vertices[triangles[chosen]] * weights[..., None]).sum(1))
        return np.concatenate(all_points)
