"""Clips of data sets, telephones and trackers: `python3 oracles/import_formats_b.py fixtures/import`.

Needs numpy, Pillow, OpenEXR and pyliblzfse. One made-up clip, a ball that moves before a slanted wall, is seen by five cameras
(and held-out ones) and written in each layout with the tools that write it elsewhere; `clip/truth.npz` is what every one of them means:
OpenCV axes, camera to world, z-depth, principal point from the corner. The pixel (x, y) shows the ray through (x + 0.5, y + 0.5).
"""

import io
import json
import os
import shutil
import sys
import zipfile

import liblzfse
import numpy as np
import OpenEXR
from PIL import Image

N, W, H = 5, 48, 36
DW, DH = 24, 18
FX, FY, CX, CY = 50.0, 52.0, 24.5, 17.25
WALL = np.array([0.2, -0.1, 1.0])  # WALL . X = 3
BALL_RADIUS = 0.45


def ball(t):
    return np.array([-0.5 + 0.25 * t, 0.1, 1.9 + 0.05 * t])


def turn(axis, angle):
    a = np.asarray(axis, float) / np.linalg.norm(axis)
    k = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def pose(i):
    m = np.eye(4)
    m[:3, :3] = turn([0.1, 1, 0.2], -0.06 * i + 0.05) @ turn([0, 0, 1], 0.1)
    m[:3, 3] = [0.12 * i - 0.2, 0.03 * i, -0.02 * i]
    return m


def held_out(i):
    m = np.eye(4)
    m[:3, :3] = turn([0, 1, 0], 0.1 + 0.02 * i)
    m[:3, 3] = [-0.4, 0.1 * i, 0.05]
    return m


def intrinsics(w, h, fx=FX, fy=FY):
    sx, sy = w / W, h / H
    return np.array([[fx * sx, 0, CX * sx], [0, fy * sy, CY * sy], [0, 0, 1.0]])


def shade(wall, p):
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    a = np.stack([130 + 60 * np.sin(1.7 * x), 120 + 50 * np.cos(1.3 * y), 110 + 40 * np.sin(x + y)], -1)
    b = np.stack([200 + 20 * np.sin(3 * y), 70 + 20 * np.cos(3 * x), 60 + 0 * z], -1)
    return np.where(wall[..., None], a, b)


def render(c2w, t, k, w=W, h=H):
    y, x = np.mgrid[0:h, 0:w] + 0.5
    ray = np.stack([(x - k[0, 2]) / k[0, 0], (y - k[1, 2]) / k[1, 1], np.ones_like(x)], -1)
    d = ray @ c2w[:3, :3].T
    o = c2w[:3, 3]
    z = (3 - WALL @ o) / (d @ WALL)
    oc = o - ball(t)
    a, b, c = (d * d).sum(-1), d @ oc, oc @ oc - BALL_RADIUS**2
    disc = b * b - a * c
    near = np.where(disc > 0, (-b - np.sqrt(np.maximum(disc, 0))) / a, np.inf)
    moves = near < z
    z = np.where(moves, near, z)
    p = o + d * z[..., None]
    return np.clip(np.round(shade(~moves, p)), 0, 255).astype(np.uint8), z, moves


def quaternion_xyzw(r):
    w = np.sqrt(max(0.0, 1 + r[0, 0] + r[1, 1] + r[2, 2])) / 2
    return np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 4 * w * w]) / (4 * w)


ARKIT = np.diag([1.0, -1.0, -1.0, 1.0])


