#!/usr/bin/env python3
"""Converts the published checkpoint of TAPIP3D to safetensors, for `minute4d`.

    pip install torch numpy safetensors
    python3 tools/models/convert_tapip3d.py tapip3d_final.pth tapip3d.safetensors

The published file is a pickle of PyTorch: tensors under `weight`, and under `cfg` an OmegaConf object without which the network
cannot be used, as the scale of its space (`norm_scale`), the frames of a window and the numbers of heads cannot be told from the
tensors. Written are the tensors as they are, and into the metadata entry `config` a JSON object: the section `model` of `cfg`, with
`image_size` (rows, columns) from `train_dataset.resolution`.

Neither OmegaConf nor TAPIP3D's own code is needed, and nothing in the file is executed: of its objects only tensors, dictionaries and
lists are built, of all others what they hold is kept.
"""

import argparse
import collections
import importlib
import json
import pickle
import sys
import types
from pathlib import Path


class Held:
    """Stands for an object of any class: keeps what it holds, does nothing."""

    def __init__(self, *args, **kwargs):
        self.args, self.items, self.state = args, {}, None

    def __setstate__(self, state):
        self.state = state

    def __setitem__(self, key, value):
        self.items[key] = value

    def append(self, value):
        self.args = (*self.args, value)

    def extend(self, values):
        self.args = (*self.args, *values)

    def __call__(self, *args, **kwargs):
        return Held(*args, **kwargs)

    def __hash__(self):
        return id(self)


def harmless(module, name):
    """Whether a pickle of tensors needs this class or function, and it does nothing but build them."""
    builders = {
        "torch._utils": {"_rebuild_tensor_v2", "_rebuild_parameter", "_rebuild_tensor"},
        "torch.storage": {"UntypedStorage", "TypedStorage"},
        "collections": {"OrderedDict"},
    }
    if module == "torch":
        return name.endswith("Storage") or name in {"Size", "float16", "bfloat16", "float32", "float64", "int64"}
    return name in builders.get(module, ())


class Unpickler(pickle.Unpickler):
    def find_class(self, module, name):
        if harmless(module, name):
            return getattr(importlib.import_module(module), name)
        # a class of its own, so that `cls.__new__(cls)` of a pickle works
        return type(name, (Held,), {"__module__": module})


def pickle_module():
    """What `torch.load` takes in place of `pickle`."""
    module = types.ModuleType("held_pickle")
    module.Unpickler = Unpickler
    module.load = lambda file, **kwargs: Unpickler(file, **kwargs).load()
    return module


def plain(held):
    """Dictionaries, lists and values of an OmegaConf object, or of what is so already."""
    if isinstance(held, dict):
        return {key: plain(value) for key, value in held.items()}
    if isinstance(held, (list, tuple)):
        return [plain(value) for value in held]
    if isinstance(held, Held):
        state = held.state if isinstance(held.state, dict) else {}
        for name in ("_content", "_val"):
            if name in state:
                return plain(state[name])
        raise SystemExit(f"an object of the class {type(held).__module__}.{type(held).__name__} is not known in `cfg`")
    if held is None or isinstance(held, (bool, int, float, str)):
        return held
    raise SystemExit(f"a value of the type {type(held).__name__} is not known in `cfg`")


def resolved(value, root):
    """`value` with references such as `${train_dataset.resolution}` replaced by what they refer to in `root`."""
    for _ in range(10):
        if not (isinstance(value, str) and "${" in value):
            break
        path = value[2:-1]
        if not (value.startswith("${") and value.endswith("}") and path.replace(".", "").replace("_", "").isalnum()):
            raise SystemExit(f"`cfg` refers to {value}, which cannot be followed")
        value = root
        for key in path.split("."):
            value = value.get(key) if isinstance(value, dict) else None
    if isinstance(value, dict):
        return {key: resolved(item, root) for key, item in value.items()}
    if isinstance(value, list):
        return [resolved(item, root) for item in value]
    return value


def configuration(cfg):
    """What the loader wants to know of `cfg`."""
    root = plain(cfg)
    model = root.get("model") if isinstance(root, dict) else None
    dataset = root.get("train_dataset") if isinstance(root, dict) else None
    if not isinstance(model, dict):
        raise SystemExit("`cfg` has no section `model`: this is no checkpoint of TAPIP3D's own training")
    config = resolved(model, root)
    if "image_size" not in config:
        size = resolved((dataset or {}).get("resolution"), root)
        if not (isinstance(size, list) and len(size) == 2):
            raise SystemExit("`cfg` does not say train_dataset.resolution")
        config["image_size"] = size
    missing = [key for key in ("seq_len", "norm_mode", "norm_scale", "corr_feature", "point_updater") if key not in config]
    if missing:
        print(f"note: `cfg` leaves out {', '.join(missing)}; the defaults of upstream's constructor hold", file=sys.stderr)
    return config


def tensors(weight):
    """The state dictionary, each tensor with memory of its own."""
    import torch

    if not isinstance(weight, (dict, collections.OrderedDict)) or not weight:
        raise SystemExit("the file has no state dictionary under `weight`")
    wrong = [name for name, value in weight.items() if not isinstance(value, torch.Tensor)]
    if wrong:
        raise SystemExit(f"{wrong[0]} is no tensor")
    return {name.removeprefix("module."): value.detach().contiguous().clone() for name, value in weight.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkpoint", type=Path, help="tapip3d_final.pth")
    parser.add_argument("output", type=Path, nargs="?", help="NAME.safetensors; beside the checkpoint without it")
    args = parser.parse_args()
    try:
        import torch
        from safetensors.torch import save_file
    except ImportError as error:
        raise SystemExit(f"{error}: pip install torch numpy safetensors") from error
    output = args.output or args.checkpoint.with_suffix(".safetensors")
    checkpoint = torch.load(args.checkpoint, map_location="cpu", pickle_module=pickle_module(), weights_only=False)
    if not isinstance(checkpoint, dict) or "weight" not in checkpoint or "cfg" not in checkpoint:
        raise SystemExit(f"{args.checkpoint} has no `weight` and `cfg`: it is no checkpoint of TAPIP3D")
    config = configuration(checkpoint["cfg"])
    weight = tensors(checkpoint["weight"])
    save_file(weight, output, metadata={"format": "pt", "config": json.dumps(config, sort_keys=True)})
    numbers = sum(value.numel() for value in weight.values())
    print(f"{output}: {len(weight)} tensors, {numbers} numbers; norm_scale {config.get('norm_scale', 1.0)}")


if __name__ == "__main__":
    main()
