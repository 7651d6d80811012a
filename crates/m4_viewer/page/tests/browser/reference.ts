/** The definition of an image in plain double precision, one pixel after the other. */

import { carried } from "./carried";
import { type SceneData, shTerms, splatCount } from "../../src/scene";
import type { Manifest } from "../../src/scene";

export interface Shot {
  t: number;
  c2w: number[];
  fx: number;
  fy: number;
  cx: number;
  cy: number;
  width: number;
  height: number;
}

const C1 = 0.4886025119029199;

interface Ellipse {
  u: number;
  v: number;
  depth: number;
  conic: [number, number, number];
  opacity: number;
  colour: number[];
}

function colourOf(data: SceneData, manifest: Manifest, i: number, d: number[], turns: number, change: number[]): number[] {
  const spatial = shTerms(manifest);
  const terms = spatial * (manifest.splats.time_degree + 1);
  const basis = [0.28209479177387814, -C1 * (d[1] ?? 0), C1 * (d[2] ?? 0), -C1 * (d[0] ?? 0)];
  return [0, 1, 2].map((channel) => {
    let sum = 0.5 + (basis[0] ?? 0) * (change[channel] ?? 0);
    for (let term = 0; term < terms; term++) {
      const wave = Math.cos(2 * Math.PI * Math.floor(term / spatial) * turns);
      sum += wave * (basis[term % spatial] ?? 0) * (data.colour[i * 3 * terms + 3 * term + channel] ?? 0);
    }
    return Math.max(sum, 0);
  });
}

function ellipse(data: SceneData, manifest: Manifest, shot: Shot, i: number): Ellipse | null {
  const m = (row: number, column: number): number => shot.c2w[4 * row + column] ?? 0;
  const eye = [m(0, 3), m(1, 3), m(2, 3)];
  let mean = [0, 1, 2].map((k) => data.mean[3 * i + k] ?? 0);
  let quat = [...data.quat.slice(4 * i, 4 * i + 4)];
  let peak = data.opacity[i] ?? 0;
  let change = [0, 0, 0];
  let [marginal, turns] = [1, 0];
  const dynamic = i - data.nStatic - data.nBound;
  if (i >= data.nStatic && dynamic < 0) {
    const there = carried(data, i, shot.t);
    if (!there) return null;
    ({ mean, quat, opacity: peak, change } = there);
  }
  if (dynamic >= 0) {
    const dt = shot.t - (data.timeMean[dynamic] ?? 0);
    for (let k = 0; k < 3; k++) mean[k] = (mean[k] ?? 0) + dt * (data.velocity[3 * dynamic + k] ?? 0);
    marginal = Math.exp(-0.5 * (dt / (data.timeSd[dynamic] ?? 1)) ** 2);
    turns = dt / manifest.period_frames;
    if (marginal <= 0.05) return null;
  }
  const offset = mean.map((v, k) => v - (eye[k] ?? 0));
  // world to camera is the transpose
  const p = [0, 1, 2].map((k) => offset.reduce((s, v, j) => s + v * m(j, k), 0));
  const [x = 0, y = 0, z = 0] = p;
  if (!(z > Math.max(manifest.near, 1e-6))) return null;
  const [qw = 0, qx = 0, qy = 0, qz = 0] = quat;
  const rotation = [
    [1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy)],
    [2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx)],
    [2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)],
  ];
  // columns: the axes of the splat in the camera, at their lengths
  const axes = [0, 1, 2].map((a) =>
    [0, 1, 2].map(
      (k) => (data.scale[3 * i + a] ?? 0) * [0, 1, 2].reduce((s, j) => s + m(j, k) * (rotation[j]?.[a] ?? 0), 0),
    ),
  );
  const limit = (v: number, size: number, f: number, c: number): number =>
    Math.min(Math.max(v, -c / f - (0.3 * size) / (2 * f)), (size - c) / f + (0.3 * size) / (2 * f));
  const kx = limit(x / z, shot.width, shot.fx, shot.cx);
  const ky = limit(y / z, shot.height, shot.fy, shot.cy);
  const rows = axes.map(([ax = 0, ay = 0, az = 0]) => [(shot.fx / z) * (ax - kx * az), (shot.fy / z) * (ay - ky * az)]);
  const sum = (f: (r: number[]) => number): number => rows.reduce((s, r) => s + f(r), 0);
  const xx = sum(([a = 0]) => a * a);
  const xy = sum(([a = 0, b = 0]) => a * b);
  const yy = sum(([, b = 0]) => b * b);
  const [a, d] = [xx + 0.3, yy + 0.3];
  const det = a * d - xy * xy;
  const kept = manifest.mip ? Math.sqrt(Math.max(xx * yy - xy * xy, 0) / det) : 1;
  const far = Math.hypot(...offset);
  return {
    u: (shot.fx * x) / z + shot.cx - 0.5,
    v: (shot.fy * y) / z + shot.cy - 0.5,
    depth: z,
    conic: [d / det, -xy / det, a / det],
    opacity: peak * marginal * kept,
    colour: colourOf(data, manifest, i, offset.map((v) => v / far), turns, change),
  };
}

/** Red, green, blue of every pixel, 0..255, not rounded. */
export function render(data: SceneData, manifest: Manifest, shot: Shot): Float64Array {
  const ellipses: Ellipse[] = [];
  for (let i = 0; i < splatCount(data); i++) {
    const e = ellipse(data, manifest, shot, i);
    if (e && e.opacity >= 1 / 255) ellipses.push(e);
  }
  ellipses.sort((a, b) => a.depth - b.depth);
  const out = new Float64Array(3 * shot.width * shot.height);
  for (let row = 0; row < shot.height; row++) {
    for (let column = 0; column < shot.width; column++) {
      let left = 1;
      const sum = [0, 0, 0];
      for (const e of ellipses) {
        const [dx, dy] = [e.u - column, e.v - row];
        const power = -0.5 * (e.conic[0] * dx * dx + e.conic[2] * dy * dy) - e.conic[1] * dx * dy;
        const alpha = Math.min(e.opacity * Math.exp(power), 0.99);
        if (alpha < 1 / 255) continue;
        if (left * (1 - alpha) < 1e-4) break;
        for (let k = 0; k < 3; k++) sum[k] = (sum[k] ?? 0) + left * alpha * (e.colour[k] ?? 0);
        left *= 1 - alpha;
      }
      for (let k = 0; k < 3; k++) {
        const v = (sum[k] ?? 0) + left * (manifest.background[k] ?? 0);
        out[3 * (row * shot.width + column) + k] = 255 * Math.min(Math.max(v, 0), 1);
      }
    }
  }
  return out;
}
