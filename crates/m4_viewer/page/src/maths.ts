/** Vectors, unit quaternions and poses; plain numbers, no library. */

export type Vec3 = readonly [number, number, number];
/** `w, x, y, z`, length 1. */
export type Quat = readonly [number, number, number, number];

/** A camera's place: rotation from camera to world (OpenCV axes) and centre. */
export interface Pose {
  readonly rotation: Quat;
  readonly position: Vec3;
}

export const add = (a: Vec3, b: Vec3): Vec3 => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const sub = (a: Vec3, b: Vec3): Vec3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a: Vec3, s: number): Vec3 => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a: Vec3, b: Vec3): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a: Vec3, b: Vec3): Vec3 => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
export const norm = (a: Vec3): number => Math.hypot(a[0], a[1], a[2]);
export const distance = (a: Vec3, b: Vec3): number => norm(sub(a, b));
export const mix = (a: Vec3, b: Vec3, s: number): Vec3 => add(scale(a, 1 - s), scale(b, s));

/** `a` at length 1; `fallback` where it has none. */
export function unit(a: Vec3, fallback: Vec3 = [0, 0, 1]): Vec3 {
  const n = norm(a);
  return n > 1e-12 ? scale(a, 1 / n) : fallback;
}

export const clamp = (v: number, low: number, high: number): number => Math.min(Math.max(v, low), high);

/** 0 below `low`, 1 above `high`, with no slope at both. */
export function smoothstep(low: number, high: number, v: number): number {
  if (high <= low) return v >= high ? 1 : 0;
  const x = clamp((v - low) / (high - low), 0, 1);
  return x * x * (3 - 2 * x);
}

export function quatMul(a: Quat, b: Quat): Quat {
  return [
    a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
    a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
    a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
    a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
  ];
}

export function quatUnit(q: Quat): Quat {
  const n = Math.hypot(...q);
  return n > 1e-12 ? [q[0] / n, q[1] / n, q[2] / n, q[3] / n] : [1, 0, 0, 0];
}

/** A turn of `angle` radians about a unit vector. */
export function axisAngle(axis: Vec3, angle: number): Quat {
  const s = Math.sin(angle / 2);
  return [Math.cos(angle / 2), axis[0] * s, axis[1] * s, axis[2] * s];
}

/** The shortest turn from one unit vector to another. */
export function turnBetween(from: Vec3, to: Vec3): Quat {
  const w = 1 + dot(from, to);
  if (w < 1e-9) {
    const other: Vec3 = Math.abs(from[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
    return axisAngle(unit(cross(from, other)), Math.PI);
  }
  const c = cross(from, to);
  return quatUnit([w, c[0], c[1], c[2]]);
}

export function rotate(q: Quat, v: Vec3): Vec3 {
  const u: Vec3 = [q[1], q[2], q[3]];
  const t = scale(cross(u, v), 2);
  return add(add(v, scale(t, q[0])), cross(u, t));
}

export function slerp(a: Quat, b: Quat, s: number): Quat {
  let c = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
  const sign = c < 0 ? -1 : 1;
  c *= sign;
  let [wa, wb] = [1 - s, s];
  if (c < 0.9995) {
    const angle = Math.acos(clamp(c, -1, 1));
    wa = Math.sin((1 - s) * angle) / Math.sin(angle);
    wb = Math.sin(s * angle) / Math.sin(angle);
  }
  wb *= sign;
  return quatUnit([wa * a[0] + wb * b[0], wa * a[1] + wb * b[1], wa * a[2] + wb * b[2], wa * a[3] + wb * b[3]]);
}

/** Column `k` of the rotation: 0 is right, 1 down, 2 forward. */
export function axis(pose: Pose, k: 0 | 1 | 2): Vec3 {
  return rotate(pose.rotation, k === 0 ? [1, 0, 0] : k === 1 ? [0, 1, 0] : [0, 0, 1]);
}

/** The pose turned about a point of the world. */
export function turnAbout(pose: Pose, pivot: Vec3, turn: Quat): Pose {
  return {
    rotation: quatUnit(quatMul(turn, pose.rotation)),
    position: add(pivot, rotate(turn, sub(pose.position, pivot))),
  };
}

export function mixPose(a: Pose, b: Pose, s: number): Pose {
  return { rotation: slerp(a.rotation, b.rotation, s), position: mix(a.position, b.position, s) };
}

/** Of a row-major 4x4 camera-to-world matrix. */
export function poseOf(c2w: ArrayLike<number>): Pose {
  const m = (row: number, column: number): number => c2w[4 * row + column] ?? 0;
  const trace = m(0, 0) + m(1, 1) + m(2, 2);
  let q: Quat;
  if (trace > 0) {
    q = [1 + trace, m(2, 1) - m(1, 2), m(0, 2) - m(2, 0), m(1, 0) - m(0, 1)];
  } else if (m(0, 0) >= m(1, 1) && m(0, 0) >= m(2, 2)) {
    q = [m(2, 1) - m(1, 2), 1 + m(0, 0) - m(1, 1) - m(2, 2), m(0, 1) + m(1, 0), m(0, 2) + m(2, 0)];
  } else if (m(1, 1) >= m(2, 2)) {
    q = [m(0, 2) - m(2, 0), m(0, 1) + m(1, 0), 1 - m(0, 0) + m(1, 1) - m(2, 2), m(1, 2) + m(2, 1)];
  } else {
    q = [m(1, 0) - m(0, 1), m(0, 2) + m(2, 0), m(1, 2) + m(2, 1), 1 - m(0, 0) - m(1, 1) + m(2, 2)];
  }
  return { rotation: quatUnit(q), position: [m(0, 3), m(1, 3), m(2, 3)] };
}

/** Row-major 4x4 camera-to-world matrix. */
export function matrixOf(pose: Pose): number[] {
  const [x, y, z] = [axis(pose, 0), axis(pose, 1), axis(pose, 2)];
  const p = pose.position;
  return [x[0], y[0], z[0], p[0], x[1], y[1], z[1], p[1], x[2], y[2], z[2], p[2], 0, 0, 0, 1];
}
