/** The rendered image agrees with the definition, and needs nothing but the file. */

import { afterAll, beforeAll, expect, test } from "vitest";
import { Bench, type Opened, ready } from "./browser";
import { FRAMES, type Fixture, elements, fixture, pageWith, turningFixture } from "./fixture";
import { type Shot, render } from "./reference";

const scene = fixture();
const turning = turningFixture();
let bench: Bench;
let opened: Opened;
let bound: Opened;

beforeAll(async () => {
  bench = await Bench.start();
  opened = await bench.open(bench.file("page.html", pageWith(elements(scene))));
  await ready(opened.page);
  bound = await bench.open(bench.file("turning.html", pageWith(elements(turning))));
  await ready(bound.page);
});
afterAll(() => bench.stop());

/** A camera between those of the source, and times that show every kind of splat. */
function shots(): Shot[] {
  const [first, , last] = scene.manifest.cameras;
  if (!first || !last) throw new Error("the scene has three cameras");
  const at = (c: typeof first, t: number): Shot => ({ ...c, t });
  const aside = first.c2w.map((v, i) => (i === 3 ? v - 0.6 : i === 11 ? v + 1.5 : v));
  return [at(first, 0), at(last, FRAMES - 1), at(first, 7.25), { ...at(first, 11.5), c2w: aside, fx: 210, fy: 260 }];
}

/** Pixels of a PNG, red, green, blue, alpha. */
async function pixels(url: string): Promise<number[]> {
  return opened.page.evaluate(async (data) => {
    const image = new Image();
    image.src = data;
    await image.decode();
    const canvas = new OffscreenCanvas(image.width, image.height);
    const context = canvas.getContext("2d");
    if (!context) throw new Error("no canvas");
    context.drawImage(image, 0, 0);
    return [...context.getImageData(0, 0, image.width, image.height).data];
  }, url);
}

/** At keys, between them, while one window takes over from the other, and from aside. */
function turningShots(): Shot[] {
  const [, camera] = turning.manifest.cameras;
  if (!camera) throw new Error("the scene has three cameras");
  const at = (t: number): Shot => ({ ...camera, t });
  // a fifth of a turn about the object, 4 units away
  const [c, s] = [Math.cos(0.7), Math.sin(0.7)];
  const aside = [c, 0, -s, 4 * s, 0, 1, 0, 0, s, 0, c, 4 - 4 * c, 0, 0, 0, 1];
  return [at(0), at(3), at(2.4), at(4.6), at(6.9), { ...at(8.2), c2w: aside }];
}

async function capture(shot: Shot, { page } = opened): Promise<string> {
  return page.evaluate(async (s) => {
    window.minute4d.setTime(s.t);
    window.minute4d.setCamera(s.c2w, s.fx, s.fy, s.cx, s.cy);
    return window.minute4d.capture();
  }, shot);
}

/** `least`: by how much the image differs from the background at least, mean of a channel. */
async function agrees(of: Fixture, at: Opened, shot: Shot, least: number): Promise<void> {
  const got = await pixels(await capture(shot, at));
  const expected = render(of.data, of.manifest, shot);
  expect(got.length).toBe((expected.length / 3) * 4);
  let [squares, worst] = [0, 0];
  let spread = 0;
  for (let i = 0; i < expected.length; i++) {
    const off = (got[4 * Math.floor(i / 3) + (i % 3)] ?? 0) - (expected[i] ?? 0);
    squares += off * off;
    worst = Math.max(worst, Math.abs(off));
    spread += Math.abs((expected[i] ?? 0) - 255 * (of.manifest.background[i % 3] ?? 0));
  }
  const psnr = 10 * Math.log10(255 ** 2 / (squares / expected.length));
  expect(spread / expected.length, "the image is not empty").toBeGreaterThan(least);
  // rounding to a byte alone gives 58.9 dB
  expect(psnr).toBeGreaterThan(54);
  // two splats of nearly one depth may change places in a few pixels
  expect(worst).toBeLessThan(16);
}

test.each(shots().map((s, i) => [i, s] as const))("image %i agrees with the definition", (_i, shot) => agrees(scene, opened, shot, 20));

test.each(turningShots().map((s, i) => [i, s] as const))("image %i of bound splats agrees with the definition", async (_i, shot) => {
  await agrees(turning, bound, shot, 9);
  const { data, manifest } = turning;
  const { nStatic, nBound } = data;
  const opacity = data.opacity.map((v, i) => (i >= nStatic && i < nStatic + nBound ? 0 : v));
  const [all, without] = [render(data, manifest, shot), render({ ...data, opacity }, manifest, shot)];
  const change = all.reduce((sum, v, i) => sum + Math.abs(v - (without[i] ?? 0)), 0) / all.length;
  expect(change, "bound splats are a part of the image").toBeGreaterThan(3);
});

test("bound splats take part, and no more than there are at an instant", async () => {
  const active = async (t: number): Promise<number> =>
    bound.page.evaluate(async (at) => {
      window.minute4d.setTime(at);
      await window.minute4d.settle();
      return window.minute4d.state().active;
    }, t);
  const { static: fixed, dynamic } = turning.manifest.splats;
  for (const t of [0, 4.6, 9]) {
    const count = await active(t);
    expect(count).toBeGreaterThan(20);
    expect(count).toBeLessThan(fixed + dynamic);
  }
});

test("the same view gives the same image bit for bit, another time gives another", async () => {
  const [first, second] = shots();
  if (!first || !second) throw new Error("there are shots");
  const once = await capture(first);
  const other = await capture(second);
  expect(other).not.toBe(once);
  expect(await capture(first)).toBe(once);
});

test("nothing is asked of the network, and nothing complains", () => {
  for (const { requests, errors } of [opened, bound]) {
    expect(requests).toEqual([]);
    expect(errors).toEqual([]);
  }
});
