"""Makes fixtures/unidepth_v2: UniDepth's published module of mid 2024 on weights by a formula.

    python3 oracles/unidepth_v2.py SOURCE fixtures [--write]

SOURCE is a checkout of lpiccinelli-eth/UniDepth at commit bebc4b2 (1 July 2024). Needs PyTorch, NumPy, einops and safetensors. Without
--write the fixture that is there is compared with the module: largest difference of each tensor, as a share of its largest value.

The module runs in float64 throughout; what it would compute in float32 for speed is done in float64, too. Packages that it imports for
training, plots or downloads are replaced by nothing; xformers' Nystrom attention by plain attention, which is what it computes where
there are no more tokens than landmarks (8 heads, which it takes for tokens, and 128 landmarks).
"""

import importlib.abc
import importlib.machinery
import json
import sys
import types
from functools import partial
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import torch
from safetensors.numpy import load_file, save_file

SOURCE, OUT = map(Path, sys.argv[1:3])
PATCHES, BLOCKS, WIDTH = 48, 5, 128
FOLDER = OUT / "unidepth_v2"

torch.set_default_dtype(torch.float64)
torch.float32 = torch.float64
torch.Tensor.float = torch.Tensor.double


def attention(q, k, v, **_):
    return torch.softmax(q @ k.transpose(-2, -1) / q.shape[-1] ** 0.5, -1) @ v


class Nystrom(torch.nn.Module):
    def __init__(self, num_landmarks, **_):
        super().__init__()
        self.landmarks = num_landmarks

    def forward(self, q, k, v, **_):
        assert k.shape[-2] <= self.landmarks
        return attention(q, k, v)


