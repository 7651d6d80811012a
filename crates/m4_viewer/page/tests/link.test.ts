import { expect, test } from "vitest";
import { fromFragment, toFragment } from "../src/link";
import type { Pose } from "../src/maths";

const pose: Pose = { position: [1.25, -0.003, 12345.678], rotation: [0.5, -0.5, 0.5, 0.5] };

test("a place comes back", () => {
  expect(fromFragment(toFragment({ t: 12.3456 }))).toEqual({ t: 12.346 });
  const back = fromFragment(toFragment({ t: 0, pose }));
  expect(back?.t).toBe(0);
  back?.pose?.position.forEach((v, i) => expect(v).toBeCloseTo(pose.position[i] ?? 0, 1));
  back?.pose?.rotation.forEach((v, i) => expect(v).toBeCloseTo(pose.rotation[i] ?? 0, 5));
});

test("the fragment is short and needs no escaping", () => {
  const fragment = toFragment({ t: 3, pose });
  expect(fragment).toBe("#t=3&c=1.25,-0.003,12345.7,0.5,-0.5,0.5,0.5");
});

test("nonsense is no place", () => {
  for (const bad of ["", "#", "#t=", "#t=x", "#t=Infinity", "#c=1,2,3", "#t=1&c=1,2,3", "#t=1&c=0,0,0,0,0,0,0", "#t=1&c=a,b,c,d,e,f,g"]) {
    expect(fromFragment(bad), bad).toBeNull();
  }
});
