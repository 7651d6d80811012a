/**
 * Nodes at an instant, and what they do to bound splats: the page's side of `m4_core::Window` and of `m4_kernels::pose`,
 * which define it.
 */

import type { BoundData, MotionWindow } from "../scene";
import { ROW, rowsOf } from "./columns";

/** Half the time in which a splat fades in or out, as a share of the mean time between keys. */
const FADE = 0.6;
/** A splat that is present by less is not drawn. */
export const LEAST_PRESENCE = 1e-3;
/** Texels a node: quaternion `x, y, z, w`; shift, and half a fade of its window, frames. */
export const NODE_TEXELS = 2;
/** Nodes that a row can name in the texture. */
export const MOST_NODES = 65536;

/** A place and a quaternion `w, x, y, z`. */
export interface NodePose {
  readonly position: readonly [number, number, number];
  readonly rotation: readonly [number, number, number, number];
}

/** Half of the time in which splats of a window fade, frames. */
export function halfFade({ keys }: MotionWindow): number {
  const gaps = keys.length - 1;
  return FADE * (gaps > 0 ? ((keys[gaps] as number) - (keys[0] as number)) / gaps : 1);
}

/** How much of a splat is there, 0..1. */
export function presence(t: number, begin: number, end: number, half: number): number {
  return rise((t - begin) / half) * rise((end - t) / half);
}

function rise(x: number): number {
  const s = Math.min(Math.max(0.5 + 0.5 * x, 0), 1);
  return s * s * (3 - 2 * s);
}

/**
 * A node at `t`, frames: between two keys a cubic through the positions, with the slopes of the parabolas through three
 * keys, and the shortest turn between the rotations; beyond the keys motion goes on as between the last two.
 */
export function poseAt({ keys, anchors, positions, rotations }: MotionWindow, node: number, t: number): NodePose {
  const nodes = anchors.length / 3;
  const last = keys.length - 1;
  const time = (key: number): number => keys[key] as number;
  const x = (key: number, k: number): number => positions[3 * (key * nodes + node) + k] as number;
  const r = (key: number, k: number): number => rotations[4 * (key * nodes + node) + k] as number;
  let before = 0;
  while (before < last && time(before + 1) <= t) before += 1;
  if (last === 0 || t === time(before)) {
    const at = (k: number): number => r(before, k);
    return { position: [x(before, 0), x(before, 1), x(before, 2)], rotation: [at(0), at(1), at(2), at(3)] };
  }
  const a = Math.min(before, last - 1);
  const b = a + 1;
  const gap = time(b) - time(a);
  const s = (t - time(a)) / gap;
  const slope = (i: number, j: number, k: number): number => (x(j, k) - x(i, k)) / (time(j) - time(i));
  const tangent = (key: number, k: number): number => {
    if (key === 0) return slope(0, 1, k);
    if (key === last) return slope(last - 1, last, k);
    const [h, g] = [time(key) - time(key - 1), time(key + 1) - time(key)];
    return (slope(key - 1, key, k) * g + slope(key, key + 1, k) * h) / (h + g);
  };
  const [s2, s3] = [s * s, s * s * s];
  const place = (k: number): number => {
    if (!(s >= 0 && s <= 1)) return x(a, k) + (x(b, k) - x(a, k)) * s;
    const own = x(a, k) * (2 * s3 - 3 * s2 + 1) + x(b, k) * (3 * s2 - 2 * s3);
    return own + gap * (tangent(a, k) * (s3 - 2 * s2 + s) + tangent(b, k) * (s3 - s2));
  };
  const qa = [r(a, 0), r(a, 1), r(a, 2), r(a, 3)] as const;
  const qb = [r(b, 0), r(b, 1), r(b, 2), r(b, 3)] as const;
  return { position: [place(0), place(1), place(2)], rotation: turned(qa, qb, s) };
}

type Quat = readonly [number, number, number, number];

function product([a, b, c, d]: Quat, [w, x, y, z]: Quat): Quat {
  return [
    a * w - b * x - c * y - d * z,
    a * x + b * w + c * z - d * y,
    a * y - b * z + c * w + d * x,
    a * z + b * y - c * x + d * w,
  ];
}

/** `a`, and `share` of the shortest turn from there to `b`. */
function turned(a: Quat, b: Quat, share: number): Quat {
  const [w, x, y, z] = product(b, [a[0], -a[1], -a[2], -a[3]]);
  const sign = w < 0 ? -1 : 1;
  const sine = Math.hypot(x, y, z);
  if (sine === 0) return a;
  const half = share * Math.atan2(sine, sign * w);
  const axis = (sign * Math.sin(half)) / sine;
  return product([Math.cos(half), axis * x, axis * y, axis * z], a);
}