class Absent(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Modules without contents in place of packages that are not needed."""

    NAMES = {"cv2", "huggingface_hub", "matplotlib", "scipy", "timm", "torchvision", "wandb", "PIL"}

    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in self.NAMES:
            return importlib.machinery.ModuleSpec(name, self, is_package=True)

    def create_module(self, spec):
        module = types.ModuleType(spec.name)
        module.__getattr__ = lambda _: MagicMock()
        return module

    def exec_module(self, module):
        pass


def prepare():
    sys.meta_path.insert(0, Absent())
    xformers = types.ModuleType("xformers.components.attention")
    xformers.NystromAttention = Nystrom
    for name in ["xformers", "xformers.components"]:
        sys.modules[name] = types.ModuleType(name)
    sys.modules[xformers.__name__] = xformers
    import huggingface_hub
    import timm.models.layers
    import torchvision.transforms.functional as functional

    class Hub:
        def __init_subclass__(cls, **_):
            pass

    huggingface_hub.PyTorchModelHubMixin = Hub
    timm.models.layers.trunc_normal_ = torch.nn.init.trunc_normal_ = lambda weight, **_: weight
    column = lambda values: torch.tensor(values)[:, None, None]
    functional.normalize = lambda x, mean, std: (x - column(mean)) / column(std)
    torch.nn.functional.scaled_dot_product_attention = attention
    sys.path.insert(0, str(SOURCE))


def filled(name, shape):
    """The fill rule of oracles/README.md."""
    key = 0xCBF29CE484222325
    for byte in name.encode():
        key = ((key ^ byte) * 0x100000001B3) % 2**64
    n = int(np.prod(shape))
    with np.errstate(over="ignore"):
        z = np.uint64(key) + np.arange(1, n + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    u = (z >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1
    last = name.split(".")[-1]
    if last == "gamma":
        v = 0.5 + 0.1 * u
    elif last.endswith("bias"):
        v = 0.02 * u
    elif last.endswith("weight"):
        v = 1 + 0.1 * u if len(shape) == 1 else u * np.sqrt(3 / np.prod(shape[1:]))
    else:
        v = 0.5 * u
    return torch.from_numpy(v.astype(np.float32).astype(np.float64).reshape(shape))


def small():
    from unidepth.models import encoder
    from unidepth.models.backbones.dinov2 import Attention, Block, DinoVisionTransformer
    from unidepth.models.unidepthv2 import UniDepthV2

    encoder.dinov2_five_blocks = lambda config: DinoVisionTransformer(
        img_size=518, patch_size=14, embed_dim=384, depth=BLOCKS, num_heads=6, init_values=1.0, block_chunks=0,
        block_fn=partial(Block, attn_class=Attention), output_idx=config["output_idx"], use_norm=config["use_norm"],
    )  # fmt: skip
    config = json.loads((SOURCE / "configs" / "config_v2_vitl14.json").read_text())
    config["model"]["pixel_decoder"]["hidden_dim"] = WIDTH
    config["model"]["pixel_encoder"].update(name="dinov2_five_blocks", output_idx=[2, 3, 4, 5])
    config["data"]["shape_constraints"]["pixels_bounds"] = [PATCHES, PATCHES]
    net = UniDepthV2(config)
    net.load_state_dict({k: filled(k, tuple(v.shape)) for k, v in net.state_dict().items()})
    return net.eval()


def keys(net):
    return "".join(" ".join([k, *map(str, v.shape)]) + "\n" for k, v in net.state_dict().items())


def large():
    """The published size, 363 million numbers."""
    from unidepth.models.unidepthv2 import UniDepthV2

    return UniDepthV2(json.loads((SOURCE / "configs" / "config_v2_vitl14.json").read_text()))


def tensors(net, image):
    out = {}
    depth, decoder = net.pixel_decoder.depth_layer, net.pixel_decoder

    def keep(module, name, pick):
        module.register_forward_hook(lambda _, given, made: out.update({name: pick(given, made)}))

    keep(net.pixel_encoder, "input_strided", lambda given, _: given[0][0, :, ::4, ::4])
    keep(net.pixel_encoder, "feature_last_strided", lambda _, made: made[0][-1].flatten(1, 2)[0, :, ::4])
    keep(depth.aggregate_16, "init_latents_strided", lambda given, _: given[0][0, :, ::4])
    keep(depth.aggregate_16, "aggregate_16_strided", lambda _, made: made[0, :, ::4])
    keep(depth.prompt_camera, "prompt_camera_strided", lambda _, made: made[0, :, ::4])
    keep(depth.process_layers[0][-1], "processed_strided", lambda _, made: made[0, :, ::4])
    for i, (rows, columns) in enumerate([(2, 2), (7, 2), (31, 1)]):
        pick = lambda _, made, rows=rows, columns=columns: made[0, ::rows, ::columns]
        keep(depth.ups[i], f"up{i}_strided", pick)
    keep(depth.to_depth, "logdepth", lambda _, made: made[0, 0, ::3, ::3])
    keep(decoder.global_layer, "scale_shift", lambda _, made: torch.stack(made).flatten())
    found = net.infer(torch.from_numpy(image).double())
    k = found["intrinsics"][0]
    out["intrinsics"] = torch.stack([k[0, 0], k[1, 1], k[0, 2], k[1, 2]])
    out["depth"] = found["depth"][0, 0]
    return {name: np.ascontiguousarray(v.detach().numpy().astype(np.float32)) for name, v in out.items()}


def main():
    prepare()
    path = FOLDER / "formula.safetensors"
    here = load_file(path)
    net = small()
    lists = {"formula.keys.txt": keys(net), "vitl.keys.txt": keys(large())}
    for name, text in lists.items():
        print(name, "agrees" if sorted(text.splitlines()) == sorted((FOLDER / name).read_text().splitlines()) else "differs")
    made = tensors(net, here["image"])
    assert set(made) | {"image"} == set(here)
    for name, values in made.items():
        error = np.abs(values - here[name]).max() / np.abs(values).max()
        print(f"{name} {values.shape} {error:.1e}")
    if "--write" in sys.argv:
        head = path.read_bytes()
        metadata = json.loads(head[8 : 8 + int.from_bytes(head[:8], "little")])["__metadata__"]
        save_file(dict(made, image=here["image"]), path, metadata=metadata)
        for name, text in lists.items():
            (FOLDER / name).write_text(text)


main()
