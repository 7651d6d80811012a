#!/usr/bin/env python3
"""Poses of a clip kept as LLFF's loaders hand them out (a JSON file with `poses` [n][3][5]) as nerfstudio's transforms.json.

Columns 0 to 3 of a pose are camera to world with axes right, up, back; column 4 is height, width and focal length in pixels.
Frames take the names of the pictures in order. Usage: llff_json_to_transforms.py precomputed.json IMAGES > transforms.json
"""

import json
import pathlib
import sys


def main() -> None:
    poses = json.loads(pathlib.Path(sys.argv[1]).read_text())["poses"]
    images = sorted(p for p in pathlib.Path(sys.argv[2]).iterdir() if p.suffix.lower() in {".png", ".jpg", ".jpeg"})
    if len(images) != len(poses):
        sys.exit(f"{sys.argv[1]} has {len(poses)} poses and {sys.argv[2]} {len(images)} pictures")
    frames = []
    for i, (pose, image) in enumerate(zip(poses, images)):
        matrix = [row[:4] for row in pose] + [[0.0, 0.0, 0.0, 1.0]]
        time = i / max(len(poses) - 1, 1)
        frames.append({"file_path": str(image.resolve()), "transform_matrix": matrix, "time": time})
    height, width, focal = (row[4] for row in poses[0])
    lens = {"w": round(width), "h": round(height), "fl_x": focal, "fl_y": focal, "cx": width / 2, "cy": height / 2}
    json.dump({"camera_model": "PINHOLE", **lens, "frames": frames}, sys.stdout, indent=1)


if __name__ == "__main__":
    main()
