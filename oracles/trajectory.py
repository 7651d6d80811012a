"""Makes fixtures/metrics/trajectory.json: errors of made-up camera paths by evo.

    python3 oracles/trajectory.py fixtures

Needs NumPy, SciPy and evo. Poses are camera to world, rows of [R | t], 12 numbers.
"""

import copy
import json
import sys
from pathlib import Path

import evo
import numpy as np
from evo.core import metrics
from evo.core.metrics import PoseRelation, Unit
from evo.core.trajectory import PosePath3D
from scipy.spatial.transform import Rotation

OUT = Path(sys.argv[1]) / "metrics"


def path(n, rng, noise, turn):
    """A truth of `n` poses on a curve, and an estimate: moved by a similarity, each pose disturbed."""
    t = np.arange(n)
    centres = np.stack([np.sin(0.3 * t) * 2, 0.4 * np.cos(0.21 * t), 0.15 * t], 1)
    axes = Rotation.from_rotvec(np.stack([0.1 * np.sin(0.2 * t), 0.05 * t, 0.02 * np.cos(t)], 1))
    world = Rotation.from_rotvec([0.7, -1.1, 0.4])
    moved = 0.37 * world.apply(centres) + [3.0, -2.0, 0.5] + noise * rng.standard_normal((n, 3))
    turned = world * axes * Rotation.from_rotvec(turn * rng.standard_normal((n, 3)))
    pose = lambda r, c: [np.block([[r.as_matrix(), c[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]]) for r, c in zip(r, c)]
    return pose(axes, centres), pose(turned, moved)


def statistics(metric):
    return {k: float(metric.get_statistic(metrics.StatisticsType(k))) for k in ("rmse", "mean", "median", "std", "min", "max")}


def errors(truth, estimate, alignment, deltas):
    truth, estimate = PosePath3D(poses_se3=truth), PosePath3D(poses_se3=copy.deepcopy(estimate))
    scale = 1.0
    if alignment != "none":
        _, _, scale = estimate.align(truth, correct_scale=alignment == "sim3")
    out = {"scale": float(scale), "relative": {}}
    for key, relation in [("absolute", PoseRelation.translation_part), ("absolute_rotation_deg", PoseRelation.rotation_angle_deg)]:
        ape = metrics.APE(relation)
        ape.process_data((truth, estimate))
        out[key] = statistics(ape)
    for delta in deltas:
        both = {}
        for key, relation in [("translation", PoseRelation.translation_part), ("rotation_deg", PoseRelation.rotation_angle_deg)]:
            rpe = metrics.RPE(relation, delta=delta, delta_unit=Unit.frames, all_pairs=False)
            rpe.process_data((truth, estimate))
            both[key] = statistics(rpe)
        out["relative"][str(delta)] = both
    return out


def main():
    OUT.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(11)
    rows = lambda poses: [[float(v) for v in p[:3].ravel()] for p in poses]
    cases = []
    for n, noise, turn in [(24, 0.02, 0.01), (7, 0.2, 0.3)]:
        truth, estimate = path(n, rng, noise, turn)
        by = {kind: errors(truth, estimate, kind, [1, 3]) for kind in ("none", "se3", "sim3")}
        cases.append({"truth": rows(truth), "estimate": rows(estimate), "errors": by})
        print(n, json.dumps(by["sim3"], indent=1))
    (OUT / "trajectory.json").write_text(json.dumps({"evo": evo.__version__, "cases": cases}) + "\n")


main()