class Clip:
    def __init__(self):
        self.c2w = np.stack([pose(i) for i in range(N)])
    
        self.k = np.stack([intrinsics(W, H)] * N)
        views = [render(self.c2w[i], i, self.k[i]) for i in range(N)]
        self.rgb, self.depth, self.mask = (np.stack([v[j] for v in views]) for j in range(3))
        small = [render(self.c2w[i], i, intrinsics(DW, DH), DW, DH) for i in range(N)]
        self.small = np.stack([v[1] for v in small])
        self.test_t = [1, 3]
        self.test_c2w = np.stack([held_out(i) for i in range(2)])
        self.test_rgb = np.stack([render(self.test_c2w[i], t, self.k[0])[0] for i, t in enumerate(self.test_t)])
        rng = np.random.default_rng(5)
        self.pixels = np.stack([rng.integers(0, W, (N, 7)), rng.integers(0, H, (N, 7))], -1).astype(float)
        self.z = np.stack([self.depth[i][self.pixels[i, :, 1].astype(int), self.pixels[i, :, 0].astype(int)] for i in range(N)])
        self.places = np.stack([self.lift(i) for i in range(N)])
        self.seen = rng.random((N, 7)) > 0.3

    def lift(self, i):
        u, v = self.pixels[i, :, 0] + 0.5, self.pixels[i, :, 1] + 0.5
        k = self.k[i]
        p = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones(7)], -1) * self.z[i][:, None]
        return p @ self.c2w[i, :3, :3].T + self.c2w[i, :3, 3]


def write_json(path, value):
    os.makedirs(os.path.dirname(path), exist_ok=True)
    with open(path, "w") as f:
        json.dump(value, f)


def image(path, array, **options):
    os.makedirs(os.path.dirname(path), exist_ok=True)
    Image.fromarray(array).save(path, **options)


JPEG = {"quality": 97, "subsampling": 0}


def dycheck(root, c):
    def camera(name, c2w):
        write_json(f"{root}/camera/{name}.json", {
            "orientation": c2w[:3, :3].T.tolist(), "position": c2w[:3, 3].tolist(),
            "focal_length": 2 * FX, "pixel_aspect_ratio": FY / FX, "skew": 0.0,
            "principal_point": [2 * CX, 2 * CY], "image_size": [2 * W, 2 * H],
            "radial_distortion": [0, 0, 0], "tangential_distortion": [0.0, 0.0]})

    train = [f"0_{i:05d}" for i in range(N)]
    val = [f"{1 + j}_{t:05d}" for j, t in enumerate(c.test_t)]
    for i, name in enumerate(train):
        camera(name, c.c2w[i])
        image(f"{root}/rgb/2x/{name}.png", c.rgb[i])
        os.makedirs(f"{root}/depth/2x", exist_ok=True)
        depth = (c.depth[i] * 1000).astype(np.float32)[..., None]
        depth[0, :4] = 0
        np.save(f"{root}/depth/2x/{name}.npy", depth)
    for i, name in enumerate(val):
        camera(name, c.test_c2w[i])
        image(f"{root}/rgb/2x/{name}.png", c.test_rgb[i])
        seen = np.zeros((H, W), np.uint8)
        seen[:, 8 * (i + 1):] = 255
        image(f"{root}/covisible/2x/val/{name}.png", seen)
    meta = {n: {"warp_id": int(n[2:]), "appearance_id": int(n[2:]), "camera_id": int(n[0])} for n in train + val}
    write_json(f"{root}/dataset.json", {"count": 7, "num_exemplars": 5, "ids": train + val, "train_ids": train, "val_ids": val})
    write_json(f"{root}/metadata.json", meta)
    write_json(f"{root}/scene.json", {"scale": 0.25, "center": [0.1, 0.2, 1.0], "near": 1.2 * 0.25, "far": 4.5 * 0.25})
    write_json(f"{root}/extra.json", {"factor": 2, "fps": 10.0, "bbox": [[0, 0, 0], [1, 1, 1]], "lookat": [0, 0, 1], "up": [0, -1, 0]})
    for split, names in [("train", train[::-1]), ("val", val)]:
        write_json(f"{root}/splits/{split}.json", {
            "frame_names": names, "camera_ids": [meta[n]["camera_id"] for n in names], "time_ids": [meta[n]["warp_id"] for n in names]})


