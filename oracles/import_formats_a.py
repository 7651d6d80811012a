"""A made-up clip in the files of other tools: `python3 oracles/import_formats_a.py fixtures/import`.

Five frames of 48 x 36 pixels with known cameras, depth and masks, which follow from the formulas below, as COLMAP (written by
pycolmap), nerfstudio and ViPE (OpenEXR) hold them.
Pictures through lenses are drawn with OpenCV's `undistortPoints`; `lenses.json` holds what pycolmap and OpenCV make of points.

Needs numpy, scipy, pillow, opencv-python-headless, pycolmap, OpenEXR, imageio-ffmpeg.
"""

import io
import json
import os
import shutil
import sys
import zipfile

import cv2
import imageio_ffmpeg
import numpy as np
import OpenEXR
import pycolmap
from PIL import Image
from scipy.spatial.transform import Rotation

N, W, H = 5, 48, 36
FX, FY, CX, CY = 50.0, 52.0, 23.5, 18.75
K = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1.0]])
# k1 k2 p1 p2 of OpenCV, and k1 .. k4 of its fisheye
BROWN = np.array([-0.21, 0.05, 0.002, -0.003])
FISHEYE = np.array([0.04, -0.012, 0.003, -0.001])


def colour(i, x, y):
    """RGB of the ray (x, y, 1) in frame i."""
    r = 127 + 100 * np.sin(3 * x + 0.3 * i)
    g = 127 + 100 * np.cos(4 * y - 0.2 * i)
    b = 127 + 90 * np.sin(2 * x + 3 * y + 0.5 * i)
    return np.stack([r, g, b], -1).round().astype(np.uint8)


def rays(k=K):
    """(x, y) of the centre of every pixel, [H][W] each."""
    v, u = np.meshgrid(np.arange(H) + 0.5, np.arange(W) + 0.5, indexing="ij")
    return (u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1]


def clip():
    x, y = rays()
    images = np.stack([colour(i, x, y) for i in range(N)])
    depth = np.stack([2 + 0.3 * x + 0.2 * y + 0.1 * i for i in range(N)]).astype(np.float32)
    depth[:, 0, :5] = 0.0  # unknown
    moving = np.zeros((N, H, W), bool)
    c2w = np.tile(np.eye(4), (N, 1, 1))
    for i in range(N):
        moving[i, 10:20, 8 + 4 * i : 16 + 4 * i] = True
        c2w[i, :3, :3] = Rotation.from_rotvec([0.2 - 0.05 * i, 0.1 + 0.12 * i, -0.15 + 0.02 * i]).as_matrix()
        c2w[i, :3, 3] = [0.3 + 0.2 * i, -0.1 * i, 0.4 + 0.15 * i]
    return images, depth, moving, c2w


def main(root):
    images, depth, moving, c2w = clip()
    w2c = np.linalg.inv(c2w)

    def folder(*parts):
        path = os.path.join(root, *parts)
        os.makedirs(path, exist_ok=True)
        return path

    def fresh(name):
        shutil.rmtree(os.path.join(root, name), ignore_errors=True)
        return folder(name)

    def text(path, value):
        with open(path, "w") as f:
            f.write(value)

    def png(path, value):
        Image.fromarray(value).save(path, optimize=True)

    fresh("clip/images")  # truth.npz beside it is import_formats_b.py's
    for i in range(N):
        png(os.path.join(root, "clip/images", f"{i:05}.png"), images[i])
    np.save(os.path.join(root, "clip/depth.npy"), depth)
    np.save(os.path.join(root, "clip/moving.npy"), moving)
    truth = dict(intrinsics=[FX, FY, CX, CY], c2w=c2w.tolist(), brown=BROWN.tolist(), fisheye=FISHEYE.tolist())
    text(os.path.join(root, "clip/clip.json"), json.dumps(truth))
    colmap(folder, fresh, png, w2c)
    lenses(os.path.join(root, "clip/lenses.json"))
    nerfstudio(fresh, folder, text, png, images, depth, moving, c2w)
    vipe(fresh, folder, text, images, depth, moving, c2w)


def distorted(i, model):
    """Frame i through a lens: OpenCV finds the ray of every pixel."""
    v, u = np.meshgrid(np.arange(H) + 0.5, np.arange(W) + 0.5, indexing="ij")
    points = np.stack([u, v], -1).reshape(-1, 1, 2)
    if model == "brown":
        done = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-12)
        ray = cv2.undistortPoints(points, K, BROWN, criteria=done)
    else:
        ray = cv2.fisheye.undistortPoints(points, K, FISHEYE)
    ray = ray.reshape(H, W, 2)
    return colour(i, ray[..., 0], ray[..., 1])


