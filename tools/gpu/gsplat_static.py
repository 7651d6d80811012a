#!/usr/bin/env python3
"""Trains static 3D Gaussians with gsplat on a capture, and measures it: a public trainer to compare ours with.

    tools/gpu/gsplat_static.py CAPTURE [--splats 100000] [--iterations 5000] [--held-out SCENE] [--compare 500]
    tools/gpu/gsplat_static.py CAPTURE --dry-run     # reads and initialises on the CPU, without gsplat and a GPU

CAPTURE is what `minute4d geometry` and `minute4d import` write, or a scene of tools/bench (true cameras and depth). Needs
torch with CUDA, gsplat 1.5, numpy and Pillow. A JSON line on stdout has the results, stderr what happens.

The training is that of gsplat's examples/simple_trainer.py: a random frame per step, `gsplat.rasterization`, a loss of
0.8 L1 + 0.2 (1 - SSIM), Adam with its learning rates (the rate of positions times the extent of the cameras, and falling
to a hundredth). Different are these points:

- No density control: the number of splats stays. They start at random pixels with depth (static ones, where the capture has
  masks), as large as the mean distance to their three nearest neighbours.
- All data is on the GPU before the clock starts; colours of degree 0 are not evaluated as harmonics, which is faster.
- One Adam (fused) has a group per parameter, where simple_trainer has an Adam for each.
- SSIM is fused_ssim if it can be imported, as there, else two convolutions by 11 taps in torch.

50 steps warm up; then training starts from the beginning. Seconds are those of the wall clock between two synchronisations, and
milliseconds per step are those of the fastest of the `--repeats`.
There is no CUDA graph: gsplat reads the number of pairs of splat and tile back in every step, which a graph cannot contain.

Scenes move, and static splats cannot: `--ignore-dynamic` leaves the masked pixels out of the loss. PSNR is in dB, joint over
channels, of colours in 8 bits, the mean over views; static is outside the masks (`minute4d eval` scores in the same way).
"""

import argparse
import dataclasses
import json
import math
import pathlib
import sys
import time

import numpy as np
import torch
from PIL import Image

try:
    from fused_ssim import fused_ssim
except ImportError:
    fused_ssim = None

# Learning rates of simple_trainer; that of `means` is multiplied by the extent of the cameras.
RATES = {"means": 1.6e-4, "scales": 5e-3, "quats": 1e-3, "opacities": 5e-2, "sh0": 2.5e-3, "shN": 2.5e-3 / 20}
MEANS_DECAY = 0.01  # rate of the last step as a share of the first
DEGREE_EVERY = 1000  # steps until the next degree of the harmonics is used
WARM_UP_STEPS = 50
WARM_UP_RENDERS = 20
SSIM_WEIGHT = 0.2
SH_0 = 0.28209479177387814  # harmonic of degree 0
LISTS = {"far": "transforms_test.json", "near": "transforms_near.json", "between": "transforms_between.json"}


@dataclasses.dataclass
class Views:
    """Posed images: `images` [n][h][w][3] uint8; `c2w` [n][4][4], OpenCV axes; `intrinsics` [n][3][3], pixels, the centre of the
    first pixel at 0.5; `times` [n]; `depth` [n][h][w] in the unit of the poses, 0 = unknown; `dynamic` [n][h][w] bool."""

    images: np.ndarray
    c2w: np.ndarray
    intrinsics: np.ndarray
    times: np.ndarray
    depth: np.ndarray | None
    dynamic: np.ndarray | None


def say(*text):
    print(*text, file=sys.stderr, flush=True)


def read_poses(path):
    """The list of frames, its frames sorted by time, and their poses [n][4][4] in OpenCV axes."""
    listing = json.loads(path.read_text())
    frames = listing["frames"]
    times = [frame.get("time", index) for index, frame in enumerate(frames)]
    frames = [dict(frame, time=t) for t, frame in sorted(zip(times, frames), key=lambda pair: pair[0])]
    c2w = np.array([frame["transform_matrix"] for frame in frames], dtype=np.float64)
    if listing.get("axes", "opengl") == "opengl":
        c2w[:, :3, 1:3] *= -1
    return listing, frames, c2w


