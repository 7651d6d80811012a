#!/usr/bin/env python3
"""Makes a scene of lower frame rate: every N-th training frame is trained on, the frames between are held out.

    python tools/bench/thin.py SCENE OUT N

OUT is a folder that `minute4d train` and `eval` read: transforms_train.json with the kept frames, transforms_test.json with the training frames between them, with masks and without depth, and copies of the files.
"""

import argparse
import json
import shutil
from pathlib import Path


def thinned(scene, step):
    """The lists of the kept and of the held-out frames, as `transforms_train.json` and `transforms_test.json` hold them."""
    frames = scene["frames"]
    last = (len(frames) - 1) // step * step
    kept = {**scene, "frames": frames[::step]}
    between = [frame for i, frame in enumerate(frames[:last]) if i % step]
    held_out = {**scene, "frames": [{k: v for k, v in frame.items() if k != "depth_file_path"} for frame in between]}
    return kept, held_out


def main():
    parser = argparse.ArgumentParser(description="Make a scene of lower frame rate, whose other training frames are held out.")
    parser.add_argument("scene", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("step", type=int, help="every N-th frame is kept, N at least 2")
    args = parser.parse_args()
    if args.step < 2:
        parser.error("N is at least 2")
    if args.out.exists():
        parser.error(f"{args.out} exists; choose another folder")
    with open(args.scene / "transforms_train.json", encoding="utf-8") as file:
        kept, held_out = thinned(json.load(file), args.step)
    for folder in ("train", "depth", "mask"):
        shutil.copytree(args.scene / folder, args.out / folder, copy_function=shutil.copyfile)
    # the lists last: a folder without them is read by nothing
    for name, frames in (("transforms_test.json", held_out), ("transforms_train.json", kept)):
        (args.out / name).write_text(json.dumps(frames, indent=1), encoding="utf-8")
    print(f"{len(kept['frames'])} frames to train on, {len(held_out['frames'])} held out")


if __name__ == "__main__":
    main()
