"""Files of a scene. Each is written whole: under a temporary name, then renamed."""

import json
import math
import os
import sys

import numpy as np
import views

DEPTH_STEPS_PER_M = 1000


def whole(path, write):
    """Calls `write` with a temporary path beside `path`, then renames it to `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.stem}.tmp-{os.getpid()}{path.suffix}")
    write(part)
    part.replace(path)


def image(path, pixels, **options):
    """A JPEG or PNG."""
    import imageio.v3 as iio

    whole(path, lambda part: iio.imwrite(part, pixels, **options))


def frame(out, frame, colour, depth_m, instance):
    """The images of one view; the colour image is the last, so that it stands for all."""
    if frame.depth:
        steps = (depth_m * DEPTH_STEPS_PER_M + 0.5).clip(0, 65535).astype(np.uint16)
        image(out / frame.depth, np.where(depth_m > 0, steps, 0).astype(np.uint16))
    if frame.instance:
        image(out / frame.instance, instance)
    image(out / frame.mask, np.where(instance > 0, 255, 0).astype(np.uint8))
    image(out / frame.image, colour, quality=95)


def head(scene, width, height, settings):
    """The keys of a list that hold for all frames; `settings` says how it was rendered."""
    clip = scene.clip
    focal_px = 0.5 * width / math.tan(scene.rig.lens_rad / 2)
    lens = {"camera_model": "OPENCV", "fl_x": focal_px, "fl_y": focal_px, "cx": width / 2, "cy": height / 2}
    size = {"w": width, "h": height, "fps": clip.fps, "duration_s": clip.seconds(clip.frames - 1)}
    none = {"k1": 0, "k2": 0, "p1": 0, "p2": 0}
    return {**lens, **size, **none, "scene": scene.name, "instances": list(scene.subject.names), "rendering": settings}


def lists(out, keys, scene, sets, every, matrix):
    """The JSON list of each of `sets`. A list of the same name must have the same keys, or its images are others'."""
    for name in sets:
        path = out / views.FILES[name]
        frames = [frame.entry(scene.clip, matrix) for frame in views.of(scene, name, every)]
        if path.exists():
            old = json.loads(path.read_text())
            files = [frame["file_path"] for frame in old.pop("frames")]
            if old != keys or files != [frame["file_path"] for frame in frames]:
                sys.exit(f"{path} is of a scene rendered in another way; give another folder, or delete {out}")
        whole(path, lambda part, frames=frames: part.write_text(json.dumps({**keys, "frames": frames}, indent=1)))


def tracks(path, points, visible, instance, part):
    """`tracks.npz`: coords [T][N][3] in the world, visibs [T][N], instance [N], part [N]."""
    arrays = {"coords": np.float32(points), "visibs": np.array(visible), "instance": instance, "part": part}

    def write(temporary):
        with open(temporary, "wb") as file:
            np.savez_compressed(file, **arrays)

    whole(path, write)
