/** The definition of a bound splat at an instant: nodes, their mean motion, and what it makes of the splat. */

import type { MotionWindow, SceneData } from "../../src/scene";

type Matrix = number[][];

const at = (column: ArrayLike<number>, i: number): number => column[i] ?? 0;
const three = (f: (k: number) => number): number[] => [0, 1, 2].map(f);
const times = (a: Matrix, v: number[]): number[] => a.map((row) => row.reduce((sum, x, k) => sum + x * at(v, k), 0));

/** The rotation of a unit quaternion `w, x, y, z`. */
function matrix([w = 0, x = 0, y = 0, z = 0]: number[]): Matrix {
  return [
    [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
  ];
}

/** The quaternion on the great circle from `a` to `b`, past them where `share` is outside 0..1, by the shorter arc. */
function between(a: number[], b: number[], share: number): number[] {
  const dot = a.reduce((sum, v, k) => sum + v * at(b, k), 0);
  const near = b.map((v) => (dot < 0 ? -v : v));
  const angle = Math.acos(Math.min(Math.abs(dot), 1));
  if (angle < 1e-9) return a;
  return a.map((v, k) => (Math.sin((1 - share) * angle) * v + Math.sin(share * angle) * at(near, k)) / Math.sin(angle));
}

/** The polynomial of degree 2 through three points: its slope at `t`. */
function slope(t: number, ts: number[], xs: number[]): number {
  return ts.reduce((sum, ti, i) => {
    const [j, k] = [(i + 1) % 3, (i + 2) % 3];
    return sum + (at(xs, i) * (2 * t - at(ts, j) - at(ts, k))) / ((ti - at(ts, j)) * (ti - at(ts, k)));
  }, 0);
}

/** Place and quaternion of a node at `t`. */
function node(window: MotionWindow, index: number, t: number): { place: number[]; turn: number[] } {
  const { keys, positions, rotations } = window;
  const [n, count] = [window.anchors.length / 3, keys.length];
  const x = (key: number, k: number): number => at(positions, 3 * (key * n + index) + k);
  const q = (key: number): number[] => [0, 1, 2, 3].map((k) => at(rotations, 4 * (key * n + index) + k));
  if (count === 1) return { place: three((k) => x(0, k)), turn: q(0) };
  const after = [...keys].findIndex((key) => key > t);
  const a = after < 0 ? count - 2 : Math.max(after - 1, 0);
  const [from, to] = [at(keys, a), at(keys, a + 1)];
  const share = (t - from) / (to - from);
  const tangent = (key: number, k: number): number => {
    if (key === 0 || key === count - 1) return (x(a + 1, k) - x(a, k)) / (to - from);
    const around = [key - 1, key, key + 1];
    return slope(at(keys, key), around.map((i) => at(keys, i)), around.map((i) => x(i, k)));
  };
  const place = three((k) => {
    const straight = x(a, k) + (x(a + 1, k) - x(a, k)) * share;
    if (share < 0 || share > 1) return straight;
    // what a cubic with these slopes at its ends adds to a straight line
    const excess = (key: number): number => tangent(key, k) * (to - from) - (x(a + 1, k) - x(a, k));
    return straight + share * (1 - share) * (excess(a) * (1 - share) - excess(a + 1) * share);
  });
  return { place, turn: between(q(a), q(a + 1), share) };
}

/** Row `i` of a scene at `t`; null where it is not there. */
export function carried(
  data: SceneData,
  i: number,
  t: number,
): { mean: number[]; quat: number[]; opacity: number; change: number[] } | null {
  const { bound } = data;
  const b = i - data.nStatic;
  const window = bound.windows.find(({ from, to }) => from <= b && b < to);
  if (!window) throw new Error(`no window carries splat ${i}`);
  const { keys, anchors } = window;
  const gap = keys.length > 1 ? (at(keys, keys.length - 1) - at(keys, 0)) / (keys.length - 1) : 1;
  // far beyond its keys a window carries nothing
  const far = (1 + 2 * 0.6) * gap;
  if (keys.length > 1 && (t < at(keys, 0) - far || t > at(keys, keys.length - 1) + far)) return null;
  const rise = (frames: number): number => {
    const s = Math.min(Math.max(0.5 + frames / (2 * 0.6 * gap), 0), 1);
    return s * s * (3 - 2 * s);
  };
  const share = rise(t - at(bound.life, 2 * b)) * rise(at(bound.life, 2 * b + 1) - t);
  if (share < 1e-3) return null;
  const dt = t - at(bound.birth, b);
  const own = three((k) => at(data.mean, 3 * i + k) + dt * at(bound.velocity, 3 * b + k));
  const mean = [0, 0, 0];
  const sum = [0, 0, 0, 0];
  let first: number[] = [];
  for (let k = 0; k < 4; k++) {
    const weight = at(bound.weights, 4 * b + k) / 255;
    const index = at(bound.nodes, 4 * b + k);
    const { place, turn } = node(window, index, t);
    if (k === 0) first = turn;
    const arm = times(matrix(turn), own.map((v, j) => v - at(anchors, 3 * index + j)));
    arm.forEach((v, j) => {
      mean[j] = at(mean, j) + weight * (v + at(place, j));
    });
    const side = Math.sign(first.reduce((d, v, j) => d + v * at(turn, j), 0)) || 1;
    turn.forEach((v, j) => {
      sum[j] = at(sum, j) + side * weight * v;
    });
  }
  const length = Math.hypot(...sum);
  const [w = 0, x = 0, y = 0, z = 0] = sum.map((v) => v / length);
  const [p = 0, q = 0, r = 0, s = 0] = data.quat.slice(4 * i, 4 * i + 4);
  const quat = [
    w * p - x * q - y * r - z * s,
    w * q + x * p + y * s - z * r,
    w * r - x * s + y * p + z * q,
    w * s + x * r - y * q + z * p,
  ];
  const opacity = 1 - (1 - at(data.opacity, i)) ** share;
  return { mean, quat, opacity, change: three((k) => dt * at(bound.trend, 3 * b + k)) };
}
