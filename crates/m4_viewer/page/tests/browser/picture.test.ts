/** The rendered image agrees with the definition, and needs nothing but the file. */

import { afterAll, beforeAll, expect, test } from "vitest";
import { Bench, type Opened, ready } from "./browser";
import { FRAMES, elements, fixture, pageWith } from "./fixture";
import { type Shot, render } from "./reference";

const scene = fixture();
let bench: Bench;
let opened: Opened;

beforeAll(async () => {
  bench = await Bench.start();
  opened = await bench.open(bench.file("page.html", pageWith(elements(scene))));
  await ready(opened.page);
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

async function capture(shot: Shot): Promise<string> {
  return opened.page.evaluate(async (s) => {
    window.minute4d.setTime(s.t);
    window.minute4d.setCamera(s.c2w, s.fx, s.fy, s.cx, s.cy);
    return window.minute4d.capture();
  }, shot);
}

test.each(shots().map((s, i) => [i, s] as const))("image %i agrees with the definition", async (_i, shot) => {
  const got = await pixels(await capture(shot));
  const expected = render(scene.data, scene.manifest, shot);
  expect(got.length).toBe((expected.length / 3) * 4);
  let [squares, worst] = [0, 0];
  let spread = 0;
  for (let i = 0; i < expected.length; i++) {
    const off = (got[4 * Math.floor(i / 3) + (i % 3)] ?? 0) - (expected[i] ?? 0);
    squares += off * off;
    worst = Math.max(worst, Math.abs(off));
    spread += Math.abs((expected[i] ?? 0) - 255 * (scene.manifest.background[i % 3] ?? 0));
  }
  const psnr = 10 * Math.log10(255 ** 2 / (squares / expected.length));
  expect(spread / expected.length, "the image is not empty").toBeGreaterThan(20);
  // rounding to a byte alone gives 58.9 dB
  expect(psnr).toBeGreaterThan(54);
  // two splats of nearly one depth may change places in a few pixels
  expect(worst).toBeLessThan(16);
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
  expect(opened.requests).toEqual([]);
  expect(opened.errors).toEqual([]);
});
