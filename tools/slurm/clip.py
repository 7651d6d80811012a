#!/usr/bin/env python3
"""Short clips, all different, cut from examples/pinwheel.mp4: the same call makes the same pictures. One is corrupt.

    tools/slurm/clip.py FOLDER [COUNT=40] [--bad 7] [--frames 14] [--size 160x120]

Clip I is clip-NNN.mp4, I from 0; the file of clip 7 has a right header (`ftyp`) and random bytes behind it.
Needs ffmpeg. Files that are there already are kept, so that a second call changes nothing.
"""

import argparse
import pathlib
import random
import subprocess
import sys

SOURCE = pathlib.Path(__file__).resolve().parents[2] / "examples" / "pinwheel.mp4"
SOURCE_SIZE, SOURCE_FRAMES = (480, 360), 96


def cut(path, index, frames, size):
    """Clip `index`: `frames` pictures from some moment on, a window of the whole between two thirds and all of it."""
    chance = random.Random(index)
    first = chance.randrange(SOURCE_FRAMES - frames + 1)
    share = chance.uniform(0.67, 1.0)
    width, height = (2 * round(side * share / 2) for side in SOURCE_SIZE)
    left, top = (chance.randrange(side - part + 1) for side, part in zip(SOURCE_SIZE, (width, height)))
    picture = (
        f"trim=start_frame={first}:end_frame={first + frames},setpts=PTS-STARTPTS,"
        f"crop={width}:{height}:{left}:{top},scale={size[0]}:{size[1]}"
    )
    part = path.with_suffix(".part")
    command = ["ffmpeg", "-nostdin", "-v", "error", "-y", "-i", SOURCE, "-vf", picture, "-an", "-c:v", "libx264"]
    command += ["-preset", "fast", "-crf", "18", "-threads", "1", "-pix_fmt", "yuv420p", "-fflags", "+bitexact"]
    subprocess.run([*command, "-f", "mp4", part], check=True)
    part.rename(path)


def spoil(path, index):
    """What begins as an MP4 does and is none."""
    header = bytes.fromhex("00000020") + b"ftypisom" + bytes.fromhex("00000200") + b"isomiso2avc1mp41"
    path.write_bytes(header + random.Random(index).randbytes(20_000))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("count", type=int, nargs="?", default=40)
    parser.add_argument("--bad", type=int, default=7, help="the clip that is corrupt; -1 for none")
    parser.add_argument("--frames", type=int, default=14)
    parser.add_argument("--size", type=lambda text: tuple(map(int, text.split("x"))), default=(160, 120))
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    for index in range(given.count):
        path = given.folder / f"clip-{index:03}.mp4"
        if path.exists():
            continue
        if index == given.bad:
            spoil(path, index)
        else:
            cut(path, index, given.frames, given.size)


if __name__ == "__main__":
    try:
        main()
    except FileNotFoundError as error:
        sys.exit(f"clip.py: {error}; ffmpeg must be installed")
    except subprocess.CalledProcessError as error:
        sys.exit(f"clip.py: ffmpeg failed, exit code {error.returncode}")