/** A window, when it carries splats, and where its nodes lie in the texture. */
interface Place {
  readonly window: MotionWindow;
  readonly half: number;
  /** Frames: outside none of its splats is there. */
  readonly from: number;
  readonly to: number;
  /** The first node in the texture. */
  first: number;
}

/** When splats of a window are there, frames. */
function placeOf(window: MotionWindow, { life }: BoundData): Place {
  const { keys } = window;
  const half = halfFade(window);
  let [from, to] = [Infinity, -Infinity];
  for (let i = window.from; i < window.to; i++) {
    from = Math.min(from, (life[2 * i] as number) - half);
    to = Math.max(to, (life[2 * i + 1] as number) + half);
  }
  if (keys.length > 1) {
    // far beyond its keys a window says nothing
    const far = (2 * (0.5 + FADE) * half) / FADE;
    from = Math.max(from, (keys[0] as number) - far);
    to = Math.min(to, (keys[keys.length - 1] as number) + far);
  }
  return { window, half, from, to, first: 0 };
}

/** The nodes of the windows that are alive, in a texture that holds no others. */
export class Nodes {
  /** A place in the texture for each window: windows that are never there together share it. */
  readonly places: readonly Place[];
  /** Whole rows of RGBA texels. */
  readonly texels: Float32Array<ArrayBuffer>;
  /** Nodes that the texture has room for. */
  readonly count: number;
  /** Of each of them: rows of a 3x4 matrix, which takes a place where nodes have not moved to the instant. */
  private readonly motions: Float64Array;

  constructor(bound: BoundData) {
    this.places = bound.windows.map((window) => placeOf(window, bound));
    // one strip after the other takes the windows that fit in behind one another
    const strips: { until: number; nodes: number; places: Place[] }[] = [];
    for (const place of this.places.toSorted((a, b) => a.from - b.from)) {
      let strip = strips.find(({ until }) => until < place.from);
      if (!strip) strips.push((strip = { until: 0, nodes: 0, places: [] }));
      strip.until = place.to;
      strip.nodes = Math.max(strip.nodes, place.window.anchors.length / 3);
      strip.places.push(place);
    }
    let first = 0;
    for (const { nodes, places } of strips) {
      for (const place of places) place.first = first;
      first += nodes;
    }
    this.count = first;
    this.motions = new Float64Array(12 * first);
    this.texels = new Float32Array(first > 0 ? 4 * ROW * rowsOf(NODE_TEXELS * first) : 0);
  }

  /** Poses the nodes of the windows that are alive at `t`, frames; these. */
  at(t: number): Place[] {
    const alive = this.places.filter(({ from, to }) => from <= t && t <= to);
    const { motions } = this;
    for (const { window, half, first } of alive) {
      for (let node = 0; node < window.anchors.length / 3; node++) {
        const { position, rotation } = poseAt(window, node, t);
        const [w, x, y, z] = rotation;
        const axes = [
          [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
          [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
          [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ];
        const anchor = window.anchors.subarray(3 * node, 3 * node + 3);
        const shift = axes.map((row, k) => row.reduce((left, v, j) => left - v * (anchor[j] as number), position[k] ?? 0));
        axes.forEach((row, k) => motions.set([...row, shift[k] ?? 0], 12 * (first + node) + 4 * k));
        this.texels.set([x, y, z, w, ...shift, half], 4 * NODE_TEXELS * (first + node));
      }
    }
    return alive;
  }

  /** Leaves in `out` where the nodes, of which the first is `first`, take bound splat `i` from `x, y, z`. */
  carry(first: number, { nodes, weights }: BoundData, i: number, x: number, y: number, z: number, out: Float64Array): void {
    const { motions: m } = this;
    let [sx, sy, sz] = [0, 0, 0];
    for (let k = 4 * i; k < 4 * i + 4; k++) {
      const weight = (weights[k] as number) / 255;
      const at = 12 * (first + (nodes[k] as number));
      sx += weight * ((m[at] as number) * x + (m[at + 1] as number) * y + (m[at + 2] as number) * z + (m[at + 3] as number));
      sy += weight * ((m[at + 4] as number) * x + (m[at + 5] as number) * y + (m[at + 6] as number) * z + (m[at + 7] as number));
      sz += weight * ((m[at + 8] as number) * x + (m[at + 9] as number) * y + (m[at + 10] as number) * z + (m[at + 11] as number));
    }
    out[0] = sx;
    out[1] = sy;
    out[2] = sz;
  }
}
