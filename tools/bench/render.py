#!/usr/bin/env python3
"""Renders a benchmark scene with ground truth: see README.md beside this file.

    python tools/bench/render.py mill-1 OUT --sets train,far,near,between
"""

import argparse
import importlib
import pathlib
import sys

MODULES = ("numpy", "bpy", "imageio", "OpenImageIO", "pybullet", "skimage")


def arguments():
    """The command line."""
    parser = argparse.ArgumentParser(description="Render a benchmark scene with ground truth.")
    parser.add_argument("name", help="KIND-NUMBER, such as mill-1")
    parser.add_argument("out", type=pathlib.Path, help="folder to write; images that it already has are kept")
    parser.add_argument("--width", type=int, default=480)
    parser.add_argument("--height", type=int, default=360)
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--frames", type=int, help="number of training frames [default: 4 seconds of them]")
    length.add_argument("--seconds", type=float, default=4.0, help="length of the clip, instead of --frames")
    parser.add_argument("--fps", type=float, default=24.0)
    span = "mill, quad, toys: frames at 24 per second that the motion spans [default: as many as the clip lasts]"
    parser.add_argument("--base-frames", type=int, default=0, help=span)
    tripod = "fixed: on a tripod, where the hand-held camera is in the middle of the clip"
    parser.add_argument("--camera", choices=("hand", "fixed"), default="hand", help=tripod)
    parser.add_argument("--motion-blur", action="store_true", help="open the shutter for half a frame")
    parser.add_argument("--sets", default="train,far", help="some of train,far,near,between [default: train,far]")
    parser.add_argument("--test-every", type=int, default=4, metavar="N", help="held-out views are those of every N-th frame")
    parser.add_argument("--only", default="", help="comma-separated training frames to render, and nothing else")
    parser.add_argument("--spp", type=int, default=32, help="samples per pixel")
    parser.add_argument("--threads", type=int, default=0, help="threads of Cycles [default: all cores]")
    args = parser.parse_args()
    try:
        args.sets, args.only = args.sets.split(","), [int(i) for i in args.only.split(",") if i]
    except ValueError:
        parser.error(f"--only {args.only}: give frame numbers, such as 0,12")
    if unknown := set(args.sets) - {"train", "far", "near", "between"}:
        parser.error(f"unknown set {min(unknown)}: choose from train,far,near,between")
    if args.fps <= 0 or min(args.width, args.height, args.test_every, args.spp) < 1:
        parser.error("--fps, --width, --height, --spp and --test-every must be positive")
    args.frames = args.frames or round(args.seconds * args.fps)
    if args.frames < 2:
        parser.error("a clip has at least 2 frames")
    return args


def main():
    args = arguments()
    try:
        for module in MODULES:
            importlib.import_module(module)
    except ImportError as missing:
        requirements = pathlib.Path(__file__).resolve().parent / "requirements.txt"
        sys.exit(f"{missing}; in a virtual environment of Python 3.11: pip install -r {requirements}")
    import run

    run.run(args)


if __name__ == "__main__":
    main()
