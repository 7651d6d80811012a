/** How far the camera may turn where moving parts are not placed well. */

import { describe, expect, test } from "vitest";
import { DistanceLimit } from "../src/camera/limit";
import { SourcePath } from "../src/camera/path";
import { CameraRig } from "../src/camera/rig";
import { SafeRegion } from "../src/camera/safe";
import { type Vec3, distance, matrixOf } from "../src/maths";
import type { SourceCamera } from "../src/scene";

const DEPTH = 5;
const FX = 500;
const FPS = 10;
const FRAMES = 41;
const CENTRE: Vec3 = [0, 0, DEPTH];

/** Cameras that look along z, at `x(t)`. */
function cameras(sigma: (t: number) => number | undefined, x: (t: number) => number = () => 0): SourceCamera[] {
  return Array.from({ length: FRAMES }, (_, t) => {
    const s = sigma(t);
    return {
      t,
      c2w: matrixOf({ rotation: [1, 0, 0, 0], position: [x(t), 0, 0] }),
      fx: FX,
      fy: FX,
      cx: 320,
      cy: 180,
      width: 640,
      height: 360,
      ...(s === undefined ? {} : { distance_sigma: s }),
    };
  });
}

interface Scene {
  path: SourcePath;
  limit: DistanceLimit | null;
  safe: SafeRegion;
  rig: CameraRig;
}

function scene(sigma: (t: number) => number | undefined, x?: (t: number) => number, lively = true, radius = 1): Scene {
  const all = cameras(sigma, x);
  const path = new SourcePath(all);
  const limit = DistanceLimit.of(path, all, CENTRE, FPS);
  const safe = new SafeRegion(path, radius, CENTRE, limit);
  return { path, limit, safe, rig: new CameraRig(path, safe, CENTRE, lively) };
}

/** What a sigma displaces from so far beside, pixels. */
const displaced = (sigma: number, aside: number): number => (FX * aside * sigma) / DEPTH;

describe("the limit of moving parts", () => {
  test("one sigma is 3 pixels there", () => {
    for (const sigma of [0.04, 0.06, 0.1]) {
      const { safe } = scene(() => sigma);
      expect(displaced(sigma, safe.radiusAt(7))).toBeCloseTo(3, 9);
      expect(safe.fade([0, 0.99 * safe.radiusAt(7), 0], 7)).toBe(0);
      expect(safe.fade([0, 1.01 * safe.radiusAt(7), 0], 7)).toBeGreaterThan(0);
    }
  });

  test("is absent without deviations, and beyond the region where they are small", () => {
    expect(scene(() => undefined).limit).toBeNull();
    for (const sigma of [undefined, 0.005]) {
      const { safe, rig } = scene(() => sigma);
      expect(safe.radiusAt(3)).toBe(1);
      expect(safe.stopAt(3)).toBeCloseTo(1.6);
      const plain = new SafeRegion(new SourcePath(cameras(() => undefined)), 1, CENTRE);
      for (const y of [0.5, 1.1, 1.5, 2]) {
        expect(safe.fade([0, y, 0], 3)).toBe(plain.fade([0, y, 0], 3));
        expect(safe.allows([0, 1, 0], [0, y, 0], 3)).toBe(plain.allows([0, 1, 0], [0, y, 0], 3));
        expect(safe.caution([0, y, 0], 3)).toBeNull();
      }
      rig.startSwing(3);
      expect(rig.caution(3)).toBeNull();
    }
  });

  test("always leaves a turn of three degrees", () => {
    const { safe } = scene(() => 4);
    expect(safe.radiusAt(0)).toBeCloseTo(0.05 * DEPTH);
  });

  test("is a matter of the time, without steps", () => {
    const { safe } = scene((t) => (t >= 20 && t < 25 ? 0.12 : undefined));
    expect(displaced(0.12, safe.limitAt(22))).toBeCloseTo(3, 9);
    expect(safe.radiusAt(0)).toBe(1);
    expect(safe.radiusAt(40)).toBe(1);
    for (let t = 0.25; t <= 40; t += 0.25) {
      const change = Math.abs(safe.limitAt(t) - safe.limitAt(t - 0.25));
      expect(change, `at ${t}`).toBeLessThan((0.2001 * DEPTH * 0.25) / FPS);
    }
    expect(safe.limitAt(19.5)).toBeGreaterThan(safe.limitAt(20));
    expect(safe.limitAt(19.5)).toBeLessThan(safe.limitAt(19));
  });

  test("counts from the source camera of the moment, not from its path", () => {
    const { safe } = scene(() => 0.12, (t) => 0.05 * t);
    const first: Vec3 = [0, 0, 0];
    const last: Vec3 = [2, 0, 0];
    expect(safe.fade(first, 0)).toBe(0);
    expect(safe.fade(first, 40)).toBeCloseTo(0.8);
    expect(safe.fade(last, 40)).toBe(0);
    expect(safe.fade(first, null), "in a headset it does not count").toBe(0);
  });

  test("is lifted to the filmed region", () => {
    const { safe } = scene(() => 0.12);
    const place: Vec3 = [0, 0.9, 0];
    expect(safe.fade(place, 5)).toBeCloseTo(0.8);
    safe.lifted = true;
    expect(safe.radiusAt(5)).toBe(1);
    expect(safe.fade(place, 5)).toBe(0);
    expect(safe.fade([0, 1.3, 0], 5)).toBeGreaterThan(0);
    expect(safe.caution(place, 5)).toBeNull();
  });

  test("is shown in per cent and degrees, where it is felt", () => {
    const { safe, limit } = scene(() => 0.12);
    const radius = safe.radiusAt(0);
    expect(limit?.words(0)).toBe("Moving parts are placed to ±12\u00a0%: the image fades beyond 3°");
    expect(scene(() => 0.05).limit?.words(0)).toContain("±5\u00a0%: the image fades beyond 7°");
    expect(safe.caution([0, 0.9 * radius, 0], 0)).toBeNull();
    expect(safe.caution([0, radius, 0], 0)).toBe(limit?.words(0));
    // outside of the filmed region above all
    expect(scene(() => 0.012).safe.caution([0, 5, 0], 0)).toBeNull();
  });
});

