"""A scene file read by its description alone: numpy and the layout of safetensors.

Nothing of the program is used, so that what a tool finds in an exported file is compared with the scene
and not with our own idea of the export.
"""

import json
import pathlib
import struct

import numpy as np

# y and z of a world with y down and z forward, in one with y up and z back
TURN = np.array([1.0, -1.0, -1.0])
C0 = 0.28209479177387814
TYPES = {"F32": "<f4", "F64": "<f8", "U32": "<u4", "U8": "u1"}


class Scene:
    def __init__(self, path):
        path = pathlib.Path(path)
        if path.is_dir():
            path = path / "scene.safetensors"
        raw = path.read_bytes()
        (length,) = struct.unpack("<Q", raw[:8])
        header = json.loads(raw[8 : 8 + length])
        facts = json.loads(header.pop("__metadata__")["minute4d_scene"])["scene"]
        body = memoryview(raw)[8 + length :]

        def array(name):
            info = header[name]
            start, end = info["data_offsets"]
            return np.frombuffer(body[start:end], TYPES[info["dtype"]]).reshape(info["shape"]).astype(np.float64)

        self.frames = facts["time_frames"]
        self.duration_s = facts["duration_s"]
        self.still = facts["splats_static"]
        self.degree = facts["sh_degree"]
        if facts["isotropic"] or facts["time_degree"] or facts.get("splats_bound"):
            raise SystemExit("scenes with isotropic splats, harmonics of time or splats that nodes carry are not compared")
        self.mean = array("splats.mean")
        self.scale = np.exp(array("splats.log_scale"))
        quat = array("splats.quat")
        self.quat = quat / np.linalg.norm(quat, axis=1, keepdims=True)
        self.opacity = 1 / (1 + np.exp(-array("splats.opacity")))
        # [n][terms][3]
        self.colour = array("splats.colour")[:, 0]
        self.middle = array("splats.time_mean")
        self.sd = np.exp(array("splats.log_time_sd"))
        self.velocity = array("splats.velocity")
        self.intrinsics = array("source.intrinsics")
        self.c2w = array("source.c2w")
        self.t = array("source.t")
        self.count = len(self.mean)

    def step_s(self):
        """Seconds from one frame to the next."""
        return self.duration_s / (self.frames - 1) if self.duration_s else 1 / 30

    def at(self, t):
        """Mean and opacity of every splat at frame t; an opacity of 0 is not drawn."""
        dt = t - self.middle
        mean = self.mean.copy()
        mean[self.still :] += self.velocity * dt[:, None]
        marginal = np.exp(-0.5 * (dt / self.sd) ** 2)
        opacity = self.opacity.copy()
        opacity[self.still :] *= np.where(marginal > 0.05, marginal, 0.0)
        return mean, opacity

    def instant(self, t):
        """Rows that frame t sees, with their means and opacities there."""
        mean, opacity = self.at(t)
        seen = opacity >= 1 / 255
        # still splats are kept however faint they are
        seen[: self.still] = True
        rows = np.flatnonzero(seen)
        return rows, mean[rows], opacity[rows]

    def pixels(self, frame, points):
        """Where points of the world are in a source frame, from the corner of the picture, and their depth."""
        _, _, fx, fy, cx, cy = self.intrinsics[frame]
        rotation, place = self.c2w[frame][:, :3], self.c2w[frame][:, 3]
        p = (points - place) @ rotation
        return np.stack([fx * p[:, 0] / p[:, 2] + cx, fy * p[:, 1] / p[:, 2] + cy], 1), p[:, 2]


def rotations(quat):
    """Matrices of quaternions (w, x, y, z)."""
    w, x, y, z = (quat / np.linalg.norm(quat, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def covariances(scale, quat, turned=False):
    """Covariance matrices, of turned worlds if so asked."""
    r = rotations(quat)
    if turned:
        r = TURN[None, :, None] * r
    return np.einsum("nij,nj,nkj->nik", r, scale**2, r)
