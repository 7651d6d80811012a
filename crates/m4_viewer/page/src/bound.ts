// Bound splats and their windows from the payload: the other side of
// crates/m4_viewer/src/payload/bound, which describes them byte for byte.

import { type Planes, damaged } from "./planes";
import type { BoundData, MotionWindow } from "./scene";

const FIXED_BYTES = 136 + 56;
const TABLE_BYTES = 12;
/** Bytes of a bound splat beside what all have. */
const BOUND_BYTES = 3 * 2 + 3 + 2 + 2 * 2 + 4 * 2 + 3;
const POSE_BYTES = 3 * 3 + 1 + 3 * 2;
const ANCHOR_BYTES = 3 * 3;
const LIFE_TOP = 65535;
const WEIGHT_SUM = 255;
const PLACE_TOP = 2 ** 24 - 1;
const TURN_TOP = 2 ** 14 - 1;
const MIDDLE_8 = 2 ** 7;
const MIDDLE_16 = 2 ** 15;

/** Splats, keys and nodes of a window. */
type Size = readonly [number, number, number];

/** The part of the header that scenes with bound splats have. */
export interface BoundHeader {
  readonly count: number;
  readonly windows: readonly Size[];
  /** `life_low` to `trend_step`. */
  readonly numbers: readonly number[];
  /** Bytes of the header, and of what bound splats have behind all others. */
  readonly end: number;
  readonly bytes: number;
}

/** Reads it; `view` is of the payload. */
export function readBoundHeader(view: DataView): BoundHeader {
  if (view.byteLength < FIXED_BYTES) throw damaged("the header of the bound splats is not complete");
  const [count, n] = [view.getUint32(136, true), view.getUint32(140, true)];
  const end = FIXED_BYTES + TABLE_BYTES * n;
  if (view.byteLength < end) throw damaged("the table of windows is not complete");
  const numbers = Array.from({ length: 6 }, (_, k) => view.getFloat64(144 + 8 * k, true));
  if (!numbers.every(Number.isFinite)) throw damaged("a number of the header is not finite");
  const windows = Array.from({ length: n }, (_, w): Size => {
    const word = (k: number): number => view.getUint32(FIXED_BYTES + TABLE_BYTES * w + 4 * k, true);
    return [word(0), word(1), word(2)];
  });
  const carried = windows.reduce((sum, [splats]) => sum + splats, 0);
  if (carried !== count) throw damaged(`${count} bound splats are named, and ${carried} belong to windows`);
  const tables = windows.map(([, keys, nodes]) => 4 * keys + ANCHOR_BYTES * nodes + POSE_BYTES * keys * nodes);
  return { count, windows, numbers, end, bytes: BOUND_BYTES * count + tables.reduce((sum, v) => sum + v, 0) };
}

/** Reads what bound splats have alone, and their windows; `place` is the value of a code of coordinate `k`. */
export function readBound(planes: Planes, header: BoundHeader, place: (k: number, q: number) => number): BoundData {
  const { count: n, numbers } = header;
  const [lifeLow = 0, lifeStep = 0, residualSpread = 0, residualStep = 0, trendSpread = 0, trendStep = 0] = numbers;
  const sinh = (width: number, middle: number, spread: number, step: number): Float32Array => {
    const out = new Float32Array(3 * n);
    for (let k = 0; k < 3; k++) {
      const q = planes.next(width, n);
      for (let i = 0; i < n; i++) out[3 * i + k] = spread * Math.sinh(step * (q(i) - middle));
    }
    return out;
  };
  const velocity = sinh(2, MIDDLE_16, residualSpread, residualStep);
  const trend = sinh(1, MIDDLE_8, trendSpread, trendStep);
  const born = planes.next(2, n);
  const [begin, end] = [planes.next(2, n), planes.next(2, n)];
  const life = new Float32Array(2 * n);
  for (let i = 0; i < n; i++) {
    life[2 * i] = begin(i) === 0 ? -Infinity : lifeLow + lifeStep * begin(i);
    life[2 * i + 1] = end(i) === LIFE_TOP ? Infinity : lifeLow + lifeStep * end(i);
  }
  const nodes = new Uint16Array(4 * n);
  for (let k = 0; k < 4; k++) {
    const q = planes.next(2, n);
    for (let i = 0; i < n; i++) nodes[4 * i + k] = q(i);
  }
  const weights = new Uint8Array(4 * n);
  for (let k = 0; k < 3; k++) {
    const q = planes.next(1, n);
    for (let i = 0; i < n; i++) weights[4 * i + k] = q(i);
  }
  for (let i = 0; i < n; i++) {
    const rest = [0, 1, 2].reduce((left, k) => left - (weights[4 * i + k] as number), WEIGHT_SUM);
    if (rest < 0) throw damaged(`the weights of bound splat ${i} sum to more than 1`);
    weights[4 * i + 3] = rest;
  }

  const windows = readWindows(planes, header.windows, place);
  const birth = new Float32Array(n);
  for (const { from, to, keys, anchors } of windows) {
    for (let i = from; i < to; i++) {
      const key = keys[born(i)];
      if (key === undefined) throw damaged(`bound splat ${i} is born at a key that its window does not have`);
      birth[i] = key;
      for (let k = 0; k < 4; k++) {
        if (3 * (nodes[4 * i + k] as number) >= anchors.length) {
          throw damaged(`bound splat ${i} has a node that its window does not have`);
        }
      }
    }
  }
  return { birth, velocity, trend, life, nodes, weights, windows };
}

