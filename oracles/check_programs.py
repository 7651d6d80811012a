"""Compares what other oracles state anew with the programs themselves; exit status 0 where they agree.

    python3 oracles/check_programs.py lpips fixtures             needs lpips 0.1.4, torchvision, safetensors
    python3 oracles/check_programs.py dycheck fixtures SOURCE    SOURCE: a checkout of KAIR-BAIR/dycheck; needs JAX, NumPy, Pillow

The first is `fixtures/lpips/formula.safetensors` by `lpips.LPIPS` in float64, the second the scores inside masks of
`fixtures/metrics/image.json` by `compute_psnr` and `compute_ssim`.
"""

import json
import sys
from pathlib import Path

sys.path.pop(0)  # lpips.py beside this file is not the package
import numpy as np  # noqa: E402

WHAT, FIXTURES = sys.argv[1], Path(sys.argv[2])


def formula(name, shape):
    """The numbers of oracles/README.md."""
    key = 0xCBF29CE484222325
    for byte in name.encode():
        key = ((key ^ byte) * 0x100000001B3) % 2**64
    with np.errstate(over="ignore"):
        z = np.uint64(key) + np.arange(1, int(np.prod(shape)) + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    return ((z >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1).reshape(shape)


def same(name, got, want, limit):
    error = np.abs(np.asarray(got) - want).max() / np.abs(want).max()
    print(f"{name}: {error:.1e}")
    assert error < limit, name


def check_lpips():
    import lpips
    import torch
    from safetensors.numpy import load_file

    def fill(weight, name, values):
        assert tuple(weight.shape) == values.shape, name
        weight.data = torch.from_numpy(values.astype(np.float32).astype(np.float64))

    case = load_file(FIXTURES / "lpips" / "formula.safetensors")
    a, b = (torch.from_numpy(case[name].astype(np.float64) / 255)[None] for name in ("image", "reference"))
    mask = torch.from_numpy(case["mask"] / 255.0)
    for net, scope in [("alex", "AlexNet_0"), ("vgg", "VGG16_0")]:
        model = lpips.LPIPS(net=net, pretrained=False, pnet_rand=True, spatial=True, verbose=False).double()
        convs = [layer for layer in model.net.modules() if isinstance(layer, torch.nn.Conv2d)]
        for i, conv in enumerate(convs):
            shape = tuple(conv.weight.shape)
            kernel = formula(f"{scope}/Conv_{i}/kernel", shape) * np.sqrt(6 / np.prod(shape[1:]))
            fill(conv.weight, "kernel", kernel)
            fill(conv.bias, "bias", 0.02 * formula(f"{scope}/Conv_{i}/bias", shape[:1]))
        for i, lin in enumerate(model.lins):
            weight = lin.model[-1].weight
            fill(weight, "lin", np.abs(formula(f"NetLinLayer_{i}/Conv_0/kernel", tuple(weight.shape))))
        with torch.no_grad():
            same(f"{net} map", model(a, b, normalize=True)[0, 0], case[f"{net}/map"], 1e-6)
            inside = (model(a * mask, b * mask, normalize=True)[0, 0] * mask).sum() / mask.sum()
            model.spatial = False
            same(f"{net} distance", model(a, b, normalize=True).flatten(), case[f"{net}/distance"], 1e-7)
        same(f"{net} masked", [inside], case[f"{net}/masked"], 1e-7)


def check_dycheck():
    import types
    from importlib.util import module_from_spec, spec_from_file_location
    from unittest.mock import MagicMock

    import jax
    from PIL import Image

    jax.config.update("jax_enable_x64", True)
    source = Path(sys.argv[3]) / "dycheck"

    def load(name, path):
        spec = spec_from_file_location(name, source / path)
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    # the files that the metrics need, without the package's others
    for name in ["dycheck", "dycheck.utils", "dycheck.nn", "dycheck.nn.functional"]:
        sys.modules[name] = types.ModuleType(name)
    sys.modules["dycheck.utils"].types = MagicMock()
    functional = sys.modules["dycheck.nn.functional"]
    functional.common = load("dycheck.nn.functional.common", "nn/functional/common.py")
    sys.modules["dycheck.nn"].functional = functional
    metrics = load("dycheck_image", "core/metrics/image.py")
    folder = FIXTURES / "metrics"
    read = lambda name: (np.asarray(Image.open(folder / name)).astype(np.float32) / np.float32(255)).astype(np.float64)
    image, reference = read("image.png"), read("reference.png")
    for name, want in json.loads((folder / "image.json").read_text())["masked"].items():
        mask = (read(f"mask_{name}.png") > 0.5).astype(np.float64)[..., None]
        same(f"{name} PSNR", metrics.compute_psnr(image, reference, mask), np.float64(want["psnr"]["joint"]), 1e-9)
        same(f"{name} SSIM", metrics.compute_ssim(image, reference, mask), np.float64(want["ssim"]["dycheck_masked"]), 1e-7)


{"lpips": check_lpips, "dycheck": check_dycheck}[WHAT]()
