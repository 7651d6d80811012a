"""The results of a run or a capture as arrays."""

from __future__ import annotations

import json
import os
import struct
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _png
from ._errors import Category, Minute4dError
from ._events import Events
from ._program import program
from ._splats import Splats, read_ply

_DEFAULT_FPS = 30.0
"""Frames per second of scenes without a duration, as in the program."""


@dataclass(frozen=True)
class Cameras:
    """Pinhole cameras with images of one size.

    Arrays are converted to float64; `ValueError` for other shapes.
    """

    intrinsics: NDArray[np.float64]
    """Matrices K (n, 3, 3), pixels; pixel centres are at half numbers."""
    c2w: NDArray[np.float64]
    """Camera to world (n, 4, 4), translation in scene units; OpenCV axes."""
    width: int
    """Pixels."""
    height: int
    """Pixels."""

    def __post_init__(self) -> None:
        for name, shape in (("intrinsics", (3, 3)), ("c2w", (4, 4))):
            value = np.asarray(getattr(self, name), np.float64)
            if value.ndim != 3 or value.shape[1:] != shape:
                raise ValueError(f"{name} has shape {value.shape}; (n, {shape[0]}, {shape[1]}) is needed")
            object.__setattr__(self, name, value)
        if len(self.intrinsics) != len(self.c2w):
            raise ValueError(f"{len(self.intrinsics)} intrinsics for {len(self.c2w)} poses")

    def __len__(self) -> int:
        return len(self.c2w)

    def __getitem__(self, which: Union[int, slice, Sequence[int], NDArray[Any]]) -> Cameras:
        """Return a selection; a single number selects one camera."""
        index = [which] if isinstance(which, (int, np.integer)) else which
        return Cameras(self.intrinsics[index], self.c2w[index], self.width, self.height)


