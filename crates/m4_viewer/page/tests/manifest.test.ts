import { expect, test } from "vitest";
import { PageError } from "../src/errors";
import { readManifest } from "../src/manifest";

const good = {
  version: 2,
  title: "A scene",
  splats: { static: 2, dynamic: 3, bound: 2, sh_degree: 1, time_degree: 0, isotropic: false, bytes: 99 },
  background: [0, 0.5, 1],
  time_frames: 30,
  duration_s: null,
  fps: 29.97,
  mip: true,
  near: 0.01,
  period_frames: 29,
  cameras: [{ t: 0, c2w: Array.from({ length: 16 }, (_, i) => i), fx: 5, fy: 6, cx: 7, cy: 8, width: 9, height: 10 }],
  centre: [0, 0, 1],
  safe: { radius: 0.5 },
  frames: { width: 4, height: 3, codec: "avc1.640015", key_every: 12, offsets: [0, 10] },
  live: null,
};

test("a manifest is read as it is", () => {
  expect(readManifest(structuredClone(good))).toEqual(good);
});

test("deviations of distances belong to frames", () => {
  const [first] = good.cameras;
  const cameras = [first, { ...first, distance_sigma: 0.12 }, { ...first, distance_sigma: null }];
  const read = readManifest({ ...good, cameras, frames: null }).cameras;
  expect(read).toEqual([first, { ...first, distance_sigma: 0.12 }, first]);
});

test("what may be missing", () => {
  const { frames: _f, live: _l, duration_s: _d, ...rest } = good;
  expect(readManifest(rest)).toMatchObject({ frames: null, live: null, duration_s: null });
  const { bound: _b, ...splats } = good.splats;
  expect(readManifest({ ...good, splats }).splats.bound).toBe(0);
});

test.each([
  [{ splats: { ...good.splats, static: -1 } }, "splats.static"],
  [{ splats: { ...good.splats, bound: 4 } }, "splats.bound"],
  [{ splats: { ...good.splats, sh_degree: 4 } }, "splats.sh_degree"],
  [{ background: [0, 1] }, "background"],
  [{ fps: 0 }, "fps"],
  [{ fps: "30" }, "fps"],
  [{ cameras: [{ ...good.cameras[0], c2w: [1, 2] }] }, "cameras[0].c2w"],
  [{ cameras: [{ ...good.cameras[0], fx: 0 }] }, "cameras[0].fx"],
  [{ cameras: [{ ...good.cameras[0], distance_sigma: 0 }] }, "cameras[0].distance_sigma"],
  [{ cameras: [{ ...good.cameras[0], distance_sigma: "0.1" }] }, "cameras[0].distance_sigma"],
  [{ cameras: {} }, "cameras"],
  [{ frames: { width: 4, height: 3, offsets: [0] } }, "frames.offsets"],
  [{ frames: { width: 4, height: 3, offsets: [9, 0] } }, "frames.offsets"],
  [{ frames: { ...good.frames, key_every: 0 } }, "frames.key_every"],
  [{ frames: { ...good.frames, codec: 264 } }, "frames.codec"],
  [{ safe: {} }, "safe.radius"],
  [{ centre: [0, 0, Number.NaN] }, "centre"],
  [{ live: { events: 1 } }, "live.events"],
])("what is wrong is named: %o", (change, name) => {
  const read = (): unknown => readManifest({ ...good, ...change });
  expect(read).toThrow(PageError);
  expect(read).toThrow(name);
});

test("cameras must be in the order of time", () => {
  const [first] = good.cameras;
  const cameras = [{ ...first, t: 5 }, { ...first, t: 4 }];
  expect(() => readManifest({ ...good, cameras, frames: null })).toThrow("order of time");
});

test("another version says so", () => {
  expect(() => readManifest({ ...good, version: 1 })).toThrow("version 2 and found 1");
  for (const nothing of [null, 3, "x", []]) expect(() => readManifest(nothing)).toThrow(PageError);
});
