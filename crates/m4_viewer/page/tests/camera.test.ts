import { describe, expect, test } from "vitest";
import { flies, fliedVelocity, pushOf } from "../src/camera/fly";
import { nearer, pivotOf, turned } from "../src/camera/orbit";
import { SourcePath } from "../src/camera/path";
import { CameraRig } from "../src/camera/rig";
import { SafeRegion } from "../src/camera/safe";
import { swingAngle, swung } from "../src/camera/swing";
import { fitLens } from "../src/camera/view";
import { type Pose, type Vec3, axis, distance, dot, matrixOf, norm, sub } from "../src/maths";
import type { SourceCamera } from "../src/scene";

const UP: Vec3 = [0, -1, 0];
const CENTRE: Vec3 = [0, 0, 5];

/** A camera that looks along z from `x` at time `t`. */
const camera = (t: number, x: number): SourceCamera => ({
  t,
  c2w: matrixOf({ rotation: [1, 0, 0, 0], position: [x, 0, 0] }),
  fx: 500,
  fy: 500,
  cx: 320,
  cy: 180,
  width: 640,
  height: 360,
});
const path = new SourcePath([camera(0, 0), camera(10, 1), camera(20, 3)]);
const rig = (lively = true, radius = 1): CameraRig =>
  new CameraRig(path, new SafeRegion(path, radius, CENTRE), CENTRE, lively);
/** How far the line of sight passes from a point. */
const miss = (pose: Pose, point: Vec3): number => {
  const way = sub(point, pose.position);
  return Math.acos(Math.min(1, dot(way, axis(pose, 2)) / norm(way)));
};

describe("the source path", () => {
  test("between cameras and beyond them", () => {
    expect(path.pose(5).position[0]).toBeCloseTo(0.5);
    expect(path.pose(15).position[0]).toBeCloseTo(2);
    expect([path.pose(-5), path.pose(99)].map((p) => p.position[0])).toEqual([0, 3]);
    expect([4, 6, 15, 16, 99].map((t) => path.nearestIndex(t))).toEqual([0, 1, 1, 2, 2]);
  });

  test("up is against the cameras' down", () => {
    path.up.forEach((v, k) => expect(v).toBeCloseTo(UP[k] ?? 0));
  });

  test("the nearest point lies on a segment", () => {
    const near = path.nearest([2, 0.5, 0]);
    expect(near.distance).toBeCloseTo(0.5);
    expect(near.point[0]).toBeCloseTo(2);
    expect(path.nearest([5, 0, 0]).distance).toBeCloseTo(2);
  });

  test("a scene without cameras can be looked at", () => {
    const none = new SourcePath([]);
    expect(none.pose(3).position).toEqual([0, 0, 0]);
    expect(none.lens(3).width).toBeGreaterThan(0);
  });

  test("cameras at one time are no division by nothing", () => {
    const same = new SourcePath([camera(1, 0), camera(1, 2)]);
    expect(same.pose(1).position.every(Number.isFinite)).toBe(true);
  });
});

describe("orbiting", () => {
  const pose: Pose = { rotation: [1, 0, 0, 0], position: [0, 0, 0] };

  test("the pivot lies ahead, as deep as the centre", () => {
    expect(pivotOf(pose, [1, 1, 5])).toEqual([0, 0, 5]);
    const behind = pivotOf(pose, [0, 0, -4]);
    expect(behind[2]).toBeGreaterThan(0);
    expect(pivotOf(pose, [0, 0, 50], 7), "but on a long walk no farther than things are").toEqual([0, 0, 7]);
    expect(pivotOf(pose, [0, 0, 0], 0)[2]).toBeGreaterThan(0);
  });

  test("keeps distance and aim, and its directions", () => {
    const side = turned(pose, CENTRE, UP, 0.5, 0);
    expect(distance(side.position, CENTRE)).toBeCloseTo(5, 9);
    expect(miss(side, CENTRE)).toBeLessThan(1e-6);
    expect(side.position[0], "a positive turn goes right").toBeGreaterThan(0);
    expect(turned(pose, CENTRE, UP, 0, 0.3).position[1], "and a positive pitch down").toBeGreaterThan(0);
  });

  test("stops before the poles", () => {
    let now = pose;
    for (let i = 0; i < 50; i++) now = turned(now, CENTRE, UP, 0, -0.3);
    const height = Math.acos(dot(axis(now, 2), UP));
    expect(height).toBeLessThan(Math.PI - 0.05);
    expect(now.position.every(Number.isFinite)).toBe(true);
  });

  test("nearer halves the distance", () => {
    expect(distance(nearer(pose, CENTRE, 0.5).position, CENTRE)).toBeCloseTo(2.5);
  });
});

