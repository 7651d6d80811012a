import { expect, test } from "vitest";
import { Timing } from "../src/render/timing";

test("medians of the last instants, and how many come in a second", () => {
  const timing = new Timing();
  expect(timing.rate(0)).toBe(0);
  for (let i = 0; i < 40; i++) timing.push({ slice: i, readback: 0, sort: 2, draw: i === 39 ? 1000 : 5 }, 100 * i);
  expect(timing.cost).toEqual({ slice: 34, readback: 0, sort: 2, draw: 5 });
  expect(timing.rate(3900)).toBeCloseTo(10);
  expect(timing.rate(20_000)).toBe(0);
  timing.push({ slice: 1, readback: 1, sort: 1, draw: 1 }, 30_000);
  timing.push({ slice: 1, readback: 1, sort: 1, draw: 1 }, 30_500);
  expect(timing.rate(30_600)).toBeCloseTo(2);
  timing.restart();
  expect(timing.count).toBe(0);
});
