#!/usr/bin/env python3
"""Writes the pickle of a checkpoint as TAPIP3D's authors publish theirs: tensors under `weight`, an OmegaConf object under `cfg`.

    python3 oracles/tapip3d_published.py fixtures/tapip3d

The names and shapes are those of `keys.txt`, the configuration is that of `config.json`, by Python's pickle and OmegaConf 2.3. The
numbers are not in a pickle of PyTorch but beside it, in `data/0`, `data/1` and so on, in the order of `keys.txt`. PyTorch is not
needed: what its pickles name are stand-ins here.
"""

import collections
import json
import pickle
import sys
import types
from pathlib import Path

from omegaconf import OmegaConf

torch, utils = types.ModuleType("torch"), types.ModuleType("torch._utils")


def _rebuild_tensor_v2(*_):
    raise NotImplementedError


class FloatStorage:
    pass


_rebuild_tensor_v2.__module__ = "torch._utils"
FloatStorage.__module__ = "torch"
torch.FloatStorage, torch._utils, utils._rebuild_tensor_v2 = FloatStorage, utils, _rebuild_tensor_v2
sys.modules |= {"torch": torch, "torch._utils": utils}


class Storage:
    def __init__(self, key, numbers):
        self.key, self.numbers = key, numbers


class Tensor:
    def __init__(self, key, shape):
        self.shape, self.strides, numbers = tuple(shape), [], 1
        for side in reversed(self.shape):
            self.strides.insert(0, numbers)
            numbers *= side
        self.storage = Storage(key, numbers)

    def __reduce__(self):
        return _rebuild_tensor_v2, (self.storage, 0, self.shape, tuple(self.strides), False, collections.OrderedDict())


class Pickler(pickle.Pickler):
    def persistent_id(self, held):
        return ("storage", FloatStorage, held.key, "cpu", held.numbers) if isinstance(held, Storage) else None


def main():
    folder = Path(sys.argv[1])
    weight = collections.OrderedDict()
    for i, line in enumerate((folder / "keys.txt").read_text().splitlines()):
        name, *shape = line.split()
        weight[name] = Tensor(str(i), map(int, shape))
    model = json.loads((folder / "config.json").read_text())
    dataset = {"name": "kubric", "resolution": model.pop("image_size"), "weights": [0.5, None, True, -3]}
    model["image_size"] = "${train_dataset.resolution}"
    cfg = OmegaConf.create({"seed": 7, "model": model, "train_dataset": dataset, "optimiser": {"lr": 5e-4}})
    with (folder / "published.pkl").open("wb") as file:
        Pickler(file, 2).dump({"cfg": cfg, "weight": weight, "global_step": 100})


if __name__ == "__main__":
    main()
