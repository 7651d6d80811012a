"""Makes fixtures/metrics/image.json and its pictures: PSNR and SSIM by scikit-image, OpenCV, PyTorch and DyCheck's formulas.

    python3 oracles/image_metrics.py fixtures

Needs NumPy, SciPy, Pillow, scikit-image and OpenCV. Colours are the bytes of the pictures as float32 over 255, then float64.
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.signal import convolve2d
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

OUT = Path(sys.argv[1]) / "metrics"
HEIGHT, WIDTH = 41, 58


def made_up():
    """A picture, what a renderer made of it (float32, some beyond 0..1), and masks: a blob, scattered pixels, a corner."""
    rng = np.random.default_rng(20260)
    smooth = gaussian_filter(rng.random((HEIGHT, WIDTH, 3)), (4, 4, 0))
    smooth = (smooth - smooth.min()) / (smooth.max() - smooth.min())
    reference = np.round(255 * np.clip(smooth + 0.08 * rng.standard_normal(smooth.shape), 0, 1)).astype(np.uint8)
    gain = np.array([1.04, 0.97, 1.0])
    image = gaussian_filter(smooth, (1, 1, 0)) * gain + 0.05 * rng.standard_normal(smooth.shape) * [0.3, 1, 2]
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    blob = (x - 20) ** 2 + 1.7 * (y - 18) ** 2 < 14**2
    scattered = rng.random((HEIGHT, WIDTH)) < 0.04
    scattered[:, 30:] = False
    corner = (x > WIDTH - 5) & (y > HEIGHT - 4)
    return reference, np.round(image, 4).astype(np.float32), {"blob": blob, "scattered": scattered, "corner": corner}


def psnr(a, b, where):
    return float(-10 * np.log10(np.mean((a - b)[where] ** 2)))


def gaussian():
    d = np.arange(11) - 5.0
    g = np.exp(-(d**2) / (2 * 1.5**2))
    return g / g.sum()


def ssim_zero_padded(a, b):
    """3D Gaussian Splatting's training SSIM: a depthwise convolution padded with zeros, in 2D at once. The map."""
    window = np.outer(gaussian(), gaussian())
    mean = lambda v: np.stack([convolve2d(v[..., c], window, mode="same", boundary="fill") for c in range(3)], -1)
    ma, mb = mean(a), mean(b)
    va, vb, cov = mean(a * a) - ma**2, mean(b * b) - mb**2, mean(a * b) - ma * mb
    c1, c2 = 0.01**2, 0.03**2
    return (2 * ma * mb + c1) * (2 * cov + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2))


def dycheck_psnr(a, b, mask):
    """compute_psnr of dycheck/core/metrics/image.py with its masked_mean."""
    m = np.broadcast_to(mask[..., None].astype(np.float64), a.shape)
    return float(-10 / np.log(10) * np.log((((a - b) ** 2) * m).sum() / max(m.sum(), 1e-6)))


def dycheck_ssim(a, b, mask):
    """compute_ssim of the same file."""
    taps = gaussian()

    def along(z, m, f):
        ones = np.ones_like(f)
        total = convolve2d(z * m, f, mode="valid")
        count = np.round(convolve2d(m, ones, mode="valid"))
        return np.where(count != 0, total * ones.sum() / np.where(count != 0, count, 1), 0.0), (count != 0).astype(float)

    def mean(v):
        planes = []
        for c in range(3):
            z, m = along(v[..., c], mask.astype(np.float64), taps[None, :])
            planes.append(along(z, m, taps[:, None])[0])
        return np.stack(planes, -1)

    ma, mb = mean(a), mean(b)
    va, vb, cov = mean(a**2) - ma * ma, mean(b**2) - mb * mb, mean(a * b) - ma * mb
    va, vb = np.maximum(0.0, va), np.maximum(0.0, vb)
    cov = np.sign(cov) * np.minimum(np.sqrt(va * vb), np.abs(cov))
    c1, c2 = 0.01**2, 0.03**2
    return float(((2 * ma * mb + c1) * (2 * cov + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2))).mean())