def colmap(folder, fresh, png, w2c):
    def model(name, camera_model, parameters, binary, frames):
        path = fresh(name)
        sparse = folder(name, "sparse", "0")
        rec = pycolmap.Reconstruction()
        camera = pycolmap.Camera(camera_id=7, model=camera_model, width=W, height=H, params=parameters)
        rec.add_camera_with_trivial_rig(camera)
        # identifiers run against the names
        for i in frames:
            image = pycolmap.Image(name=f"{i:05}.png", camera_id=7, image_id=20 - i)
            pose = pycolmap.Rigid3d(pycolmap.Rotation3d(w2c[i, :3, :3]), w2c[i, :3, 3])
            rec.add_image_with_trivial_frame(image, pose)
        (rec.write_binary if binary else rec.write_text)(sparse)
        return path

    model("colmap_text", "PINHOLE", [FX, FY, CX, CY], False, range(N))
    model("colmap_binary", "PINHOLE", [FX, FY, CX, CY], True, range(N))
    for name, camera_model, lens, binary in [
        ("colmap_opencv", "OPENCV", BROWN, False),
        ("colmap_fisheye", "OPENCV_FISHEYE", FISHEYE, True),
    ]:
        model(name, camera_model, [FX, FY, CX, CY, *lens], binary, range(2))
        for i in range(2):
            kind = "brown" if camera_model == "OPENCV" else "fisheye"
            png(os.path.join(folder(name, "images"), f"{i:05}.png"), distorted(i, kind))


def lenses(path):
    """What every model of COLMAP that is read makes of points, by pycolmap; and OpenCV's own formulas."""
    focal = {1: [50.0], 2: [50.0, 52.0]}
    models = {
        "SIMPLE_PINHOLE": (1, []),
        "PINHOLE": (2, []),
        "SIMPLE_RADIAL": (1, [-0.2]),
        "RADIAL": (1, [-0.2, 0.05]),
        "OPENCV": (2, BROWN.tolist()),
        "FULL_OPENCV": (2, [-0.2, 0.05, 0.002, -0.003, 0.01, 0.02, -0.01, 0.005]),
        "SIMPLE_FISHEYE": (1, []),
        "FISHEYE": (2, []),
        "SIMPLE_RADIAL_FISHEYE": (1, [0.04]),
        "RADIAL_FISHEYE": (1, [0.04, -0.012]),
        "OPENCV_FISHEYE": (2, FISHEYE.tolist()),
    }
    grid = np.linspace(-0.6, 0.6, 5)
    points = np.array([[x, 0.8 * y] for x in grid for y in grid] + [[0.013, -0.27]])
    out = dict(points=points.tolist(), models=[])
    for name, (n, lens) in models.items():
        parameters = [*focal[n], CX, CY, *lens]
        camera = pycolmap.Camera(camera_id=1, model=name, width=W, height=H, params=parameters)
        pixels = camera.img_from_cam(np.c_[points, np.ones(len(points))])
        out["models"].append(dict(model=name, parameters=parameters, pixels=np.asarray(pixels).tolist()))
    p3 = np.c_[points, np.ones(len(points))].reshape(-1, 1, 3)
    zero = np.zeros(3)
    brown, _ = cv2.projectPoints(p3, zero, zero, K, BROWN)
    fish, _ = cv2.fisheye.projectPoints(p3, zero, zero, K, FISHEYE)
    out["opencv"] = brown.reshape(-1, 2).tolist()
    out["opencv_fisheye"] = fish.reshape(-1, 2).tolist()
    with open(path, "w") as f:
        json.dump(out, f)


