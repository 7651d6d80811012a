"""Renders the images of a scene that are missing, and writes its lists and tracks."""

import time

import cameras
import imageio.v3 as iio
import numpy as np
import tracks
import views
import write
from passes import Renderer
from scene import Clip, Scene
from stage import Stage

POINTS_PER_OBJECT = 500


def run(args):
    """`args` are those of `render.py`."""
    clip = Clip(args.frames, args.fps, args.base_frames, args.camera == "fixed")
    scene = Scene(args.name, clip)
    settings = {"samples": args.spp, "motion_blur": args.motion_blur, "camera": args.camera, "base_frames": args.base_frames}
    keys = write.head(scene, args.width, args.height, settings)
    stage = Stage(scene, args.width, args.height)
    write.lists(args.out, keys, scene, args.sets, args.test_every, cameras.matrix)
    renderer = Renderer(stage, args.spp, args.threads, args.motion_blur, args.out.resolve() / "passes.tmp.exr")
    frames = [frame for name in args.sets for frame in views.of(scene, name, args.test_every)]
    if args.only:
        frames = [frame for frame in views.train(scene) if frame.position in args.only]
    missing = [frame for frame in frames if not (args.out / frame.image).exists()]
    print(f"{scene.name}: {len(frames)} images, {len(frames) - len(missing)} of them exist", flush=True)
    start = time.monotonic()
    for done, frame in enumerate(missing, 1):
        write.frame(args.out, frame, *renderer.render(frame.position, frame.view))
        each_s = (time.monotonic() - start) / done
        left_min = each_s * (len(missing) - done) / 60
        print(f"{done}/{len(missing)} {frame.image}, {each_s:.1f} s per image, {left_min:.0f} min left", flush=True)
    if "train" in args.sets and not args.only:
        write_tracks(args.out, stage, keys["fl_x"])


def write_tracks(out, stage, focal_px):
    """Follows points through the training frames, and tests them against the depth and instances that were written."""
    scene = stage.scene
    stage.show(0, scene.train(0))
    followed = tracks.Tracks(stage, POINTS_PER_OBJECT, np.random.default_rng(scene.seed))
    points, visible = [], []
    for frame in views.train(scene):
        view = frame.view(frame.position)
        stage.show(frame.position, view)
        points.append(followed.points())
        depth_m = iio.imread(out / frame.depth) / write.DEPTH_STEPS_PER_M
        instance = iio.imread(out / frame.instance)
        c2w = np.array(cameras.matrix(view))
        visible.append(tracks.visible(points[-1], c2w, focal_px, depth_m, instance, followed.instance))
    write.tracks(out / "tracks.npz", points, visible, followed.instance, followed.part)
    for i, name in enumerate(scene.subject.names):
        own = followed.instance == i + 1
        print(f"tracks of {name}: {own.sum()} points, visible in {100 * np.mean(np.array(visible)[:, own]):.0f} % of frames")