def nvidia(root, c):
    os.makedirs(f"{root}/disp", exist_ok=True)
    rows = []
    # the principal point of this format is the middle
    k = np.array([[FX, 0, W / 2], [0, FX, H / 2], [0, 0, 1.0]])
    truth = {"rgb": [], "depth": [], "gt": []}
    for i in range(N):
        rgb, z, moves = render(c.c2w[i], i, k)
        truth["rgb"].append(rgb)
        truth["depth"].append(z.astype(np.float32))
        m = c.c2w[i]
        down, right, back = m[:3, 1], m[:3, 0], -m[:3, 2]
        block = np.stack([down, right, back, m[:3, 3], [2 * H, 2 * W, 2 * FX]], 1)
        near, far = np.percentile(z, [0.1, 99.9])
        rows.append(np.concatenate([block.ravel(), [near, far]]))
        image(f"{root}/images_2/{i:03d}.png", rgb)
        image(f"{root}/motion_masks/{i:03d}.png", moves.astype(np.uint8) * 255)
        np.save(f"{root}/disp/{i:03d}.npy", (13.0 / z + 2.0 * i).astype(np.float32))
        gt = render(c.c2w[0], i, k)[0]
        truth["gt"].append(gt)
        image(f"{root}/gt/v000_t{i:03d}.png", gt)
        for j in range(3):
            image(f"{root}/mv_images/{i:05d}/cam{j + 1:02d}.jpg", render(c.c2w[j], i, k)[0], **JPEG)
    np.save(f"{root}/poses_bounds.npy", np.stack(rows))
    np.savez_compressed(f"{root}/truth.npz", k=k, **{n: np.stack(v) for n, v in truth.items()})


def davis(root, c):
    for i in range(N):
        image(f"{root}/JPEGImages/480p/ball/{i:05d}.jpg", c.rgb[i], **JPEG)


def confidence(i):
    conf = np.full((DH, DW), 2, np.uint8)
    conf[:, :3] = 1
    conf[i: i + 4, 5:11] = 0
    return conf


def record3d(root, c):
    os.makedirs(root, exist_ok=True)
    k = intrinsics(2 * W, 2 * H)
    poses, coefficients = [], []
    for i in range(N):
        arkit = c.c2w[i] @ ARKIT
        poses.append(quaternion_xyzw(arkit[:3, :3]).tolist() + arkit[:3, 3].tolist())
        coefficients.append([k[0, 0], k[1, 1], k[0, 2], k[1, 2]])
    metadata = {
        "w": 2 * W, "h": 2 * H, "dw": DW, "dh": DH, "fps": 60, "K": k.T.ravel().tolist(), "poses": poses,
        "initPose": poses[0], "perFrameIntrinsicCoeffs": coefficients, "frameTimestamps": [7.0, 7.1, 7.2, 7.3, 7.4],
        "cameraType": 1}
    with zipfile.ZipFile(f"{root}/clip.r3d", "w") as z:
        z.writestr(zipfile.ZipInfo("metadata"), json.dumps(metadata))
        for i in range(N):
            jpeg = io.BytesIO()
            exif = Image.Exif()
            if i == 2:
                # a block that asks to be turned by a quarter; poses, K and depth are those of the stored rows
                exif[0x0112] = 6
            Image.fromarray(c.rgb[i]).save(jpeg, "JPEG", exif=exif, **JPEG)
            z.writestr(zipfile.ZipInfo(f"rgbd/{i}.jpg"), jpeg.getvalue())
            depth = c.small[i].astype(np.float32)
            depth[0, 0] = np.nan
            z.writestr(zipfile.ZipInfo(f"rgbd/{i}.depth"), liblzfse.compress(depth.tobytes()))
            z.writestr(zipfile.ZipInfo(f"rgbd/{i}.conf"), liblzfse.compress(confidence(i).tobytes()))


    # maps of more than 4 kB are packed in another way (bvx2 in place of bvxn)
    metadata |= {"dw": 2 * W, "dh": 2 * H, "poses": poses[:1], "perFrameIntrinsicCoeffs": [], "frameTimestamps": []}
    with zipfile.ZipFile(f"{root}/large.r3d", "w") as z:
        z.writestr(zipfile.ZipInfo("metadata"), json.dumps(metadata))
        jpeg = io.BytesIO()
        Image.fromarray(c.rgb[0]).save(jpeg, "JPEG", **JPEG)
        z.writestr(zipfile.ZipInfo("rgbd/0.jpg"), jpeg.getvalue())
        depth = liblzfse.compress(c.depth[0].astype(np.float32).repeat(2, 0).repeat(2, 1).tobytes())
        assert depth[:4] == b"bvx2"
        z.writestr(zipfile.ZipInfo("rgbd/0.depth"), depth)