def nerfstudio(fresh, folder, text, png, images, depth, moving, c2w):
    gl = c2w @ np.diag([1.0, -1, -1, 1])
    lens = dict(w=W, h=H, fl_x=FX, fl_y=FY, cx=CX, cy=CY)
    # as ns-process-data does: turned, shifted, then shrunk
    applied = np.eye(4)[[0, 2, 1, 3]]
    applied[2] *= -1
    applied[:3, 3] = [0.5, 0.25, -0.125]
    scale = 0.5
    path = fresh("nerfstudio")
    for name in ["images", "depth", "masks"]:
        folder("nerfstudio", name)
    frames = []
    for i in range(N):
        m = applied @ gl[i]
        m[:3, 3] *= scale
        Image.fromarray(images[i]).save(os.path.join(path, f"images/frame_{i + 1}.jpg"), quality=95, subsampling=0)
        png(os.path.join(path, f"depth/{i}.png"), (depth[i] * 1000).round().astype(np.uint16))
        png(os.path.join(path, f"masks/{i}.png"), np.where(moving[i], 0, 255).astype(np.uint8))
        frames.append(
            dict(
                file_path=f"images/frame_{i + 1}.jpg",
                depth_file_path=f"depth/{i}.png",
                mask_path=f"masks/{i}.png",
                transform_matrix=m.tolist(),
            )
        )
    meta = dict(lens, camera_model="OPENCV", k1=0.0, k2=0.0, p1=0.0, p2=0.0)
    meta.update(applied_transform=applied[:3].tolist(), applied_scale=scale, frames=frames[::-1])
    text(os.path.join(path, "transforms.json"), json.dumps(meta))

    # Instant4D: OpenCV axes, a time each, no model; depth in floats as a user of nerfstudio may add it
    path = fresh("instant4d")
    np.save(os.path.join(path, "depth_2.npy"), depth[2] * 1000)
    frames = [
        dict(file_path=f"../clip/images/{i:05}.png", transform_matrix=c2w[i].tolist(), time=i / (N - 1)) for i in range(N)
    ]
    frames[2]["depth_file_path"] = "depth_2.npy"
    text(os.path.join(path, "transforms.json"), json.dumps(dict(lens, frames=frames)))

    # D-NeRF: a field of view, no extensions, a training and a test split
    path = fresh("blender")
    angle = dict(camera_angle_x=2 * np.arctan(0.5 * W / FX))
    frame = lambda i: dict(file_path=f"../clip/images/{i:05}", time=i / (N - 1), transform_matrix=gl[i].tolist())
    text(os.path.join(path, "transforms_train.json"), json.dumps(dict(angle, frames=[frame(i) for i in [0, 2, 4]])))
    text(os.path.join(path, "transforms_test.json"), json.dumps(dict(angle, frames=[frame(i) for i in [3, 1]])))

    for name, keys, kind in [
        ("nerfstudio_opencv", dict(camera_model="OPENCV", **dict(zip(["k1", "k2", "p1", "p2"], BROWN))), "opencv"),
        ("nerfstudio_fisheye", dict(camera_model="OPENCV_FISHEYE", **dict(zip(["k1", "k2", "k3", "k4"], FISHEYE))), "fisheye"),
    ]:
        path = fresh(name)
        frames = [dict(file_path=f"../colmap_{kind}/images/{i:05}.png", transform_matrix=gl[i].tolist()) for i in range(2)]
        text(os.path.join(path, "transforms.json"), json.dumps(dict(lens, frames=frames, **keys)))


def vipe(fresh, folder, text, images, depth, moving, c2w):
    path = fresh("vipe")
    for name in ["rgb", "pose", "intrinsics", "depth", "mask"]:
        folder("vipe", name)
    writer = imageio_ffmpeg.write_frames(
        os.path.join(path, "rgb/dog.mp4"),
        (W, H),
        fps=10,
        codec="libx264",
        macro_block_size=1,
        pix_fmt_out="yuv420p",
        output_params=["-crf", "2", "-bf", "0", "-colorspace", "bt709", "-color_range", "tv", "-vf", "scale=out_color_matrix=bt709"],
    )
    writer.send(None)
    for image in images:
        writer.send(np.ascontiguousarray(image))
    writer.close()
    inds = np.arange(N)
    np.savez(os.path.join(path, "pose/dog.npz"), data=c2w.astype(np.float32), inds=inds)
    np.savez(
        os.path.join(path, "intrinsics/dog.npz"), data=np.tile([FX, FY, CX, CY], (N, 1)).astype(np.float32), inds=inds
    )
    text(os.path.join(path, "intrinsics/dog_camera.txt"), "".join(f"{i}: PINHOLE\n" for i in inds))
    with zipfile.ZipFile(os.path.join(path, "depth/dog.zip"), "w", zipfile.ZIP_DEFLATED) as z:
        for i in range(N):
            half = depth[i].astype(np.float16)
            half[depth[i] == 0] = np.nan
            name = os.path.join(path, f"{i:05}.exr")
            OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, {"Z": half}).write(name)
            with open(name, "rb") as file:
                z.writestr(zipfile.ZipInfo(f"{i:05}.exr"), file.read(), zipfile.ZIP_DEFLATED)
            os.remove(name)
    with zipfile.ZipFile(os.path.join(path, "mask/dog.zip"), "w", zipfile.ZIP_DEFLATED) as z:
        for i in range(N):
            ids = moving[i].astype(np.uint8) * 2
            ids[:3] = 1  # the sky
            out = io.BytesIO()
            Image.fromarray(ids).save(out, "png")
            z.writestr(zipfile.ZipInfo(f"{i:05}.png"), out.getvalue(), zipfile.ZIP_DEFLATED)
    text(os.path.join(path, "mask/dog.txt"), "1: sky\n2: dog\n")


main(sys.argv[1])