def read_views(path):
    """Reads a list of frames with its images, depth maps and masks."""
    listing, frames, c2w = read_poses(path)

    def maps(key, convert):
        if not all(frame.get(key) for frame in frames):
            return None
        return np.stack([convert(Image.open(path.parent / frame[key])) for frame in frames])

    images = maps("file_path", lambda image: np.asarray(image.convert("RGB")))
    height, width = images.shape[1:3]
    intrinsics = np.zeros((len(frames), 3, 3))
    for k, frame in zip(intrinsics, frames):
        lens = {**listing, **frame}
        if any(lens.get(key, 0) for key in ("k1", "k2", "k3", "k4", "p1", "p2")):
            sys.exit(f"{path}: its images are distorted; `minute4d import` removes the distortion")
        # a list may be of images of another size
        x, y = width / lens.get("w", width), height / lens.get("h", height)
        k[0] = lens["fl_x"] * x, 0, lens.get("cx", width / x / 2) * x
        k[1] = 0, lens.get("fl_y", lens["fl_x"]) * y, lens.get("cy", height / y / 2) * y
        k[2, 2] = 1
    unit = listing.get("depth_unit_scale_factor", 0.001)
    depth = maps("depth_file_path", lambda image: np.asarray(image).astype(np.float32) * np.float32(unit))
    dynamic = maps("mask_path", lambda image: np.asarray(image.convert("L")) > 127)
    for what in (depth, dynamic):
        if what is not None and what.shape != images.shape[:3]:
            sys.exit(f"{path}: depth maps and masks must have the size of the images, {width}x{height}")
    return Views(images, c2w, intrinsics, np.array([frame["time"] for frame in frames]), depth, dynamic)


def extent(c2w):
    """Radius of the cameras about their mean, in the unit of the poses."""
    centres = c2w[:, :3, 3]
    return float(np.linalg.norm(centres - centres.mean(0), axis=1).max())


def sample_points(views, count, seed):
    """Positions [count][3] and colours [count][3], 0..1, of different random pixels that have depth and are static."""
    usable = views.depth > 0
    if views.dynamic is not None:
        usable &= ~views.dynamic
    usable = np.flatnonzero(usable)
    if len(usable) < count:
        sys.exit(f"the capture has {len(usable)} static pixels with depth; choose fewer --splats")
    chosen = np.random.default_rng(seed).choice(usable, count, replace=False)
    frame, row, column = np.unravel_index(chosen, views.depth.shape)
    k, z = views.intrinsics[frame], views.depth[frame, row, column]
    x = (column + 0.5 - k[:, 0, 2]) / k[:, 0, 0] * z
    y = (row + 0.5 - k[:, 1, 2]) / k[:, 1, 1] * z
    pose = views.c2w[frame]
    points = np.einsum("nij,nj->ni", pose[:, :3, :3], np.stack([x, y, z], 1)) + pose[:, :3, 3]
    return points.astype(np.float32), views.images[frame, row, column].astype(np.float32) / 255


def spacing(points):
    """Root mean square distance to the three nearest neighbours, [n]."""
    result = []
    for part in points.split(max(1, 100_000_000 // len(points))):
        distances = torch.cdist(part, points, compute_mode="donot_use_mm_for_euclid_dist")
        result.append(distances.topk(4, largest=False).values[:, 1:].square().mean(1).sqrt())
    return torch.cat(result)


def initialise(points, colours, degree, opacity, seed):
    """The parameters of the splats before training, on the device of `points`."""
    n, device = len(points), points.device
    chance = torch.Generator().manual_seed(seed)
    sizes = spacing(points)
    sizes = sizes.clamp_min(sizes.median() * 1e-3)
    splats = {
        "means": points.clone(),
        "scales": sizes.log()[:, None].repeat(1, 3),
        "quats": torch.rand((n, 4), generator=chance).to(device),
        "opacities": torch.full((n,), math.log(opacity / (1 - opacity)), device=device),
        "sh0": ((colours - 0.5) / SH_0)[:, None],
    }
    if degree > 0:
        splats["shN"] = torch.zeros((n, (degree + 1) ** 2 - 1, 3), device=device)
    return splats


def activate(splats):
    """The arguments of `gsplat.rasterization` that depend on the splats."""
    values = {
        "means": splats["means"],
        "quats": splats["quats"],
        "scales": splats["scales"].exp(),
        "opacities": splats["opacities"].sigmoid(),
    }
    if "shN" in splats:
        values["colors"] = torch.cat([splats["sh0"], splats["shN"]], 1)
    else:
        values["colors"] = (splats["sh0"][:, 0] * SH_0 + 0.5).clamp_min(0)
    return values


class Cameras:
    """Cameras on the GPU, images [n][3][h][w] and static pixels [n][h][w]."""

    def __init__(self, views, device):
        self.size = {"width": views.images.shape[2], "height": views.images.shape[1]}
        to = lambda array: torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32)).to(device)
        self.w2c = to(np.linalg.inv(views.c2w))[:, None]
        self.intrinsics = to(views.intrinsics)[:, None]
        self.images = torch.from_numpy(views.images).to(device).permute(0, 3, 1, 2).contiguous().float().div_(255)
        self.static = None if views.dynamic is None else torch.from_numpy(~views.dynamic).to(device)

    def __len__(self):
        return len(self.images)


