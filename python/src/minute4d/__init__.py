"""One casual video into a dynamic 3D scene: the program ``minute4d``, and its results as arrays.

``run`` starts the program that this package contains, ``load`` reads its results. Lengths are in
scene units (metres if ``Scene.metric``), times in seconds from the first frame, pixels in OpenCV
axes (x right, y down, z forward).
"""

from ._errors import Category, Minute4dError
from ._events import Event, Events
from ._program import run
from ._scene import Cameras, Scene, load
from ._splats import Splats

__all__ = [
    "Cameras",
    "Category",
    "Event",
    "Events",
    "Minute4dError",
    "Scene",
    "Splats",
    "load",
    "run",
]