describe("the safe region", () => {
  const safe = new SafeRegion(path, 1, CENTRE);

  test("fades from the radius to the stop", () => {
    expect(safe.fade([0, 0.9, 0], 0)).toBe(0);
    expect(safe.fade([0, 1.3, 0], 0)).toBeGreaterThan(0.1);
    expect(safe.fade([0, safe.stopAt(0), 0], 0)).toBeCloseTo(0.8);
  });

  test("holds a place at its edge", () => {
    expect(safe.hold([0, 1, 0], [0, 9, 0], 0)[1]).toBeCloseTo(safe.stopAt(0));
    expect(safe.hold([0, 1, 0], [0, 0.5, 0], 0)).toEqual([0, 0.5, 0]);
  });

  test("lets back in who is outside", () => {
    expect(safe.allows([0, 9, 0], [0, 8, 0], 0)).toBe(true);
    expect(safe.allows([0, 1, 0], [0, 8, 0], 0)).toBe(false);
  });

  test("a radius of nothing still lets a camera move a little", () => {
    expect(new SafeRegion(path, 0, CENTRE).radius).toBeGreaterThan(0);
  });
});

describe("bullet time", () => {
  const base = path.pose(10);

  test("begins where the camera is and stays in the safe region, looking at one point", () => {
    for (const radius of [0.05, 0.3, 2]) {
      const safe = new SafeRegion(path, radius, CENTRE);
      const pivot = pivotOf(base, CENTRE);
      const angle = swingAngle(base, pivot, radius);
      expect(swung(base, pivot, UP, angle, 0).position).toEqual(base.position);
      let widest = 0;
      for (let s = 0; s < 14; s += 0.05) {
        const pose = swung(base, pivot, UP, angle, s);
        expect(safe.fade(pose.position, 10)).toBe(0);
        expect(miss(pose, pivot)).toBeLessThan(1e-6);
        widest = Math.max(widest, distance(pose.position, base.position));
      }
      expect(widest).toBeGreaterThan(0.3 * Math.min(radius, 1));
    }
  });
});

describe("flying", () => {
  test("keys push along axes", () => {
    expect(pushOf(new Set(["KeyW", "ArrowRight", "KeyQ"]))).toEqual({ right: 1, up: -1, ahead: 1, fast: false });
    expect(pushOf(new Set(["KeyW", "KeyS", "ShiftLeft"]))).toEqual({ right: 0, up: 0, ahead: 0, fast: true });
    expect([flies("KeyA"), flies("KeyX")]).toEqual([true, false]);
  });

  test("speed builds up to its reach and dies away, whatever the steps", () => {
    const pose = path.pose(0);
    const ahead = pushOf(new Set(["KeyW"]));
    const run = (steps: number): Vec3 => {
      let v: Vec3 = [0, 0, 0];
      for (let i = 0; i < steps; i++) v = fliedVelocity(v, pose, UP, ahead, 2, 0.3 / steps);
      return v;
    };
    expect(run(3)[2]).toBeCloseTo(run(30)[2], 9);
    expect(norm(fliedVelocity([0, 0, 2], pose, UP, pushOf(new Set()), 2, 2))).toBeLessThan(1e-6);
  });
});