def side(root, c):
    for name in ["exr", "png", "npy"]:
        os.makedirs(f"{root}/depth_{name}", exist_ok=True)
    kinds = [("Z", np.float32, OpenEXR.ZIP_COMPRESSION), ("Z", np.float16, OpenEXR.PIZ_COMPRESSION), ("Y", np.float32, OpenEXR.RLE_COMPRESSION),
             ("R", np.float16, OpenEXR.ZIPS_COMPRESSION), ("ViewLayer.Depth.Z", np.float32, OpenEXR.NO_COMPRESSION)]
    for i, (channel, dtype, compression) in enumerate(kinds):
        z = c.small[i].astype(np.float32)
        z[2, 3] = [np.nan, np.inf, -1.0, 0.0, np.nan][i]
        # names whose natural order is not that of letters
        name = f"frame{8 + i}"
        header = {"compression": compression, "type": OpenEXR.scanlineimage}
        channels = {channel: z.astype(dtype)}
        if channel == "R":
            channels |= {"G": z.astype(dtype) * 2, "B": z.astype(dtype) * 3}
        OpenEXR.File(header, channels).write(f"{root}/depth_exr/{name}.exr")
        known = np.where(np.isfinite(z) & (z > 0), z, 0)
        image(f"{root}/depth_png/{name}.png", np.round(known / 0.0005).astype(np.uint16))
        np.save(f"{root}/depth_npy/{name}.npy", z if i else z.astype(np.float64)[..., None])
        image(f"{root}/masks_png/{name}.png", c.mask[i].astype(np.uint8))
        ids = Image.fromarray(c.mask[i].astype(np.uint8) * (i + 1), "P")
        ids.putpalette([0, 0, 0] + [8 * j for j in range(1, 31)])
        os.makedirs(f"{root}/masks_palette", exist_ok=True)
        ids.save(f"{root}/masks_palette/{name}.png", bits=4 if i % 2 else 8)
    z = c.small[0].astype(np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    parts = [OpenEXR.Part(header | {"name": "colour"}, {"R": z * 2, "G": z * 2, "B": z * 2}, "colour"),
             OpenEXR.Part(header | {"name": "depth"}, {"Z": z}, "depth")]
    os.makedirs(f"{root}/exr_other")
    OpenEXR.File(parts).write(f"{root}/exr_other/parts.exr")
    window = {"dataWindow": ((2, 1), (DW + 1, DH)), "displayWindow": ((0, 0), (DW + 9, DH + 9))}
    OpenEXR.File(header | {k: tuple(np.array(v, np.int32) for v in w) for k, w in window.items()}, {"Z": z}).write(f"{root}/exr_other/cropped.exr")


def main(root):
    c = Clip()
    writers = [dycheck, nvidia, davis, record3d, side]
    for write in writers:
        path = os.path.join(root, write.__name__)
        shutil.rmtree(path, ignore_errors=True)
        write(path, c)
    os.makedirs(f"{root}/clip", exist_ok=True)
    np.savez_compressed(
        f"{root}/clip/truth.npz", k=c.k, c2w=c.c2w, rgb=c.rgb, depth=c.depth.astype(np.float32), small=c.small.astype(np.float32), mask=c.mask, test_c2w=c.test_c2w,
        test_rgb=c.test_rgb, places=c.places, seen=c.seen, confidence=np.stack([confidence(i) for i in range(N)]))


if __name__ == "__main__":
    main(sys.argv[1])