class Trainer:
    """Trains and renders splats for the cameras of a capture."""

    def __init__(self, cameras, given, scale, near):
        from gsplat import rasterization

        self.rasterization, self.cameras, self.given, self.scale = rasterization, cameras, given, scale
        self.options = {"near_plane": near, "rasterize_mode": "antialiased" if given.antialiased else "classic"}
        taps = torch.exp(-((torch.arange(11.0) - 5) ** 2) / (2 * 1.5**2))
        self.taps = (taps / taps.sum()).to(cameras.images.device)

    def render(self, values, cameras, index, degree, packed=False):
        """The image [3][h][w] of a camera, and what gsplat reports."""
        images, _, report = self.rasterization(
            **values,
            viewmats=cameras.w2c[index],
            Ks=cameras.intrinsics[index],
            **cameras.size,
            **self.options,
            sh_degree=degree if degree > 0 or values["colors"].dim() == 3 else None,
            packed=packed,
        )
        return images[0].permute(2, 0, 1), report

    def loss(self, image, target, fused):
        image = image.contiguous()
        similarity = fused_ssim(image[None], target[None], padding="valid") if fused else ssim(image, target, self.taps)
        return (1 - SSIM_WEIGHT) * (image - target).abs().mean() + SSIM_WEIGHT * (1 - similarity)

    def train(self, start, steps, packed=False, visible_adam=False, fused=True):
        """Trains from `start`, which stays as it is. Returns the splats and the seconds."""
        given, cameras = self.given, self.cameras
        fused = fused and fused_ssim is not None
        splats = {name: value.clone().requires_grad_() for name, value in start.items()}
        rates = {**RATES, "means": RATES["means"] * self.scale}
        groups = [{"params": [value], "lr": rates[name]} for name, value in splats.items()]
        if visible_adam:
            from gsplat.optimizers import SelectiveAdam

            adam = SelectiveAdam(groups, eps=1e-15, betas=(0.9, 0.999))
        else:
            adam = torch.optim.Adam(groups, eps=1e-15, fused=True)
        order = np.random.default_rng(given.seed).integers(len(cameras), size=steps).tolist()
        torch.cuda.synchronize()
        clock = time.perf_counter()
        for step, index in enumerate(order):
            degree = min(step // DEGREE_EVERY, given.sh_degree)
            image, report = self.render(activate(splats), cameras, index, degree, packed)
            target = cameras.images[index]
            if given.ignore_dynamic:
                image = torch.where(cameras.static[index], image, target)
            self.loss(image, target, fused).backward()
            adam.param_groups[0]["lr"] = rates["means"] * MEANS_DECAY ** (step / steps)
            if visible_adam:
                adam.step((report["radii"] > 0).all(-1).any(0))
            else:
                adam.step()
            adam.zero_grad(set_to_none=True)
        torch.cuda.synchronize()
        seconds = time.perf_counter() - clock
        return {name: value.detach() for name, value in splats.items()}, seconds

    @torch.no_grad()
    def score(self, splats, cameras):
        """Mean PSNR over the views: of whole images, and of static pixels if there are masks."""
        values, whole, static = activate(splats), [], []
        for index in range(len(cameras)):
            image, _ = self.render(values, cameras, index, self.given.sh_degree)
            image = image.clamp(0, 1).mul(255).round().div(255)
            error = (image - cameras.images[index]).square()
            whole.append(psnr(error.mean()))
            if cameras.static is not None:
                kept = cameras.static[index]
                static.append(psnr((error * kept).sum() / (3 * kept.sum())))
        mean = lambda values: round(float(np.mean(values)), 3) if values else None
        return {"views": len(cameras), "psnr_db": mean(whole), "static_psnr_db": mean(static)}

    @torch.no_grad()
    def renders_per_second(self, splats, count, packed=False):
        """Frames per second of the training views in turn, without reading them back."""
        values = activate(splats)
        for index in range(-WARM_UP_RENDERS, count):
            if index == 0:
                torch.cuda.synchronize()
                clock = time.perf_counter()
            self.render(values, self.cameras, index % len(self.cameras), self.given.sh_degree, packed)
        torch.cuda.synchronize()
        return round(count / (time.perf_counter() - clock), 1)

    def compare(self, splats, steps):
        """Milliseconds per step of gsplat's other modes, and renders per second, from trained splats on."""
        variants = [("default", {}), ("packed", {"packed": True}), ("adam of visible splats", {"visible_adam": True})]
        if fused_ssim is not None:
            variants.append(("ssim in torch", {"fused": False}))
        rows = {}
        for name, options in variants:
            self.train(splats, WARM_UP_STEPS, **options)
            rows[name] = {"ms_per_step": round(1000 * self.train(splats, steps, **options)[1] / steps, 3)}
        rows["packed"]["renders_per_second"] = self.renders_per_second(splats, self.given.renders, packed=True)
        return rows


def ssim(a, b, taps):
    """Mean SSIM of images [c][h][w], 0..1: a Gaussian window of 11 pixels, sigma 1.5, where it fits into the image."""
    planes = torch.cat([a, b, a * a, b * b, a * b])
    n = len(planes)
    planes = torch.nn.functional.conv2d(planes, taps.view(1, 1, 1, 11).expand(n, 1, 1, 11), groups=n)
    planes = torch.nn.functional.conv2d(planes, taps.view(1, 1, 11, 1).expand(n, 1, 11, 1), groups=n)
    mean_a, mean_b, aa, bb, ab = planes.chunk(5)
    aa, bb, ab = aa - mean_a * mean_a, bb - mean_b * mean_b, ab - mean_a * mean_b
    c1, c2 = 0.01**2, 0.03**2
    top = (2 * mean_a * mean_b + c1) * (2 * ab + c2)
    return (top / ((mean_a * mean_a + mean_b * mean_b + c1) * (aa + bb + c2))).mean()


def psnr(error):
    return min(-10 * math.log10(max(float(error), 1e-10)), 100.0)


def other_world(views, scene):
    """Why the poses of a scene are not in the world of the capture; None if they are."""
    path = scene / LISTS["far"].replace("test", "train")
    if not path.exists():
        return f"{path} does not exist, so the poses cannot be compared"
    _, frames, c2w = read_poses(path)
    times = np.array([frame["time"] for frame in frames], dtype=np.float64)
    gaps = np.abs(views.times[:, None] - times)
    nearest = gaps.argmin(1)
    both = gaps[np.arange(len(nearest)), nearest] < 1e-4
    if not both.any():
        return "no frame of the capture has the time of one of the scene"
    ours, theirs = views.c2w[both], c2w[nearest[both]]
    beside = np.linalg.norm(ours[:, :3, 3] - theirs[:, :3, 3], axis=1).max()
    turned = np.linalg.norm(ours[:, :3, :3] - theirs[:, :3, :3], axis=(1, 2)).max() / math.sqrt(2)  # about radians
    if beside > 1e-3 * max(extent(c2w), 1e-6) or turned > 2e-3:
        return "the capture has estimated cameras, in another world than those of the scene"
    return None


def held_out(trainer, splats, views, scene, device):
    """Scores of the held-out views by list."""
    reason = other_world(views, scene)
    if reason:
        say(f"held-out views are not scored: {reason}")
        return {"skipped": reason}
    scores = {}
    for name, file in LISTS.items():
        if (scene / file).exists():
            scores[name] = trainer.score(splats, Cameras(read_views(scene / file), device))
    return scores


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=pathlib.Path)
    parser.add_argument("--splats", type=int, default=100_000)
    parser.add_argument("--iterations", type=int, default=5000)
    parser.add_argument("--sh-degree", type=int, default=0, choices=range(4))
    parser.add_argument("--opacity", type=float, default=0.1, help="of all splats at the start")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--packed", action="store_true", help="gsplat's packed mode: less memory")
    parser.add_argument("--visible-adam", action="store_true", help="gsplat's Adam, which skips splats outside the image")
    parser.add_argument("--antialiased", action="store_true", help="the Mip filter of opacities")
    parser.add_argument("--ignore-dynamic", action="store_true", help="leave the masked pixels out of the loss")
    parser.add_argument("--repeats", type=int, default=1, help="trainings; the last one is scored")
    parser.add_argument("--renders", type=int, default=600, help="frames to measure rendering with")
    parser.add_argument("--compare", type=int, default=0, metavar="STEPS", help="measure gsplat's other modes, too")
    parser.add_argument("--held-out", type=pathlib.Path, metavar="SCENE", help="score the held-out views of this scene")
    parser.add_argument("--dry-run", action="store_true", help="read and initialise on the CPU, and stop")
    given = parser.parse_args()
    if given.packed and given.visible_adam:
        parser.error("--visible-adam needs the mask of all splats, which --packed does not have")
    return given


