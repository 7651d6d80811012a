import { expect, test } from "vitest";
import { Clock, timecode } from "../src/clock";

const playing = (repeat: Clock["repeat"]): Clock => {
  const clock = new Clock(0, 20, 10);
  clock.repeat = repeat;
  clock.play();
  return clock;
};

test("a loop goes on at the beginning", () => {
  const clock = playing("loop");
  clock.advance(1.5);
  expect(clock.time).toBeCloseTo(15);
  clock.advance(1);
  expect(clock.time).toBeCloseTo(5);
  expect(clock.playing).toBe(true);
});

test("to and fro turns at both ends, and keeps its direction in a pause", () => {
  const clock = playing("swing");
  clock.advance(2.5);
  expect(clock.time).toBeCloseTo(15);
  clock.pause();
  clock.play();
  clock.advance(1);
  expect(clock.time).toBeCloseTo(5);
  clock.advance(1);
  expect(clock.time).toBeCloseTo(5);
  clock.advance(0.5);
  expect(clock.time).toBeCloseTo(10);
});

test("once stops at the end and begins anew", () => {
  const clock = playing("once");
  clock.advance(5);
  expect([clock.time, clock.playing]).toEqual([20, false]);
  clock.play();
  expect([clock.time, clock.playing]).toEqual([0, true]);
});

test("speed is held within its limits and multiplies the steps", () => {
  const clock = playing("once");
  clock.speed = 9;
  expect(clock.speed).toBe(4);
  clock.advance(0.4);
  expect(clock.time).toBeCloseTo(16);
  clock.speed = Number.NaN;
  expect(clock.speed).toBe(1);
});

test("steps land on whole frames and stay inside", () => {
  const clock = playing("loop");
  clock.time = 3.4;
  clock.step(1);
  expect([clock.time, clock.playing]).toEqual([4, false]);
  clock.step(-100);
  expect(clock.time).toBe(0);
  clock.time = Number.NaN;
  expect(clock.time).toBe(0);
});

test("a scene of one instant does not play", () => {
  const clock = new Clock(0, 0, 30);
  clock.play();
  expect(clock.playing).toBe(false);
  expect(clock.advance(1)).toBe(false);
});

test("timecodes", () => {
  expect([0, 1.25, 59.999, 83.456].map(timecode)).toEqual(["0:00.00", "0:01.25", "1:00.00", "1:23.46"]);
});
