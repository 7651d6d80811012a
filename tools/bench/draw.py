#!/usr/bin/env python3
"""Draws the four scenes on which a change is reported: see README.md beside this file.

    python tools/bench/draw.py --seed 20261123 [--out scenes]

Prints one command per scene. Kinds differ, numbers are 7 to 99; the same seed gives the same scenes on any machine.
"""

import argparse
import hashlib

# Numbers below are for choosing defaults.
FIRST_NUMBER, LAST_NUMBER = 7, 99
KINDS = ("cart", "contact", "deform", "gloss", "mill", "pendulum", "quad", "toys", "walker")
OPTIONS = "--frames 48 --width 320 --height 240 --spp 16 --test-every 8 --sets train,far,near,between"


def draw(seed, count=4):
    """`count` names of scenes of different kinds."""
    digest = lambda kind: hashlib.sha256(f"{seed}:{kind}".encode()).digest()
    number = lambda kind: FIRST_NUMBER + int.from_bytes(digest(kind)[-4:], "big") % (LAST_NUMBER - FIRST_NUMBER + 1)
    return [f"{kind}-{number(kind)}" for kind in sorted(KINDS, key=digest)[:count]]


def main():
    parser = argparse.ArgumentParser(description="Draw the four scenes on which a change is reported.")
    parser.add_argument("--seed", type=int, required=True, help="such as the date: not chosen by its result")
    parser.add_argument("--out", default="scenes", help="folder of the scenes")
    args = parser.parse_args()
    for name in draw(args.seed):
        print(f"python tools/bench/render.py {name} {args.out}/{name} {OPTIONS}")


if __name__ == "__main__":
    main()
