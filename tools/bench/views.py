"""The views of a scene: the training clip and three held-out sets, with the names of their files."""

from dataclasses import dataclass

import cameras

SETS = ("train", "far", "near", "between")
FILES = {"train": "transforms_train.json", "far": "transforms_test.json"}
FILES |= {"near": "transforms_near.json", "between": "transforms_between.json"}
NEAR_DEG = (3, 6)


@dataclass(frozen=True)
class Frame:
    """A view to render: `position` in frames, `view` of a position, its files, and further keys for the list."""

    position: float
    view: object
    image: str
    mask: str
    depth: str | None = None
    instance: str | None = None
    extra: tuple = ()

    def entry(self, clip, matrix):
        """The frame in the list of its set; `matrix` makes camera to world of a view."""
        entry = {"file_path": self.image}
        if self.depth:
            entry["depth_file_path"] = self.depth
        entry |= {"mask_path": self.mask, "time": clip.time(self.position), **dict(self.extra)}
        return entry | {"transform_matrix": [[float(x) for x in row] for row in matrix(self.view(self.position))]}


def train(scene):
    """Every frame of the clip, with depth and instances."""
    for i in range(scene.clip.frames):
        n = f"{i:05d}"
        yield Frame(i, scene.train, f"train/{n}.jpg", f"mask/{n}.png", f"depth/{n}.png", f"instance/{n}.png")


def far(scene, every):
    """Two static cameras at every `every`th frame."""
    for i in range(0, scene.clip.frames, every):
        for k in range(len(cameras.FAR_DEG)):
            view = lambda _position, k=k: scene.rig.far(k)
            yield _held_out(i, view, f"c{k}_{i:05d}", camera=k)


def near(scene, every):
    """3 and 6 degrees around the training camera, on alternating sides."""
    for i in range(0, scene.clip.frames, every):
        for degrees in NEAR_DEG:
            signed = degrees if (i // every) % 2 else -degrees
            view = lambda position, signed=signed: scene.near(position, signed)
            yield _held_out(i, view, f"n{degrees}_{i:05d}", degrees=signed)


def between(scene, every):
    """The training camera half a frame after every `every`th frame."""
    for i in range(0, scene.clip.frames - 1, every):
        yield _held_out(i + 0.5, scene.train, f"b_{i:05d}")


def of(scene, name, every):
    """The frames of the set `name`."""
    if name == "train":
        return list(train(scene))
    return list({"far": far, "near": near, "between": between}[name](scene, every))


def _held_out(position, view, stem, **extra):
    instance = f"test_instance/{stem}.png"
    return Frame(position, view, f"test/{stem}.jpg", f"test_mask/{stem}.png", None, instance, tuple(extra.items()))
