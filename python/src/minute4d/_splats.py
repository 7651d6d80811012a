"""Splats at an instant, from the PLY files that the program exports."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ._errors import Category, Minute4dError

_C0 = 0.28209479177387814
"""The constant harmonic: colour = 1/2 + C0 * coefficient."""


@dataclass(frozen=True)
class Splats:
    """The Gaussians that are visible at an instant, dynamic ones where they are then.

    The opacities include the average effect of the Mip filter on the cameras of the clip, so that
    renderers without this filter show what the scene's own renderer shows.
    """

    positions: NDArray[np.float32]
    """Centres (n, 3), scene units, in the world of the cameras."""
    scales: NDArray[np.float32]
    """Standard deviations along the axes of each splat (n, 3), scene units."""
    rotations: NDArray[np.float32]
    """Rotations of these axes, unit quaternions (w, x, y, z), (n, 4)."""
    opacities: NDArray[np.float32]
    """Opacities (n), 0 to 1."""
    colours: NDArray[np.float32]
    """sRGB colours (n, 3), 0 to 1 if displayable: the part that does not depend on direction."""
    harmonics: NDArray[np.float32]
    """Coefficients of the other spherical harmonics (n, k, 3); k is 0, 3, 8 or 15, in the order of
    3DGS."""

    def __len__(self) -> int:
        return len(self.positions)

    def covariances(self) -> NDArray[np.float32]:
        """Return the covariance matrices (n, 3, 3), squared scene units."""
        w, x, y, z = self.rotations.T
        axes = np.stack(
            [
                1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
                2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
            ],
            axis=-1,
        ).reshape(-1, 3, 3)  # fmt: skip
        half = axes * self.scales[:, None, :]
        covariances: NDArray[np.float32] = half @ half.transpose(0, 2, 1)
        return covariances


def read_ply(path: Path) -> Splats:
    """Read a PLY file of splats as the program writes it: 32-bit numbers, little-endian."""
    data = path.read_bytes()
    head, end, _ = data.partition(b"end_header\n")
    lines = head.decode("ascii", errors="replace").splitlines()
    names = [line.split()[-1] for line in lines if line.startswith("property float ")]
    counts = [int(line.split()[-1]) for line in lines if line.startswith("element vertex ")]
    start = len(head) + len(end)
    if len(counts) != 1 or len(data) != start + 4 * counts[0] * len(names):
        raise Minute4dError(Category.INTERNAL, f"{path}: the layout of the export is unknown")
    table = np.frombuffer(data, "<f4", offset=start).reshape(counts[0], len(names))

    def columns(*wanted: str) -> NDArray[np.float32]:
        return table[:, [names.index(name) for name in wanted]].astype(np.float32)

    rest = sorted((n for n in names if n.startswith("f_rest_")), key=lambda n: int(n[7:]))
    # Channel by channel in the file.
    harmonics = columns(*rest).reshape(counts[0], 3, len(rest) // 3).transpose(0, 2, 1)
    rotations = columns("rot_0", "rot_1", "rot_2", "rot_3")
    opacities = 1 / (1 + np.exp(-columns("opacity")[:, 0].astype(np.float64)))
    return Splats(
        positions=columns("x", "y", "z"),
        scales=np.exp(columns("scale_0", "scale_1", "scale_2")),
        rotations=rotations / np.linalg.norm(rotations, axis=1, keepdims=True),
        opacities=opacities.astype(np.float32),
        colours=(0.5 + _C0 * columns("f_dc_0", "f_dc_1", "f_dc_2")).astype(np.float32),
        harmonics=np.ascontiguousarray(harmonics),
    )