function readWindows(planes: Planes, sizes: readonly Size[], place: (k: number, q: number) => number): MotionWindow[] {
  const total = (f: (size: Size) => number): number => sizes.reduce((sum, size) => sum + f(size), 0);
  const times = planes.floats(total(([, keys]) => keys));
  const places = [0, 1, 2].map((k) => {
    const step = planes.next(3, total(([, keys, nodes]) => (keys + 1) * nodes));
    const codes = accumulate(sizes.map(([, keys, nodes]) => [keys + 1, nodes]), PLACE_TOP, step);
    return Float32Array.from(codes, (q) => place(k, q));
  });
  const poses = total(([, keys, nodes]) => keys * nodes);
  const leftOut = planes.next(1, poses);
  const turns = [0, 1, 2].map(() => {
    const step = planes.next(2, poses);
    return accumulate(sizes.map(([, keys, nodes]) => [keys, nodes]), TURN_TOP, step);
  });
  let [splat, key, at, pose] = [0, 0, 0, 0];
  return sizes.map(([splats, count, nodes]) => {
    const keys = times.slice(key, key + count);
    const rising = keys.every((t, i) => Number.isFinite(t) && (i === 0 || t > (keys[i - 1] as number)));
    if (count === 0 || !rising) throw damaged("the keys of a window do not rise");
    const vectors = (from: number, rows: number): Float32Array =>
      Float32Array.from({ length: 3 * rows * nodes }, (_, i) => (places[i % 3] as Float32Array)[from + Math.floor(i / 3)] as number);
    const rotations = new Float32Array(4 * count * nodes);
    for (let i = 0; i < count * nodes; i++) {
      const largest = leftOut(pose + i);
      if (largest > 3) throw damaged("a rotation of a node leaves out a component that does not exist");
      const [a = 0, b = 0, c = 0] = turns.map((codes) => ((codes[pose + i] as number) * 2) / TURN_TOP - 1);
      const rest = Math.sqrt(Math.max(0, 1 - (a * a + b * b + c * c) / 2));
      const scale = 1 / Math.hypot(rest, Math.SQRT1_2 * Math.hypot(a, b, c));
      rotations[4 * i + largest] = rest * scale;
      [a, b, c].forEach((v, k) => {
        rotations[4 * i + ((largest + k + 1) & 3)] = v * Math.SQRT1_2 * scale;
      });
    }
    const window = {
      from: splat,
      to: splat + splats,
      keys,
      anchors: vectors(at, 1),
      positions: vectors(at + nodes, count),
      rotations,
    };
    splat += splats;
    key += count;
    at += (count + 1) * nodes;
    pose += count * nodes;
    return window;
  });
}

/** Codes from their differences; `sizes` are rows and nodes of each window, `top + 1` a power of two. */
function accumulate(sizes: readonly (readonly number[])[], top: number, step: (row: number) => number): Uint32Array {
  const out = new Uint32Array(sizes.reduce((sum, [rows = 0, nodes = 0]) => sum + rows * nodes, 0));
  let at = 0;
  for (const [rows = 0, nodes = 0] of sizes) {
    for (let i = 0; i < rows * nodes; i++, at++) {
      const s = step(at);
      const before = i < nodes ? 0 : (out[at - nodes] as number);
      out[at] = (before + ((s & 1) === 1 ? ~(s >> 1) : s >> 1)) & top;
    }
  }
  return out;
}