def flow_pair():
    """Flow there and back that agree in most places, float32 [h][w][2], and who is not occluded by Brox et al.'s check."""
    rng = np.random.default_rng(7)
    y, x = np.mgrid[:12, :16].astype(np.float64)
    there = np.stack([2.3 + 0.1 * y, -1.4 + 0.05 * x], -1) + 0.2 * rng.standard_normal((12, 16, 2))
    back = np.stack([-2.6 + 0.02 * x, 1.2 - 0.04 * y], -1) + 0.4 * rng.standard_normal((12, 16, 2))
    back[4:7, 5:9] += 3
    there, back = there.astype(np.float32), back.astype(np.float32)
    seen = np.zeros((12, 16), bool)
    for j in range(12):
        for i in range(16):
            f = there[j, i].astype(np.float64)
            px, py = i + f[0], j + f[1]
            x0, y0 = int(np.floor(px)), int(np.floor(py))
            b = np.zeros(2)
            for dx in (0, 1):
                for dy in (0, 1):
                    if 0 <= x0 + dx < 16 and 0 <= y0 + dy < 12:
                        b += (1 - abs(px - x0 - dx)) * (1 - abs(py - y0 - dy)) * back[y0 + dy, x0 + dx]
            seen[j, i] = ((f + b) ** 2).sum() <= 0.01 * (f @ f + b @ b) + 0.5
    grid = np.stack(np.meshgrid(np.arange(16, dtype=np.float32), np.arange(12, dtype=np.float32)), -1) + there
    there_back = cv2.remap(back, grid[..., 0], grid[..., 1], cv2.INTER_LINEAR)
    by_opencv = ~(((there + there_back) ** 2).sum(-1) > 0.01 * (there**2 + there_back**2).sum(-1) + 0.5)
    print("covisible", seen.mean(), "OpenCV says otherwise at", int((seen != by_opencv).sum()))
    return there, back, seen


def main():
    OUT.mkdir(parents=True, exist_ok=True)
    reference, raw, masks = made_up()
    image = np.clip(np.round(np.clip(raw, 0, 1) * 255), 0, 255).astype(np.uint8)
    Image.fromarray(reference).save(OUT / "reference.png")
    Image.fromarray(image).save(OUT / "image.png")
    for name, mask in masks.items():
        Image.fromarray(mask.astype(np.uint8) * 255).save(OUT / f"mask_{name}.png")
    as_float = lambda v: (v.astype(np.float32) / np.float32(255)).astype(np.float64)
    a, b = as_float(image), as_float(reference)
    everywhere = np.ones((HEIGHT, WIDTH), bool)
    skimage = lambda **more: float(structural_similarity(a, b, channel_axis=-1, data_range=1.0, **more))
    padded = ssim_zero_padded(a, b)
    out = {
        "psnr": {
            "joint": float(peak_signal_noise_ratio(b, a, data_range=1.0)),
            "per_channel": float(np.mean([psnr(a[..., c], b[..., c], everywhere) for c in range(3)])),
            "eight_bit": float(cv2.PSNR(image, reference)),
        },
        # of what the renderer made before it was clamped and rounded
        "psnr_unclamped": {
            "joint": psnr(raw.astype(np.float64), b, everywhere),
            "per_channel": float(
                np.mean([psnr(raw[..., c].astype(np.float64), b[..., c], everywhere) for c in range(3)])
            ),
            "eight_bit": float(cv2.PSNR(image, reference)),
        },
        "ssim": {
            "gaussian_valid": skimage(gaussian_weights=True, sigma=1.5, use_sample_covariance=False),
            "gaussian_zero_padded": float(padded.mean()),
            "skimage_uniform": skimage(),
            "dycheck_masked": dycheck_ssim(a, b, everywhere),
        },
        "masked": {},
        "raw": [round(float(v), 4) for v in raw.ravel()],
    }
    _, full = structural_similarity(
        a, b, channel_axis=-1, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, full=True
    )
    _, uniform = structural_similarity(a, b, channel_axis=-1, data_range=1.0, full=True)
    for name, mask in masks.items():
        crop = lambda v, p: v[p:-p, p:-p]
        inside = lambda v, p: float(crop(v, p)[crop(mask, p)].mean()) if crop(mask, p).any() else None
        out["masked"][name] = {
            "psnr": {
                "joint": dycheck_psnr(a, b, mask),
                "per_channel": float(np.mean([psnr(a[..., c], b[..., c], mask) for c in range(3)])),
            },
            "ssim": {
                "gaussian_valid": inside(full, 5),
                "gaussian_zero_padded": float(padded[mask].mean()),
                "skimage_uniform": inside(uniform, 3),
                "dycheck_masked": dycheck_ssim(a, b, mask),
            },
        }
    there, back, seen = flow_pair()
    out["flow"] = {
        "forward": [float(v) for v in there.ravel()],
        "backward": [float(v) for v in back.ravel()],
        "seen": [int(v) for v in seen.ravel()],
    }
    print(json.dumps({k: v for k, v in out.items() if k not in ("raw", "flow")}, indent=1))
    (OUT / "image.json").write_text(json.dumps(out) + "\n")


main()