class Scene:
    """The results in a folder: cameras, depth and masks of a capture, and splats if trained.

    Made by `load`.
    """

    folder: Path
    """The folder."""
    cameras: Cameras
    """Cameras of the n training frames: those of the splats if there are any (they differ from
    those of the capture only if training refined them), else those of the capture."""
    times: NDArray[np.float64]
    """Times of these frames (n), seconds from the first."""
    duration_s: float
    """Seconds from the first to the last frame."""
    metric: Union[bool, None]
    """Whether a scene unit is a metre; None without a capture."""
    image_paths: list[Path]
    """Images of these frames, PNG or JPEG; empty without a capture."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.metric = None
        self.image_paths = []
        self._splats_file = folder / "scene.safetensors"
        self._trained = self._splats_file.is_file()
        self._capture = folder / "capture" if (folder / "capture").is_dir() else folder
        self._frames: list[dict[str, Any]] = []
        self._depth_unit = 0.0
        listed = self._capture / "transforms_train.json"
        if listed.is_file():
            self._read_capture(listed)
        if self._trained:
            self._read_scene(self._splats_file)
        elif not self._frames:
            raise Minute4dError(
                Category.NO_INPUT,
                f"{folder}: it has neither scene.safetensors nor a capture (transforms_train.json); "
                "give the output folder of a run, or a capture",
            )

    def __repr__(self) -> str:
        kind = "splats" if self._trained else "no splats"
        return f"<minute4d.Scene {str(self.folder)!r}: {len(self.times)} frames, {kind}>"

    @cached_property
    def depth(self) -> NDArray[np.float32]:
        """Depth along the camera's z axis (n, height, width), scene units; NaN where unknown."""
        steps = self._maps("depth_file_path").astype(np.float32)
        steps[steps == 0] = np.nan
        return steps * np.float32(self._depth_unit)

    @cached_property
    def masks(self) -> NDArray[np.bool_]:
        """Masks (n, height, width): True where the scene is dynamic."""
        return np.asarray(self._maps("mask_path") >= 128)

    def render(
        self, cameras: Cameras, times: ArrayLike, *, device: str = "auto"
    ) -> NDArray[np.uint8]:
        """Render the splats: n images (n, height, width, 3), sRGB.

        ``times`` in seconds, one number or one per camera; a single camera is used for all times.
        ``device`` as in ``minute4d render --help``. Raises `Minute4dError` for times outside the
        clip, and without splats.
        """
        moments = np.atleast_1d(np.asarray(times, np.float64))
        if moments.ndim != 1:
            raise ValueError(f"times have shape {moments.shape}; (n) is needed")
        n = len(moments) if len(cameras) == 1 else len(cameras)
        if len(moments) not in (1, n) or n == 0:
            raise ValueError(f"{len(moments)} times for {len(cameras)} cameras")
        moments = np.broadcast_to(moments, n)
        intrinsics = np.broadcast_to(cameras.intrinsics, (n, 3, 3))
        if np.any(intrinsics[:, [0, 1, 2, 2], [1, 0, 0, 1]]) or np.any(intrinsics[:, 2, 2] != 1):
            raise ValueError("intrinsics are not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
        if not (np.isfinite(intrinsics).all() and np.isfinite(cameras.c2w).all()):
            raise ValueError("a camera has a NaN or infinite value")
        shares = [self._frame(t) / max(self._time_frames - 1, 1) for t in moments.tolist()]
        frames = [
            {
                "transform_matrix": c2w.tolist(),
                "time": share,
                "fl_x": float(k[0, 0]),
                "fl_y": float(k[1, 1]),
                "cx": float(k[0, 2]),
                "cy": float(k[1, 2]),
                "w": cameras.width,
                "h": cameras.height,
            }
            for k, c2w, share in zip(
                intrinsics, np.broadcast_to(cameras.c2w, (n, 4, 4)), shares, strict=True
            )
        ]
        with tempfile.TemporaryDirectory(prefix="minute4d-") as name:
            path, out = Path(name, "cameras.json"), Path(name, "images")
            path.write_text(json.dumps({"axes": "opencv", "frames": frames}))
            options = [f"--path={path}", f"--out={out}", f"--device={device}"]
            self._command("render", options)
            return _png.read(sorted(out.glob("*.png")))

    def splats(self, time: float) -> Splats:
        """Return the splats that are visible at a time, seconds.

        Raises `Minute4dError` for times outside the clip, and without splats.
        """
        with tempfile.TemporaryDirectory(prefix="minute4d-") as name:
            out = Path(name, "instant.ply")
            self._command("export", ["--format=ply", f"--time={self._frame(time)}", f"--out={out}"])
            return read_ply(out)

    def _command(self, command: str, options: list[str]) -> None:
        with Events(program(), [command, *options, "--", str(self._splats_file)]) as events:
            events.wait()

    def _frame(self, time: float) -> float:
        """Return the frame number of a time in seconds."""
        if not self._trained:
            raise Minute4dError(
                Category.NO_INPUT,
                f"{self.folder}: a capture has no splats; `minute4d train` makes them",
            )
        if not 0 <= time <= self.duration_s:
            raise Minute4dError(
                Category.USAGE, f"time {time} s is outside the clip (0 s to {self.duration_s:.3f} s)"
            )
        if self.duration_s == 0:
            return 0.0
        return min(time / self.duration_s, 1.0) * (self._time_frames - 1)

    def _read_capture(self, path: Path) -> None:
        """Read the list of frames as the program writes it."""
        try:
            listed = json.loads(path.read_bytes())
            frames = sorted(listed["frames"], key=lambda frame: frame["time"])
            if listed["axes"] not in ("opengl", "opencv"):
                raise ValueError("unknown axes")
            c2w = np.array([f["transform_matrix"] for f in frames], np.float64)
            if listed["axes"] == "opengl":
                c2w = c2w * [1, -1, -1, 1]
            k = np.zeros((len(frames), 3, 3))
            k[:, 2, 2] = 1
            for i, f in enumerate(frames):
                k[i, 0, 0], k[i, 1, 1] = f["fl_x"], f["fl_y"]
                k[i, 0, 2], k[i, 1, 2] = f["cx"], f["cy"]
            sizes = {(int(f["w"]), int(f["h"])) for f in frames}
            (width, height) = sizes.pop()
            if sizes:
                raise ValueError("its images differ in size")
            self.cameras = Cameras(k, c2w, width, height)
            self._time_frames = len(frames)
            self.duration_s = _duration_s(listed.get("duration_s"), len(frames))
            self.times = np.array([f["time"] for f in frames], np.float64) * self.duration_s
            self.metric = bool(listed["metric"])
            self._depth_unit = float(listed["depth_unit_scale_factor"])
            self.image_paths = [self._inside(f["file_path"]) for f in frames]
            self._frames = frames
        except OSError as error:
            raise Minute4dError(Category.IO, f"{path}: {error.strerror}") from error
        except (KeyError, TypeError, ValueError) as error:
            raise Minute4dError(
                Category.BAD_INPUT,
                f"{path}: it is not a list of frames as minute4d writes it ({error!r}); "
                "`minute4d import` makes captures of others",
            ) from error

    def _read_scene(self, path: Path) -> None:
        """Read the cameras and times of a scene file."""
        try:
            with path.open("rb") as file:
                (length,) = struct.unpack("<Q", file.read(8))
                if length > os.fstat(file.fileno()).st_size:
                    raise ValueError("it is too short")
                header = json.loads(file.read(length))
                facts = json.loads(header["__metadata__"]["minute4d_scene"])["scene"]

                def array(name: str) -> NDArray[np.float64]:
                    begin, end = header[name]["data_offsets"]
                    file.seek(8 + length + begin)
                    data = np.frombuffer(file.read(end - begin), "<f8")
                    return data.reshape(header[name]["shape"])

                poses, lenses, frames = (
                    array(f"source.{name}") for name in ("c2w", "intrinsics", "t")
                )
            self._time_frames = int(facts["time_frames"])
            self.duration_s = _duration_s(facts["duration_s"], self._time_frames)
            n = len(frames)
            c2w = np.tile(np.eye(4), (n, 1, 1))
            c2w[:, :3] = poses
            k = np.tile(np.eye(3), (n, 1, 1))
            k[:, [0, 1, 0, 1], [0, 1, 2, 2]] = lenses[:, 2:]
            width, height = (int(side) for side in lenses[0, :2]) if n else (0, 0)
            if np.any(lenses[:, :2] != (width, height)):
                raise ValueError("its images differ in size")
            self.cameras = Cameras(k, c2w, width, height)
            self.times = frames / max(self._time_frames - 1, 1) * self.duration_s
        except OSError as error:
            raise Minute4dError(Category.IO, f"{path}: {error.strerror}") from error
        except (KeyError, TypeError, ValueError, struct.error) as error:
            raise Minute4dError(
                Category.BAD_INPUT, f"{path}: it is damaged, or of another version ({error!r})"
            ) from error

    def _inside(self, name: str) -> Path:
        """Return the path of a file that the list of frames names: not outside the capture."""
        path = self._capture / name
        if not path.resolve().is_relative_to(self._capture.resolve()):
            raise Minute4dError(Category.BAD_INPUT, f"{path}: it is outside the capture")
        return path

    def _maps(self, key: str) -> NDArray[Any]:
        """Return greyscale images of all frames (n, height, width)."""
        if not self._frames or any(not frame.get(key) for frame in self._frames):
            raise Minute4dError(
                Category.NO_INPUT,
                f"{self._capture}: not every frame has a {key}, or there is no capture",
            )
        maps = _png.read([self._inside(frame[key]) for frame in self._frames])
        if maps.shape[3] != 1:
            raise Minute4dError(Category.BAD_INPUT, f"{self._capture}: a {key} is not greyscale")
        return maps[..., 0]


def _duration_s(stored: Union[float, None], frames: int) -> float:
    return float(stored) if stored is not None else (frames - 1) / _DEFAULT_FPS


def load(folder: Union[str, os.PathLike[str]]) -> Scene:
    """Read the results of a run (``minute4d run`` or ``train``) or a capture.

    Returns a `Scene` with arrays of its training frames. Raises `Minute4dError` if the folder has
    none, or its files are damaged.
    """
    return Scene(Path(folder))
