"""Files of MegaSaM as numpy writes them: `python3 oracles/megasam_files.py fixtures/megasam`.

Three frames of 24 x 16 pixels of a made-up clip, in the three forms that MegaSaM's scripts write (outputs, outputs_cvd,
reconstructions), from one description: pictures, depth, poses and a map of motion that follow from the formulas below.
"""

import os
import sys

import numpy as np

N, H, W = 3, 16, 24
K = np.array([[20.0, 0.0, 12.0], [0.0, 21.0, 8.5], [0.0, 0.0, 1.0]])


def main(root):
    t, y, x = np.meshgrid(np.arange(N), np.arange(H), np.arange(W), indexing="ij")
    rgb = np.stack([x * 9, y * 13, x + y + 40 * t], -1).astype(np.uint8)
    depth = (0.4 + 0.01 * x + 0.02 * y + 0.05 * t).astype(np.float32)
    depth[:, 0, :5] = 0.0  # unknown
    depth[1, 3, 3] = 250.0  # far
    # camera to world: a turn of 0.1 t about y, then a step
    c2w = np.tile(np.eye(4), (N, 1, 1))
    for i in range(N):
        s, c = np.sin(0.1 * i), np.cos(0.1 * i)
        c2w[i, :3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        c2w[i, :3, 3] = [0.2 * i, -0.05 * i, 0.1 * i]
    # high where things stand still: in frame i the block in column i of the lower row moves
    still = np.full((N, H // 8, W // 8), 0.95, np.float32)
    for i in range(N):
        still[i, 1, i] = 0.0

    def folder(name):
        path = os.path.join(root, name)
        os.makedirs(path, exist_ok=True)
        return path

    disps = 1.0 / (depth + 1e-6)
    path = folder("reconstructions/dog")
    save = lambda name, value: np.save(os.path.join(path, name + ".npy"), value)
    save("images", np.ascontiguousarray(rgb[..., ::-1].transpose(0, 3, 1, 2)))
    save("disps", disps.astype(np.float64))
    poses = np.zeros((N, 7), np.float32)
    for i in range(N):
        # world to camera: the inverse; its turn is -0.1 t about y
        poses[i, :3] = -c2w[i, :3, :3].T @ c2w[i, :3, 3]
        poses[i, 3:] = [0, -np.sin(0.05 * i), 0, np.cos(0.05 * i)]
    save("poses", poses)
    save("intrinsics", np.tile(np.float32([20.0, 21.0, 12.0, 8.5]), (N, 1)))
    save("motion_prob", still)

    np.savez(
        os.path.join(folder("outputs"), "dog_droid.npz"),
        images=rgb,
        depths=np.float32(1.0 / disps),
        intrinsic=K,
        cam_c2w=c2w.astype(np.float32),
    )
    np.savez_compressed(
        os.path.join(folder("outputs_cvd"), "dog_sgd_cvd_hr.npz"),
        images=rgb,
        depths=np.clip(np.float16(1.0 / disps), 1e-3, 1e2),
        intrinsic=np.asfortranarray(K.astype(np.float32)),
        cam_c2w=c2w.astype(np.float32),
    )


main(sys.argv[1])
