"""An ONNX file with the inputs and outputs of MoGe-2's official export, whose geometry is known.

python3 oracles/moge_onnx.py fixtures/moge2/door.onnx      needs the Python package onnx

Of a picture of h x w pixels, R and B from 0 to 1, half its diagonal d, and u, v the places of its pixels from the middle in units of d:

    depth z = 1 + R + y / h;    points (u z / f, v z / f, z - 0.25) with f = 1.25;    mask = 0.9 B;    normal (0, 0, -2)
    metric_scale = num_tokens / 1000

so that the focal length is 1.25 d pixels, the offset 0.25, and the depth z num_tokens / 1000 metres.
"""

import sys

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

FOCAL, SHIFT = 1.25, 0.25
nodes, constants = [], []


def constant(name, value, dtype=np.float32):
    constants.append(numpy_helper.from_array(np.asarray(value, dtype), name))
    return name


def node(kind, inputs, name, **attributes):
    nodes.append(helper.make_node(kind, inputs, [name], **attributes))
    return name


def places(side, axis, shape):
    """From the middle, pixels, as a tensor of `shape` with the side at -1."""
    size = node("Gather", ["shape", constant(f"{side}_axis", axis, np.int64)], f"{side}_int")
    zero, one = constant(f"{side}_zero", 0, np.int64), constant(f"{side}_one", 1, np.int64)
    index = node("Range", [zero, size, one], f"{side}_range")
    index = node("Cast", [index], f"{side}_index", to=TensorProto.FLOAT)
    size = node("Cast", [size], side, to=TensorProto.FLOAT)
    half = node("Div", [size, constant(f"{side}_two", 2.0)], f"{side}_half")
    middle = node("Add", [index, constant(f"{side}_middle", 0.5)], f"{side}_centre")
    places = node("Sub", [middle, half], f"{side}_places")
    return node("Reshape", [places, constant(f"{side}_shape", shape, np.int64)], f"{side}_at"), middle


node("Shape", ["image"], "shape")
y, row = places("h", 2, [1, -1, 1])
x, _ = places("w", 3, [1, 1, -1])
h2, w2 = node("Mul", ["h", "h"], "h2"), node("Mul", ["w", "w"], "w2")
diagonal = node("Sqrt", [node("Add", [h2, w2], "sum")], "diagonal")
d = node("Div", [diagonal, constant("two", 2.0)], "d")
channel = lambda name, i: node("Gather", ["image", constant(f"{name}_at", i, np.int64)], name, axis=1)
down = node("Div", [row, "h"], "down")
down = node("Reshape", [down, constant("down_shape", [1, -1, 1], np.int64)], "down_at")
z = node("Add", [node("Add", [channel("red", 0), constant("one", 1.0)], "z_red"), down], "z")
focal = node("Mul", [d, constant("focal", FOCAL)], "focal_px")
side = lambda name, at: node("Mul", [node("Div", [at, focal], f"{name}_slope"), z], name)
columns = [side("px", x), side("py", y), node("Sub", [z, constant("shift", SHIFT)], "pz")]
columns = [node("Unsqueeze", [c, constant(f"{c}_axis", [3], np.int64)], f"{c}_column") for c in columns]
node("Concat", columns, "points", axis=3)
node("Mul", [channel("blue", 2), constant("mask_by", 0.9)], "mask")
node("Add", [node("Mul", ["points", constant("none", 0.0)], "nowhere"), constant("towards", [0.0, 0.0, -2.0])], "normal")
tokens = node("Cast", ["num_tokens"], "tokens", to=TensorProto.FLOAT)
scale = node("Div", [tokens, constant("thousand", 1000.0)], "scale")
node("Reshape", [scale, constant("scale_shape", [1], np.int64)], "metric_scale")

picture = ["batch_size", 3, "height", "width"]
map_of = lambda name, *more: helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch_size", "height", "width", *more])
graph = helper.make_graph(
    nodes,
    "moge_door",
    [
        helper.make_tensor_value_info("image", TensorProto.FLOAT, picture),
        helper.make_tensor_value_info("num_tokens", TensorProto.INT64, []),
    ],
    [
        map_of("points", 3),
        map_of("normal", 3),
        map_of("mask"),
        helper.make_tensor_value_info("metric_scale", TensorProto.FLOAT, ["batch_size"]),
    ],
    constants,
)
model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 14)], ir_version=8)
onnx.checker.check_model(model, full_check=True)
onnx.save(model, sys.argv[1])
