/** What an instant shows: the same splats as a look at every one of them, in the order of their depths. */

import { describe, expect, test } from "vitest";
import { NOTHING, type SliceView, Slicer } from "../src/render/slice";
import { KeySort, keysOf } from "../src/render/sort";
import { MARGINAL_MIN, REACH_SDS, marginal } from "../src/render/window";
import { NOTHING_BOUND, type SceneData } from "../src/scene";

/** Always the same numbers in 0..1. */
function numbers(seed: number): () => number {
  let state = seed;
  return () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return state / 2 ** 32;
  };
}

/** Splats all about the camera, with lifetimes from a tenth of a frame to the whole clip. */
function scene(nStatic: number, nFree: number): SceneData {
  const random = numbers(3);
  const n = nStatic + nFree;
  const column = (count: number, f: () => number): Float32Array => Float32Array.from({ length: count }, f);
  return {
    nStatic,
    nBound: 0,
    nFree,
    mean: column(3 * n, () => 8 * random() - 4),
    scale: column(3 * n, () => 0.001 + 0.1 * random()),
    quat: column(4 * n, () => 0.5),
    opacity: column(n, random),
    colour: new Float32Array(3 * n),
    bound: NOTHING_BOUND,
    timeMean: column(nFree, () => 110 * random() - 5),
    timeSd: column(nFree, () => 0.1 * 1000 ** random()),
    velocity: column(3 * nFree, () => 0.2 * random() - 0.1),
  };
}

const view = (t: number): SliceView => ({
  t,
  w2c: [1, 0, 0, 0.1, 0, 1, 0, -0.2, 0, 0, 1, 0.3],
  ...{ fx: 300, fy: 310, cx: 170, cy: 80, width: 320, height: 180 },
  part: [0, 0, 320, 180],
  lowPass: 0.3,
});

interface Seen {
  row: number;
  depth: number;
}

/** Every splat looked at: `must` be there, since its middle is in the image and it is not faint. */
function seen(data: SceneData, t: number): { must: Set<number>; depth: Map<number, number> } {
  const { w2c, fx, fy, cx, cy, width, height } = view(t);
  const must = new Set<number>();
  const depth = new Map<number, number>();
  for (let row = 0; row < data.nStatic + data.nFree; row++) {
    const d = row - data.nStatic;
    const dt = d < 0 ? 0 : t - (data.timeMean[d] ?? 0);
    const left = d < 0 ? 1 : marginal(dt, data.timeSd[d] ?? 1);
    const p = [0, 1, 2].map((k) => (data.mean[3 * row + k] ?? 0) + (d < 0 ? 0 : dt * (data.velocity[3 * d + k] ?? 0)));
    const [x = 0, y = 0, z = 0] = [0, 1, 2].map((r) => p.reduce((s, v, k) => s + v * (w2c[4 * r + k] ?? 0), w2c[4 * r + 3] ?? 0));
    depth.set(row, z);
    const [u, v] = [(fx * x) / z + cx, (fy * y) / z + cy];
    if (z > 0.05 && left > MARGINAL_MIN && left * (data.opacity[row] ?? 0) > 1 / 255 && u > 0 && v > 0 && u < width && v < height) {
      must.add(row);
    }
  }
  return { must, depth };
}

describe("an instant", () => {
  const data = scene(300, 4000);
  const slicer = new Slicer(data, 0.05);

  test.each([-20, 0, 3.7, 50, 99, 130])("at %d nothing is missing, and the farthest comes first", (t) => {
    const { must, depth } = seen(data, t);
    const { ids, count } = slicer.slice(view(t));
    const shown = [...ids.subarray(0, count)];
    expect(new Set(shown).size).toBe(count);
    expect(ids.length % 2048).toBe(0);
    expect(ids.subarray(count).every((id) => id === NOTHING)).toBe(true);
    const missing = [...must].filter((row) => !shown.includes(row));
    expect(missing).toEqual([]);
    const depths = shown.map((row): Seen => ({ row, depth: depth.get(row) ?? 0 }));
    for (let i = 1; i < depths.length; i++) {
      expect((depths[i - 1]?.depth ?? 0) - (depths[i]?.depth ?? 0)).toBeGreaterThan(-1e-5);
    }
  });

  test("only what can be active is considered", () => {
    const { considered } = slicer.slice(view(50));
    let active = 0;
    for (let d = 0; d < data.nFree; d++) {
      if (marginal(50 - (data.timeMean[d] ?? 0), data.timeSd[d] ?? 1) > MARGINAL_MIN) active += 1;
    }
    expect(active).toBeGreaterThan(300);
    expect(considered).toBeLessThan(2 * active);
    expect(considered).toBeGreaterThanOrEqual(active);
  });

  test("the window ends where its reach says", () => {
    expect(marginal(3 * REACH_SDS, 3)).toBeCloseTo(MARGINAL_MIN, 12);
    expect(marginal(0, 3)).toBe(1);
  });
});

test("no splats, and none that can be seen", () => {
  expect(new Slicer(scene(0, 0), 0).slice(view(1))).toMatchObject({ count: 0 });
  const data = scene(5, 5);
  data.opacity.fill(0);
  data.timeSd.set([0, Number.POSITIVE_INFINITY, Number.NaN, 1, 2]);
  expect(new Slicer(data, 0).slice(view(1)).count).toBeLessThanOrEqual(10);
});

test("keys are sorted, equal ones stay in order", () => {
  const random = numbers(9);
  const values = Float32Array.from({ length: 5000 }, () => Math.round(100 * random() - 50) / 7 + 0);
  const ids = Uint32Array.from(values, (_, i) => i);
  new KeySort().sort(keysOf(values), ids, ids.length);
  const expected = [...values.keys()].toSorted((a, b) => (values[a] ?? 0) - (values[b] ?? 0) || a - b);
  expect([...ids]).toEqual(expected);
});
