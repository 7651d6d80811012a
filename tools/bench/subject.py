"""The moving part of a scene as data: what every kind returns. Times are seconds from the first frame."""

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass
class Part:
    """A rigid or deforming surface of an object.

    `instance` numbers the object (1 and up); a car and its wheels share one. `vertices` gives a deforming mesh's
    [n][3] at a time; its `shape` is then a `Mesh` with as many.
    """

    instance: int
    shape: object
    material: object
    vertices: Callable | None = None


@dataclass
class Lamp:
    """A moving lamp, which the camera does not see: power, radius, and position [3] at a time."""

    power_w: float
    radius_m: float
    position: Callable


@dataclass
class Subject:
    """Moving objects: their names (instance i is `names[i - 1]`), parts, and `pose`.

    `pose(seconds)` gives an object-to-world matrix [4][4] per part and depends on nothing else. `fixed` are static
    objects that belong to the kind, `focus` is the point that cameras look at, `sun` scales the light of the room.
    """

    names: tuple
    parts: list
    pose: Callable
    fixed: list = field(default_factory=list)
    focus: tuple = (0.0, 0.1, 0.75)
    lamp: Lamp | None = None
    sun: float = 1.0