describe("the rig within the limit", () => {
  const aside = ({ rig, path }: Scene, t: number): number => distance(rig.at(t).position, path.pose(t).position);

  test("no drag, step or flight goes past the stop", () => {
    const all = scene(() => 0.12);
    const { rig, safe } = all;
    const stop = safe.stopAt(0);
    expect(stop).toBeCloseTo(1.6 * 0.25);
    rig.turn(2, 0.4, 0);
    expect(aside(all, 0)).toBeLessThan(stop + 1e-9);
    expect(aside(all, 0)).toBeGreaterThan(0.99 * stop);
    for (let i = 0; i < 20; i++) rig.zoom(0.7, 0);
    expect(aside(all, 0)).toBeLessThan(stop + 1e-9);
    rig.push = { right: 1, up: 1, ahead: 1, fast: true };
    for (let i = 0; i < 50; i++) rig.advance(0.1, 0);
    expect(rig.mode).toBe("fly");
    expect(aside(all, 0)).toBeLessThan(stop + 1e-9);
  });

  test("the room to turn, and so the pace of a drag, is that of the limit", () => {
    const { rig } = scene(() => 0.12);
    const wide = scene(() => undefined).rig;
    expect(rig.turnRoom(0)).toBeLessThan(0.3 * wide.turnRoom(0));
  });

  test("a swing stays inside and says why it is narrow", () => {
    const all = scene(() => 0.12);
    const { rig, safe, limit } = all;
    rig.startSwing(5);
    let widest = 0;
    for (let s = 0; s < 14; s += 0.05) {
      rig.advance(0.05, 5);
      expect(safe.fade(rig.at(5).position, 5)).toBe(0);
      widest = Math.max(widest, aside(all, 5));
    }
    expect(widest).toBeGreaterThan(0.7 * safe.radiusAt(5));
    expect(rig.caution(5)).toBe(limit?.words(5));
  });

  test("a swing goes along when time is moved under it", () => {
    const all = scene(() => 0.12, (t) => 0.04 * t);
    const { rig, safe } = all;
    rig.startSwing(0);
    for (let i = 0; i <= 400; i++) {
      const t = Math.min(0.1 * i, 40);
      rig.advance(0.03, t);
      expect(safe.fade(rig.at(t).position, t), `at ${t}`).toBeLessThan(1e-3);
    }
    expect(rig.swinging).toBe(true);
  });

  /** Plays from 0 to the end in images of 1/50 s; what happens between two images. */
  function play(all: Scene, from = 0, to = 40): { steps: number[]; outs: number[]; fades: number[] } {
    const [steps, outs, fades]: number[][] = [[], [], []];
    const seconds = 0.02;
    for (let t = from; t <= to; t += seconds * FPS) {
      const before = all.rig.at(t).position;
      all.rig.advance(seconds, t);
      const after = all.rig.at(t).position;
      steps?.push(distance(before, after));
      outs?.push(aside(all, t) / all.safe.limitAt(t));
      fades?.push(all.safe.fade(after, t));
    }
    return { steps: steps ?? [], outs: outs ?? [], fades: fades ?? [] };
  }

  test("play: the camera is drawn in before an object appears, smoothly", () => {
    const all = scene((t) => (t >= 20 ? 0.12 : undefined));
    all.rig.turn(0.19, 0, 0);
    const start = aside(all, 0);
    expect(start).toBeGreaterThan(0.9);
    const { steps, outs, fades } = play(all);
    expect(Math.max(...outs), "never beyond the limit").toBeLessThan(1 + 1e-6);
    expect(Math.max(...fades)).toBeLessThan(1e-9);
    expect(Math.max(...steps), "at the pace of the limit").toBeLessThan(0.21 * DEPTH * 0.02);
    expect(aside(all, 40)).toBeCloseTo(all.safe.radiusAt(40));
    expect(start).toBeGreaterThan(3 * aside(all, 40));
  });

  test("play: it goes along with a source camera that moves away", () => {
    const all = scene(() => 0.12, (t) => 0.04 * t);
    all.rig.turn(0.01, 0, 0);
    const { steps, outs } = play(all);
    expect(Math.max(...outs)).toBeLessThan(1 + 1e-6);
    expect(Math.max(...steps)).toBeLessThan(1.05 * 0.04 * 0.2);
    expect(all.rig.mode).toBe("orbit");
    expect(all.rig.caution(40)).toContain("±12\u00a0%");
  });

  test("play: from between the limit and the stop it comes back gently", () => {
    const all = scene(() => 0.12);
    all.rig.turn(1, 0, 0);
    const start = aside(all, 0);
    const { steps, outs, fades } = play(all);
    expect(fades[0]).toBeGreaterThan(0.5);
    expect(outs.at(-1)).toBeLessThan(1.001);
    expect(Math.max(...steps)).toBeLessThan(0.1 * start);
    // time is paused in the first one
    steps.slice(2).forEach((step, i) => expect(step).toBeLessThan((steps[i + 1] ?? 0) + 1e-9));
  });

  test("a cut in time moves the camera by steps, too", () => {
    const all = scene(() => 0.12, (t) => 0.04 * t);
    const { rig, safe } = all;
    play(all);
    rig.free("orbit", 40);
    const end = rig.at(40).position;
    let last = end;
    let steps = 0;
    rig.advance(0.02, 0);
    expect(distance(rig.at(0).position, end), "not at once").toBeLessThan(0.2);
    // it goes on although time is paused
    while (rig.advance(0.02, 0) && steps++ < 500) {
      expect(distance(rig.at(0).position, last)).toBeLessThan(0.2);
      last = rig.at(0).position;
    }
    expect(aside(all, 0)).toBeLessThan(1.01 * safe.radiusAt(0));
    expect(rig.advance(0.02, 0), "and ends").toBe(false);
  });

  test("nothing is drawn back while time is paused, or once the limit is lifted", () => {
    const all = scene(() => 0.12);
    const { rig, safe } = all;
    rig.turn(1, 0, 0);
    const place = rig.at(0);
    for (let i = 0; i < 20; i++) expect(rig.advance(0.02, 0)).toBe(false);
    expect(rig.at(0)).toEqual(place);
    safe.lifted = true;
    play(all);
    expect(rig.at(40)).toEqual(place);
    rig.turn(0.15, 0, 40);
    expect(aside(all, 40)).toBeGreaterThan(safe.limit?.at(40) ?? Infinity);
  });

  test("calm: without motion of its own", () => {
    const all = scene(() => 0.12, (t) => 0.04 * t, false);
    all.rig.turn(1, 0, 0);
    all.rig.advance(0.02, 30);
    expect(aside(all, 30)).toBeCloseTo(all.safe.radiusAt(30));
  });

  test("a newer scene keeps what was lifted", () => {
    const [older, newer] = [scene(() => 0.12), scene(() => 0.1)];
    older.safe.lifted = true;
    newer.rig.carry(older.rig);
    expect(newer.safe.radiusAt(0)).toBe(1);
  });
});