def main():
    given = arguments()
    views = read_views(given.capture / "transforms_train.json" if given.capture.is_dir() else given.capture)
    if views.depth is None:
        sys.exit("the capture has no depth maps to place splats by")
    if given.ignore_dynamic and views.dynamic is None:
        sys.exit("--ignore-dynamic: the capture has no masks")
    frames, height, width = views.images.shape[:3]
    say(f"{frames} frames of {width}x{height}")
    device = torch.device("cpu" if given.dry_run else "cuda")
    points, colours = sample_points(views, given.splats, given.seed)
    points, colours = torch.from_numpy(points).to(device), torch.from_numpy(colours).to(device)
    start = initialise(points, colours, given.sh_degree, given.opacity, given.seed)
    distance = float(np.median(views.depth[views.depth > 0]))
    # a camera that stays in place has no extent
    scale = 1.1 * max(extent(views.c2w), 0.01 * distance)
    near = 0.01 * distance  # gsplat's default, for scenes in which distances are about 1
    result = {
        "capture": given.capture.name,
        "frames": frames,
        "width": width,
        "height": height,
        "splats": given.splats,
        "iterations": given.iterations,
        "sh_degree": given.sh_degree,
        "packed": given.packed,
        "optimizer": "visible adam" if given.visible_adam else "fused adam",
        "ssim": "torch" if fused_ssim is None else "fused_ssim",
        "antialiased": given.antialiased,
        "ignore_dynamic": given.ignore_dynamic,
        "scene_scale": round(scale, 5),
        "median_depth": round(distance, 5),
        "median_splat_size": round(float(start["scales"].exp().median()), 6),
        "dynamic_share": None if views.dynamic is None else round(float(views.dynamic.mean()), 5),
    }
    if given.dry_run:
        if given.held_out:
            result["held_out"] = {"skipped": other_world(views, given.held_out)}
            for name, file in LISTS.items():
                if (given.held_out / file).exists():
                    result["held_out"][name] = len(read_views(given.held_out / file).images)
        print(json.dumps(result))
        return

    import gsplat

    # SSIM is a difference of squares, which needs all the bits
    torch.backends.cudnn.allow_tf32 = False
    torch.backends.cudnn.benchmark = True
    cameras = Cameras(views, device)
    trainer = Trainer(cameras, given, scale, near)
    how = {"packed": given.packed, "visible_adam": given.visible_adam}
    say("warming up")
    torch.cuda.empty_cache()
    trainer.train(start, WARM_UP_STEPS, **how)
    torch.cuda.reset_peak_memory_stats()
    data = torch.cuda.memory_allocated()
    seconds = []
    for _ in range(max(given.repeats, 1)):
        splats, elapsed = trainer.train(start, given.iterations, **how)
        seconds.append(elapsed)
        say(f"{given.iterations} steps in {elapsed:.2f} s")
    result |= {
        "gpu": torch.cuda.get_device_name(),
        "torch": torch.__version__,
        "gsplat": gsplat.__version__,
        "seconds": [round(s, 3) for s in seconds],
        "ms_per_step": round(1000 * min(seconds) / given.iterations, 3),
        "memory_before_mb": round(data / 1e6, 1),
        "memory_peak_allocated_mb": round(torch.cuda.max_memory_allocated() / 1e6, 1),
        "memory_peak_reserved_mb": round(torch.cuda.max_memory_reserved() / 1e6, 1),
        "finite": all(bool(value.isfinite().all()) for value in splats.values()),
        "start": trainer.score(start, cameras),
        "training": trainer.score(splats, cameras),
        "renders_per_second": trainer.renders_per_second(splats, given.renders, given.packed),
    }
    if given.held_out:
        result["held_out"] = held_out(trainer, splats, views, given.held_out, device)
    if given.compare:
        result["compare"] = trainer.compare(splats, given.compare)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
