import { expect, test } from "vitest";
import { readEvent } from "../src/live/events";
import { Series, linePath } from "../src/live/series";

test("events of a run", () => {
  const metrics = { event: "metrics", iteration: 10, iterations: 100, loss: 0.1, psnr: 25, splats: 1000 };
  expect(readEvent(JSON.stringify({ ...metrics, more: 1 }))).toEqual(metrics);
  expect(readEvent('{"event":"scene","version":3}')).toEqual({ event: "scene", version: 3 });
  expect(readEvent('{"event":"end","ok":false}')).toEqual({ event: "end", ok: false });
  expect(readEvent('{"event":"end"}')).toEqual({ event: "end", ok: false });
});

test("anything else is left alone", () => {
  for (const text of ["", "x", "1", "null", "[]", '{"event":"log"}', '{"event":"metrics"}']) {
    expect(readEvent(text), text).toBeNull();
  }
});

test("a value that is missing is a gap, not a zero", () => {
  const event = readEvent('{"event":"metrics","iteration":1,"loss":0.5}');
  expect(event?.event === "metrics" && Number.isNaN(event.psnr)).toBe(true);
  const series = new Series();
  series.push(1, Number.NaN);
  expect(series.last).toBeNull();
});

test("a series stays short and keeps its ends", () => {
  const series = new Series();
  for (let i = 0; i < 100_000; i++) series.push(i, i * i);
  expect(series.points.length).toBeLessThan(1100);
  expect(series.points[0]).toEqual({ x: 0, y: 0 });
  expect(series.points.at(-1)).toEqual({ x: 99_999, y: 99_999 ** 2 });
  const xs = series.points.map((p) => p.x);
  expect(xs.toSorted((a, b) => a - b)).toEqual(xs);
});

test("a run that begins again writes over what came after", () => {
  const series = new Series();
  for (const x of [1, 2, 3, 4]) series.push(x, 0);
  series.push(2, 9);
  expect(series.points).toEqual([{ x: 1, y: 0 }, { x: 2, y: 9 }]);
});

test("lines fill their box, larger values higher", () => {
  expect(linePath([{ x: 5, y: 1 }, { x: 10, y: 3 }, { x: 15, y: 2 }], 100, 40)).toBe("M0.00,40.00L50.00,0.00L100.00,20.00");
  expect(linePath([{ x: 0, y: 7 }, { x: 1, y: 7 }], 100, 40)).toBe("M0.00,20.00L100.00,20.00");
  expect(linePath([{ x: 0, y: 7 }], 100, 40)).toBe("");
});
