/** Bound splats: read as they were written, and carried as the renderer of the training carries them. */

import { readFileSync } from "node:fs";
import { describe, expect, test } from "vitest";
import { decodePayload } from "../src/payload";
import { texelsOf } from "../src/render/columns";
import { Nodes, halfFade, poseAt, presence } from "../src/render/pose";
import { type SliceView, Slicer } from "../src/render/slice";
import type { Manifest } from "../src/scene";
import { carried } from "./browser/carried";

/** Written by `crates/m4_viewer/tests/payload_fixture.rs`: bytes, and what the definition in Rust makes of them. */
interface Fixture {
  splats: Manifest["splats"];
  payload: string;
  poses: { window: number; node: number; t: number; position: number[]; rotation: number[] }[];
  carried: { splat: number; t: number; mean?: number[]; quat?: number[]; opacity?: number; colour?: number[] }[];
}

const file = new URL("../../tests/payload/turning.json", import.meta.url);
const fixture = JSON.parse(readFileSync(file, "utf8")) as Fixture;
const { splats } = fixture;
const bytes = new Uint8Array(Buffer.from(fixture.payload, "base64"));
const data = decodePayload(bytes, { splats });
const { bound } = data;

function near(found: readonly number[], expected: readonly number[], within: number, what: string): void {
  expect(found.length, what).toBe(expected.length);
  found.forEach((v, k) => expect(Math.abs(v - (expected[k] as number)), `${what}: ${found.join()}`).toBeLessThan(within));
}

/** The window of a bound splat. */
const windowOf = (b: number): number => bound.windows.findIndex(({ from, to }) => from <= b && b < to);

test("all of them are there, in the order of their windows", () => {
  expect([data.nStatic, data.nBound, data.nFree]).toEqual([splats.static, splats.bound, splats.dynamic - splats.bound]);
  expect(bound.windows.map(({ from, to }) => to - from)).toEqual([splats.bound / 2, splats.bound / 2]);
  expect([bound.windows[0]?.from, bound.windows[1]?.to]).toEqual([0, splats.bound]);
  for (let b = 0; b < splats.bound; b++) {
    expect([...bound.weights.subarray(4 * b, 4 * b + 4)].reduce((sum, w) => sum + w, 0)).toBe(255);
    expect(bound.windows[windowOf(b)]?.keys).toContain(bound.birth[b]);
  }
});

test("nodes are where the program has them, at keys, between them and beyond", () => {
  for (const { window, node, t, position, rotation } of fixture.poses) {
    const w = bound.windows[window];
    if (!w) throw new Error("the window is there");
    const pose = poseAt(w, node, t);
    near(pose.position, position, 2e-5, `position of node ${node} at ${t}`);
    const side = Math.sign(pose.rotation.reduce((sum, v, k) => sum + v * (rotation[k] as number), 0));
    near(pose.rotation.map((v) => side * v), rotation, 2e-6, `rotation of node ${node} at ${t}`);
  }
});

