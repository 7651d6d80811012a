"""A scene as a pure function of its name, and the clip that is filmed in it. No module of Blender is needed."""

import sys
from dataclasses import dataclass
from functools import cached_property

import cameras
import kinds
import numpy as np
import room

ORIGINAL_FPS = 24


@dataclass(frozen=True)
class Clip:
    """Frames at a rate; a position is counted in frames, real-valued, from 0."""

    frames: int = 96
    fps: float = 24.0
    # The frames at 24 per second that the motion of an original kind spans; 0: as many as the clip lasts.
    base_frames: int = 0
    tripod: bool = False

    def seconds(self, position):
        return position / self.fps

    def time(self, position):
        """0 at the first frame, 1 at the last."""
        return position / (self.frames - 1)

    @property
    def span_s(self):
        """Seconds from the first to the last frame at 24 frames per second."""
        base = self.base_frames or round(self.frames * ORIGINAL_FPS / self.fps)
        return (base - 1) / ORIGINAL_FPS


class Scene:
    """Room, subject and cameras of a name such as `cart-3`, filmed as `clip`."""

    def __init__(self, name, clip):
        kind, _, number = name.partition("-")
        if kind not in kinds.NAMES or not number.isdigit():
            sys.exit(f"unknown scene {name}: give KIND-NUMBER, such as mill-1; kinds are {', '.join(sorted(kinds.NAMES))}")
        seed = sum(ord(c) * (i + 7) for i, c in enumerate(name))
        rng = np.random.default_rng(seed)
        self.name, self.clip, self.seed = name, clip, seed
        if kind in kinds.ORIGINAL:
            self.room = room.original(seed, rng)
            self.subject = kinds.ORIGINAL[kind](rng, clip.span_s)
            self.rig = cameras.Original(rng, seed, clip.span_s)
        else:
            self.room = room.varied(rng)
            self.subject = kinds.FREE[kind](rng)
            self.rig = cameras.Handheld(rng, self.subject.focus)

    def train(self, position):
        """The view of the training camera; on a tripod, that of the middle of the clip."""
        if self.clip.tripod:
            position = (self.clip.frames - 1) / 2
        return self.rig.train(self.clip.seconds(position))

    def near(self, position, degrees):
        """The training camera turned around the point that it is directed at."""
        return self.train(position).around(self.rig.focus, degrees)

    @cached_property
    def fixed(self):
        """All static objects."""
        return self.room.fixed + self.subject.fixed
