import { readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import { decodePayload, splitLiveScene } from "../src/payload";
import type { Manifest } from "../src/scene";

/** Written by `crates/m4_viewer/tests/payload_fixture.rs`: splats in words, and as bytes. */
interface Fixture {
  splats: Manifest["splats"];
  expected: Record<
    "mean" | "scale" | "quat" | "opacity" | "colour" | "time_mean" | "time_sd" | "velocity",
    number[]
  >;
  payload: string;
}

function fixture(name: string): Fixture & { bytes: Uint8Array } {
  const file = new URL(`../../tests/payload/${name}.json`, import.meta.url);
  const read = JSON.parse(readFileSync(file, "utf8")) as Fixture;
  // fixtures of scenes without bound splats do not name them, as pages do
  return { ...read, splats: { ...read.splats, bound: 0 }, bytes: new Uint8Array(Buffer.from(read.payload, "base64")) };
}

/** Every value within half of the step that it was rounded to. */
function near(found: Float32Array, expected: number[], absolute: number, relative = 0): void {
  expect(found.length).toBe(expected.length);
  expected.forEach((value, i) => {
    expect(Math.abs((found[i] as number) - value)).toBeLessThanOrEqual(absolute + relative * Math.abs(value));
  });
}

describe.each(["plain", "isotropic", "harmonics"])("the splats of %s", (name) => {
  const { bytes, splats, expected } = fixture(name);

  it("come back as they went in", () => {
    const scene = decodePayload(bytes, { splats });
    expect([scene.nStatic, scene.nBound, scene.nFree]).toEqual([splats.static, 0, splats.dynamic]);
    const n = scene.nStatic + scene.nFree;
    near(scene.mean, expected.mean, 1e-3);
    const each = splats.isotropic ? expected.scale.flatMap((s) => [s, s, s]) : expected.scale;
    near(scene.scale, each, 0, 0.028);
    near(scene.opacity, expected.opacity, 0.00197);
    near(scene.colour, expected.colour, 0.007);
    near(scene.timeMean, expected.time_mean, 1e-3);
    near(scene.timeSd, expected.time_sd, 0, 0.01);
    near(scene.velocity, expected.velocity, 1e-4, 0.02);
    expect(scene.quat.length).toBe(4 * n);
    for (let i = 0; i < n; i++) {
      const found = [...scene.quat.subarray(4 * i, 4 * i + 4)];
      const told = splats.isotropic ? [1, 0, 0, 0] : expected.quat.slice(4 * i, 4 * i + 4);
      const dot = found.reduce((sum, v, k) => sum + v * (told[k] as number), 0);
      expect(Math.abs(dot)).toBeGreaterThan(1 - 2e-6);
      expect(Math.hypot(...found)).toBeCloseTo(1, 5);
    }
  });

  it("are refused when something is missing or another manifest speaks of them", () => {
    expect(() => decodePayload(bytes.subarray(0, -1), { splats })).toThrow(/bytes/);
    expect(() => decodePayload(bytes.subarray(0, 20), { splats })).toThrow(/header/);
    expect(() => decodePayload(bytes, { splats: { ...splats, static: splats.static + 1 } })).toThrow(/manifest/);
    const newer = bytes.slice();
    newer[4] = 3;
    expect(() => decodePayload(newer, { splats })).toThrow(/version 3/);
  });

  it("come out of the answer of a server, at any place in a buffer", () => {
    const json = new TextEncoder().encode(JSON.stringify({ splats }));
    const answer = new Uint8Array(7 + 4 + json.length + bytes.length);
    new DataView(answer.buffer).setUint32(7, json.length, true);
    answer.set(json, 11);
    answer.set(bytes, 11 + json.length);
    const { manifest, payload } = splitLiveScene(answer.subarray(7));
    expect(manifest).toEqual({ splats });
    expect(decodePayload(payload, { splats })).toEqual(decodePayload(bytes, { splats }));
    expect(() => splitLiveScene(answer.subarray(7, 12))).toThrow(/manifest/);
  });
});