describe("the rig", () => {
  test("rides, and is freed without a jump", () => {
    const r = rig();
    expect(r.at(5)).toEqual(path.pose(5));
    r.free("orbit", 5);
    expect(r.at(5)).toEqual(path.pose(5));
    expect(r.at(15), "time no longer moves it").toEqual(path.pose(5));
  });

  test("glides back to the source camera", () => {
    const r = rig();
    r.turn(0.1, 0, 0);
    const away = r.at(0);
    r.ride(0);
    expect(distance(r.at(0).position, away.position)).toBeLessThan(1e-9);
    r.advance(0.35, 0);
    expect(r.gliding).toBe(true);
    r.advance(0.5, 0);
    expect(r.at(0)).toEqual(path.pose(0));
  });

  test("calm: no gliding, no swing", () => {
    const r = rig(false);
    r.turn(0.1, 0, 0);
    r.ride(0);
    expect(r.at(0)).toEqual(path.pose(0));
    r.startSwing(0);
    expect(r.swinging).toBe(false);
    expect(r.mode).toBe("orbit");
  });

  test("a drag takes over from the swing where it is", () => {
    const r = rig();
    r.startSwing(10);
    r.advance(1.7, 10);
    const swinging = r.at(10);
    r.turn(0, 0, 10);
    expect(r.swinging).toBe(false);
    expect(r.at(10)).toEqual(swinging);
  });

  test("nothing takes the camera past the stop", () => {
    const r = rig();
    const stop = r.safe.stopAt(0) + 1e-6;
    const far = (): number => path.nearest(r.at(0).position).distance;
    r.turn(3, 0.5, 0);
    expect(far()).toBeLessThan(stop);
    for (let i = 0; i < 40; i++) r.zoom(1.3, 0);
    expect(far()).toBeLessThan(stop);
    for (let i = 0; i < 40; i++) r.pan(0.3, -0.2, 0);
    expect(far()).toBeLessThan(stop);
    r.push = pushOf(new Set(["KeyE", "KeyS"]));
    for (let i = 0; i < 100; i++) r.advance(0.1, 0);
    expect(far()).toBeLessThan(stop);
    expect(r.mode).toBe("fly");
  });

  test("the room to turn is known before", () => {
    const r = rig();
    r.free("orbit", 0);
    const room = r.turnRoom(0);
    r.turn(-0.98 * room, 0, 0);
    const inside = path.nearest(r.at(0).position).distance;
    expect(inside).toBeLessThan(r.safe.stopAt(0));
    expect(inside).toBeGreaterThan(0.9 * r.safe.stopAt(0));
  });

  test("at the edge it can still turn back", () => {
    const r = rig();
    r.turn(3, 0, 0);
    const edge = path.nearest(r.at(0).position).distance;
    r.turn(-0.1, 0, 0);
    expect(path.nearest(r.at(0).position).distance).toBeLessThan(edge);
  });
});

describe("fitting the frame into the window", () => {
  const lens = path.lens(0);

  test("the same shape fills it", () => {
    const { lens: fitted, placement } = fitLens(lens, 1280, 720);
    expect(fitted).toEqual({ fx: 1000, fy: 1000, cx: 640, cy: 360, width: 1280, height: 720 });
    expect(placement).toEqual({ x: 0, y: 0, width: 1280, height: 720 });
  });

  test("upright, the frame is cut a little and the window is empty above and below", () => {
    const { placement } = fitLens(lens, 360, 640);
    expect(placement.width).toBeCloseTo(1.6 * 360);
    expect(placement.height).toBeLessThan(640);
    expect(placement.x).toBeLessThan(0);
  });

  test("pixels of the frame are where the lens puts them", () => {
    const { lens: fitted, placement } = fitLens(lens, 500, 700);
    // a ray through the corner of the frame
    const [x, y] = [-lens.cx / lens.fx, -lens.cy / lens.fy];
    expect(fitted.fx * x + fitted.cx).toBeCloseTo(placement.x);
    expect(fitted.fy * y + fitted.cy).toBeCloseTo(placement.y);
  });
});