describe("what nodes make of a splat", () => {
  const nodes = new Nodes(bound);

  test("is what the program makes of it, by the worker and by the reference of the image", () => {
    let there = 0;
    for (const { splat, t, mean, quat, opacity, colour } of fixture.carried) {
      const i = data.nStatic + splat;
      const w = windowOf(splat);
      const place = nodes.places[w];
      if (!place) throw new Error("the window is there");
      const share = presence(t, bound.life[2 * splat] as number, bound.life[2 * splat + 1] as number, halfFade(place.window));
      const drawn = carried(data, i, t);
      if (!mean || !quat || !colour || opacity === undefined) {
        expect(share < 1e-3 || !nodes.at(t).includes(place), `splat ${splat} at ${t}`).toBe(true);
        expect(drawn).toBe(null);
        continue;
      }
      there += 1;
      const dt = t - (bound.birth[splat] as number);
      const own = [0, 1, 2].map((k) => (data.mean[3 * i + k] as number) + dt * (bound.velocity[3 * splat + k] as number));
      expect(nodes.at(t)).toContain(place);
      const out = new Float64Array(3);
      nodes.carry(place.first, bound, splat, own[0] ?? 0, own[1] ?? 0, own[2] ?? 0, out);
      near([...out], mean, 5e-5, `mean of ${splat} at ${t}`);
      near([1 - (1 - (data.opacity[i] as number)) ** share], [opacity], 1e-3, `opacity of ${splat} at ${t}`);
      near(drawn?.mean ?? [], mean, 5e-5, `drawn mean of ${splat} at ${t}`);
      const dot = (drawn?.quat ?? []).reduce((sum, v, k) => sum + v * (quat[k] as number), 0);
      expect(Math.abs(dot)).toBeGreaterThan(1 - 1e-6);
      const first = data.colour.subarray((i * data.colour.length) / data.opacity.length);
      near((drawn?.change ?? []).map((v, k) => v + (first[k] as number)), colour, 1e-4, `colour of ${splat} at ${t}`);
    }
    expect(there).toBeGreaterThan(fixture.carried.length / 4);
  });

  test("windows that are never there together share their place in the texture", () => {
    expect(nodes.count).toBe(bound.windows.reduce((sum, w) => sum + w.anchors.length / 3, 0));
    const [early, late] = bound.windows;
    if (!early || !late) throw new Error("there are two windows");
    const apart = { ...late, keys: late.keys.map((t) => t + 100) };
    const life = bound.life.slice();
    for (let b = early.from; b < early.to; b++) life[2 * b + 1] = Math.min(life[2 * b + 1] as number, 6);
    for (let b = late.from; b < late.to; b++) {
      life[2 * b] = Math.max((life[2 * b] as number) + 100, 100);
      life[2 * b + 1] = (life[2 * b + 1] as number) + 100;
    }
    const shared = new Nodes({ ...bound, life, windows: [early, apart] });
    expect(shared.places.map(({ first }) => first)).toEqual([0, 0]);
    expect(shared.at(50)).toEqual([]);
    expect(shared.at(106).map(({ window }) => window)).toEqual([apart]);
  });

  test("a row of the texture names nodes and weights exactly", () => {
    const { bound: texels } = texelsOf(data, 4, nodes.places);
    for (let b = 0; b < splats.bound; b++) {
      const first = nodes.places[windowOf(b)]?.first ?? -1;
      for (let k = 0; k < 4; k++) {
        const link = texels[8 * b + k] as number;
        expect(link & 65535).toBe(first + (bound.nodes[4 * b + k] as number));
        expect(link >> 16).toBe(bound.weights[4 * b + k]);
      }
    }
  });
});

const view = (t: number): SliceView => ({
  t,
  w2c: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0],
  ...{ fx: 140, fy: 140, cx: 160, cy: 90, width: 320, height: 180 },
  part: [0, 0, 320, 180],
  lowPass: 0.3,
});

test.each([0, 2.5, 4.5, 6.8, 9])("at %d all that is there is shown, and nothing else", (t) => {
  const { ids, count, considered } = new Slicer(data, 0.05).slice(view(t));
  const shown = new Set(ids.subarray(0, count));
  let there = 0;
  for (let i = data.nStatic; i < data.nStatic + data.nBound; i++) {
    const c = carried(data, i, t);
    const [x = 0, y = 0, z = 0] = c?.mean ?? [];
    const inside = z > 0.05 && Math.abs(x / z) < 160 / 140 && Math.abs(y / z) < 90 / 140;
    if (c && c.opacity > 1 / 255 && inside) {
      there += 1;
      expect(shown.has(i), `splat ${i}`).toBe(true);
    }
    if (!c || c.opacity < 0.99 / 255) expect(shown.has(i), `splat ${i}`).toBe(false);
  }
  expect(there).toBeGreaterThan(20);
  if (t < 2 || t > 8) expect(considered).toBeLessThan(data.nBound);
});

test("damaged bytes are refused", () => {
  const changed = (at: number, ...values: number[]): (() => unknown) => {
    const other = bytes.slice();
    other.set(values, at);
    return () => decodePayload(other, { splats });
  };
  expect(changed(136, 1)).toThrow(/belong to windows/);
  expect(changed(140, 255, 255)).toThrow(/windows/);
  expect(changed(144, 0, 0, 0, 0, 0, 0, 240, 127)).toThrow(/finite/);
  expect(changed(136 + 56 + 4, 99)).toThrow(/bytes/);
  const rows = 136 + 56 + 24 + bytesBefore();
  expect(changed(rows + 9 * splats.bound, 99)).toThrow(/key/);
  expect(changed(rows + 15 * splats.bound, 77)).toThrow(/node/);
  expect(changed(rows + 23 * splats.bound, ...new Uint8Array(2 * splats.bound).fill(255))).toThrow(/weights/);
  expect(changed(rows + 26 * splats.bound, 0, 0, 128, 127)).toThrow(/keys/);
  expect(() => decodePayload(bytes, { splats: { ...splats, bound: 0 } })).toThrow(/manifest/);
  expect(() => decodePayload(bytes.subarray(0, 150), { splats })).toThrow(/header/);
});

/** Bytes of the columns before those of bound splats alone. */
function bytesBefore(): number {
  const shared = 9 + 3 + 4 + 1 + 2 * 3 * 4;
  return (splats.static + splats.dynamic) * shared + (splats.dynamic - splats.bound) * 9;
}
