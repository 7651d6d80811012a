/** Moving parts that are not placed well keep the camera near, the page says so, and the user may go on. */

import type { Page } from "playwright-core";
import { afterAll, afterEach, beforeAll, expect, test } from "vitest";
import type { PageState } from "../../src/api";
import { Bench, ready } from "./browser";
import { elements, fixture, pageWith } from "./fixture";

const SIGMA = 0.12;
const DESK = { viewport: { width: 760, height: 428 } };
const PHONE = { viewport: { width: 360, height: 640 }, hasTouch: true, isMobile: true };
const FURTHER = '[data-control="further"]';
const WORDS = "Moving parts are placed to ±12\u00a0%: the image fades beyond 5°";
let bench: Bench;
let url: string;

beforeAll(async () => {
  bench = await Bench.start();
  const scene = fixture();
  const cameras = scene.manifest.cameras.map((c) => ({ ...c, distance_sigma: SIGMA }));
  url = bench.file("page.html", pageWith(elements({ ...scene, manifest: { ...scene.manifest, cameras } })));
});
afterEach(() => bench.clear());
afterAll(() => bench.stop());

const state = (page: Page): Promise<PageState> => page.evaluate(() => window.minute4d.state());
/** From the source camera of the time that is shown, world units. */
const aside = (s: PageState): number => {
  const { cameras } = fixture().manifest;
  const x = (k: number): number => cameras[0]!.c2w[k]! + ((cameras[2]!.c2w[k]! - cameras[0]!.c2w[k]!) * s.time) / cameras[2]!.t;
  return Math.hypot(...[3, 7, 11].map((k) => s.camera.c2w[k]! - x(k)));
};

async function desk(motion: "reduce" | "no-preference" = "reduce"): Promise<Page> {
  const { page } = await bench.open(url, { ...DESK, reducedMotion: motion });
  await ready(page);
  return page;
}

async function drag(page: Page, dx: number): Promise<void> {
  await page.mouse.move(400, 200);
  await page.mouse.down();
  await page.mouse.move(400 + dx, 200, { steps: 8 });
  await page.mouse.up();
}

test("a turn fades and stops early, the page says why, and a button lifts that", async () => {
  const page = await desk();
  expect(await page.isVisible("#hint")).toBe(false);
  await drag(page, -340);
  await expect.poll(async () => (await state(page)).fade).toBeGreaterThan(0.7);
  const stopped = await state(page);
  // 3 pixels at f = 300 and 12 %, times 1.6, of the depth of about 4.1
  expect(aside(stopped)).toBeLessThan(1.6 * (3 / (300 * SIGMA)) * 4.1 + 0.01);
  expect(await page.innerText("#hint span")).toBe(WORDS);
  await page.click(FURTHER);
  await expect.poll(async () => (await state(page)).fade).toBe(0);
  expect(await page.isVisible("#hint")).toBe(false);
  await drag(page, -200);
  await expect.poll(async () => aside(await state(page))).toBeGreaterThan(1.2 * aside(stopped));
  await page.click('[data-control="reset"]');
  await drag(page, -200);
  expect(await page.isVisible(FURTHER), "for as long as the page is open").toBe(false);
});

test("by keys: one that is always there, and the button in the order of the controls", async () => {
  for (const how of ["key", "tab"]) {
    const page = await desk();
    await drag(page, -340);
    await expect.poll(() => page.isVisible(FURTHER)).toBe(true);
    if (how === "key") await page.keyboard.press("u");
    else {
      await page.focus(FURTHER);
      await page.keyboard.press("Enter");
    }
    await expect.poll(async () => (await state(page)).fade).toBe(0);
    expect(await page.isVisible(FURTHER)).toBe(false);
  }
});

test("frozen, the swing is narrow, without a fade, and says why", async () => {
  const page = await desk("no-preference");
  await page.click('[data-control="freeze"]');
  await expect.poll(() => page.innerText("#hint span")).toBe(WORDS);
  const { fade, swinging } = await state(page);
  expect({ fade, swinging }).toEqual({ fade: 0, swinging: true });
});

test("play: a turned camera goes along with the source and does not fade", async () => {
  const page = await desk("no-preference");
  await page.keyboard.press("Space");
  await page.evaluate(() => window.minute4d.setTime(0));
  await drag(page, -60);
  await page.evaluate(() => window.minute4d.settle());
  expect(aside(await state(page))).toBeGreaterThan(0.05);
  await page.keyboard.press("Space");
  await expect.poll(async () => (await state(page)).time, { timeout: 20_000 }).toBeGreaterThan(15);
  const seen = await state(page);
  expect(seen.mode).toBe("orbit");
  expect(aside(seen)).toBeLessThan(1.3 * (3 / (300 * SIGMA)) * 4.1);
});

test("on a phone the words and the button are inside and large enough", async () => {
  const { page } = await bench.open(url, { ...PHONE, reducedMotion: "no-preference" });
  await ready(page);
  await page.tap('[data-control="freeze"]');
  await page.waitForSelector(FURTHER);
  for (const part of ["#hint", FURTHER]) {
    const box = await page.locator(part).boundingBox();
    if (!box) throw new Error(`${part} is not there`);
    expect(box.x).toBeGreaterThanOrEqual(0);
    expect(box.x + box.width).toBeLessThanOrEqual(360);
    expect(box.height).toBeGreaterThanOrEqual(44);
  }
  await page.tap(FURTHER);
  await expect.poll(() => page.isVisible("#hint")).toBe(false);
});
