/** Every control does what it says, by mouse, by key and by touch. */

import type { Page } from "playwright-core";
import { afterAll, afterEach, beforeAll, expect, test } from "vitest";
import type { PageState } from "../../src/api";
import { Bench, ready } from "./browser";
import { FRAMES, elements, fixture, pageWith } from "./fixture";

const scene = fixture();
const DESK = { viewport: { width: 760, height: 428 } };
const PHONE = { viewport: { width: 360, height: 640 }, hasTouch: true, isMobile: true };
let bench: Bench;
let url: string;

beforeAll(async () => {
  bench = await Bench.start();
  url = bench.file("page.html", pageWith(elements(scene)));
});
afterEach(() => bench.clear());
afterAll(() => bench.stop());

const state = (page: Page): Promise<PageState> => page.evaluate(() => window.minute4d.state());
/** The state when what was asked for is shown. */
const settled = (page: Page): Promise<PageState> =>
  page.evaluate(async () => {
    await window.minute4d.settle();
    return window.minute4d.state();
  });
const control = (name: string): string => `[data-control="${name}"]`;
const position = (s: PageState): number[] => [3, 7, 11].map((i) => s.camera.c2w[i] ?? 0);
const apart = (a: PageState, b: PageState): number => Math.hypot(...position(a).map((v, i) => v - (position(b)[i] ?? 0)));

async function desk(motion: "reduce" | "no-preference" = "reduce", address = url): Promise<Page> {
  const { page } = await bench.open(address, { ...DESK, reducedMotion: motion });
  await ready(page);
  return page;
}

test("plays by itself, unless less motion is asked for", async () => {
  expect((await state(await desk("reduce"))).playing).toBe(false);
  const page = await desk("no-preference");
  expect((await state(page)).playing).toBe(true);
  await page.keyboard.press("Space");
  const stopped = await state(page);
  expect(stopped.playing).toBe(false);
  await page.click(control("play"));
  await expect.poll(async () => (await state(page)).time).not.toBe(stopped.time);
});

test("the time line goes by frames with keys, and anywhere with the mouse", async () => {
  const page = await desk();
  await page.focus(control("scrub"));
  for (const key of ["ArrowRight", "ArrowRight", "ArrowLeft", "PageUp"]) await page.keyboard.press(key);
  expect((await settled(page)).time).toBe(11);
  await page.keyboard.press("End");
  expect((await settled(page)).time).toBe(FRAMES - 1);
  const box = await page.locator(control("scrub")).boundingBox();
  if (!box) throw new Error("the time line is not there");
  await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
  expect((await settled(page)).time).toBeCloseTo((FRAMES - 1) / 2, 0);
  expect(await page.getAttribute(control("scrub"), "aria-valuetext")).toMatch(/^0:0\d\.\d\d, frame 1[12] of 23$/);
});

test("the timings of an instant are shown on the page and to scripts", async () => {
  const page = await desk("no-preference");
  expect(await page.isVisible("#meter")).toBe(false);
  await page.keyboard.press("i");
  await expect
    .poll(() => page.innerText("#meter"), { timeout: 20_000 })
    .toMatch(/^\d+\.\d instants per second\n\d+ of 300 splats\nslice .* ms\nreadback .* ms\nsort .* ms\ndraw .*[1-9].* ms\n760 x 428 pixels$/);
  const { instant, active } = await state(page);
  expect(Object.keys(instant)).toEqual(["slice_ms", "readback_ms", "sort_ms", "draw_ms", "per_second"]);
  expect(instant.draw_ms).toBeGreaterThan(0);
  expect(active).toBeGreaterThan(100);
  await page.keyboard.press("i");
  expect(await page.isVisible("#meter")).toBe(false);
});

test("speed and repeat", async () => {
  const page = await desk();
  await page.click(control("speed-open"));
  await page.locator(control("speed")).fill("0.5");
  expect((await state(page)).speed).toBe(0.5);
  await page.keyboard.press("Escape");
  expect(await page.isVisible(control("speed"))).toBe(false);
  await page.locator("#view").focus();
  await page.keyboard.press("+");
  expect((await state(page)).speed).toBe(0.75);
  const repeats: string[] = [];
  for (let i = 0; i < 3; i++) {
    await page.click(control("loop"));
    repeats.push((await state(page)).repeat);
  }
  expect(repeats).toEqual(["swing", "once", "loop"]);
});

test("freeze: time stops, the camera swings until it is dragged, and time resumes", async () => {
  const page = await desk("no-preference");
  await page.click(control("freeze"));
  const before = await state(page);
  expect(before).toMatchObject({ frozen: true, swinging: true, playing: false });
  await expect.poll(async () => apart(await state(page), before), { timeout: 20_000 }).toBeGreaterThan(0.01);
  expect((await state(page)).time).toBe(before.time);
  expect((await state(page)).fade).toBe(0);
  await page.mouse.move(400, 200);
  await page.mouse.down();
  await page.mouse.move(420, 205, { steps: 3 });
  await page.mouse.up();
  expect(await state(page)).toMatchObject({ frozen: true, swinging: false, mode: "orbit" });
  await page.click(control("freeze"));
  expect(await state(page)).toMatchObject({ frozen: false, mode: "ride", playing: true });
});

test("freeze without motion stops time and hands over the camera", async () => {
  const page = await desk("reduce");
  await page.click(control("freeze"));
  expect(await state(page)).toMatchObject({ frozen: true, swinging: false, mode: "orbit" });
});

test("orbit by mouse, fly by keys, and back to the source", async () => {
  const page = await desk();
  const start = await state(page);
  await page.mouse.move(400, 200);
  await page.mouse.down();
  await page.mouse.move(370, 200, { steps: 4 });
  await page.mouse.up();
  const turned = await settled(page);
  expect(turned.mode).toBe("orbit");
  expect(position(turned)[0], "dragged to the left, the camera goes right").toBeGreaterThan(position(start)[0] ?? 0);
  await page.keyboard.down("KeyW");
  await expect.poll(async () => apart(await state(page), turned), { timeout: 20_000 }).toBeGreaterThan(0.05);
  await page.keyboard.up("KeyW");
  expect((await state(page)).mode).toBe("fly");
  await page.keyboard.press("KeyC");
  const back = await settled(page);
  expect(back.mode).toBe("ride");
  expect(apart(back, start)).toBeLessThan(1e-9);
});

test("the image fades outside the filmed region, and the camera stops", async () => {
  const page = await desk();
  await page.mouse.move(400, 200);
  for (let i = 0; i < 12; i++) await page.mouse.wheel(0, 300);
  await expect.poll(async () => (await state(page)).fade).toBeGreaterThan(0.5);
  expect(await page.isVisible("#hint")).toBe(true);
  const [x = 0, y = 0, z = 0] = position(await settled(page));
  // the source cameras are between x = -0.3 and 0.3
  const away = Math.hypot(Math.max(Math.abs(x) - 0.3, 0), y - 0.05, z + 0.1);
  expect(away).toBeLessThan(1.6 * scene.manifest.safe.radius + 1e-3);
  await page.click(control("reset"));
  expect(await settled(page)).toMatchObject({ mode: "ride", time: 0 });
  await expect.poll(async () => (await state(page)).fade).toBe(0);
  await expect.poll(() => page.isVisible("#hint")).toBe(false);
});

test("a link leads back to the same image", async () => {
  const page = await desk();
  await page.evaluate(() => window.minute4d.setTime(9.5));
  await page.mouse.move(400, 200);
  await page.mouse.down();
  await page.mouse.move(420, 190, { steps: 4 });
  await page.mouse.up();
  await page.click(control("link"));
  await page.waitForSelector("#toast:not([hidden])");
  const address = page.url();
  expect(address).toMatch(/#t=9\.5&c=/);
  const here = await settled(page);
  const there = await settled(await desk("no-preference", address));
  expect(there).toMatchObject({ time: 9.5, playing: false });
  expect(apart(here, there)).toBeLessThan(1e-4);
});

test("the input frame lies over its own place, and in the corner elsewhere", async () => {
  const page = await desk();
  await page.click(control("side"));
  const middle = (): Promise<number[]> =>
    page.evaluate(() => {
      const canvas = document.querySelector<HTMLCanvasElement>("#compare .picture");
      const data = canvas?.getContext("2d")?.getImageData(canvas.width / 2, canvas.height / 2, 1, 1).data;
      return data ? [...data] : [];
    });
  await expect.poll(async () => (await middle())[0]).toBeGreaterThan(150);
  await page.evaluate(() => window.minute4d.setTime(23));
  await expect.poll(async () => (await middle())[2]).toBeGreaterThan(150);
  const box = await page.locator("#compare .picture").boundingBox();
  const { camera } = await settled(page);
  const source = scene.manifest.cameras[2];
  if (!box || !source) throw new Error("the input frame is not there");
  // where the lens puts the left edge and the width of the frame
  const scale = camera.fx / source.fx;
  expect(box.x).toBeCloseTo(camera.cx - scale * source.cx, 0);
  expect(box.width).toBeCloseTo(scale * source.width, 0);
  const split = page.locator(control("split"));
  await split.focus();
  await page.keyboard.press("ArrowRight");
  expect(await split.getAttribute("aria-valuenow")).toBe("52");
  await page.click(control("orbit"));
  await expect.poll(async () => (await page.locator("#compare .picture").boundingBox())?.width).toBe(240);
});

test("themes, help, full screen and saving an image", async () => {
  const page = await desk();
  const before = (await state(page)).theme;
  await page.click(control("theme"));
  expect((await state(page)).theme).not.toBe(before);
  await page.keyboard.press("?");
  expect(await page.isVisible("#help")).toBe(true);
  await page.keyboard.press("Space");
  expect((await state(page)).playing, "the help has the keys").toBe(false);
  await page.keyboard.press("Escape");
  expect(await page.isVisible("#help")).toBe(false);
  await page.click(control("fullscreen"));
  await expect.poll(() => page.evaluate(() => document.fullscreenElement?.id)).toBe("app");
  const download = page.waitForEvent("download");
  await page.click(control("screenshot"));
  expect((await download).suggestedFilename()).toBe("Test-script-scene-0.0.png");
});

test("controls step aside while it plays, and come back", async () => {
  const page = await desk("no-preference");
  await page.mouse.move(400, 150);
  await expect.poll(async () => (await state(page)).idle, { timeout: 10_000 }).toBe(true);
  await expect.poll(() => page.isVisible(control("play"))).toBe(false);
  await page.mouse.move(410, 160);
  expect((await state(page)).idle).toBe(false);
});

test("a button that was clicked keeps neither the controls nor the keys", async () => {
  const page = await desk("no-preference");
  await page.click(control("loop"));
  await page.mouse.move(400, 150);
  await expect.poll(() => page.isVisible(control("play")), { timeout: 10_000 }).toBe(false);
  const { repeat } = await state(page);
  await page.keyboard.press("Space");
  expect(await state(page)).toMatchObject({ repeat, playing: false });
});

test("fingers: one turns, two come nearer, a tap hides the controls", async () => {
  const { page } = await bench.open(url, { ...PHONE, reducedMotion: "no-preference" });
  await ready(page);
  const device = await page.context().newCDPSession(page);
  const touch = (type: "touchStart" | "touchMove" | "touchEnd", ...points: [number, number][]): Promise<unknown> =>
    device.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });

  await page.tap("#view");
  expect((await state(page)).idle).toBe(true);
  await page.tap("#view");
  expect((await state(page)).idle).toBe(false);

  const before = await settled(page);
  await touch("touchStart", [180, 300]);
  for (const x of [170, 160, 150]) await touch("touchMove", [x, 300]);
  await touch("touchEnd");
  const turned = await settled(page);
  expect(turned.mode).toBe("orbit");
  expect(position(turned)[0]).toBeGreaterThan(position(before)[0] ?? 0);

  await touch("touchStart", [150, 300], [210, 300]);
  for (const d of [10, 20, 30]) await touch("touchMove", [150 - d, 300], [210 + d, 300]);
  await touch("touchEnd");
  const near = await settled(page);
  expect(near.mode).toBe("orbit");
  const far = (s: PageState): number => Math.hypot(...position(s).map((v, i) => v - (scene.manifest.centre[i] ?? 0)));
  expect(far(near)).toBeLessThan(far(before) - 0.2);
});

test("on a small phone everything is there, large enough and inside", async () => {
  const { page } = await bench.open(url, PHONE);
  await ready(page);
  const check = async (): Promise<string[]> =>
    page.evaluate(() =>
      [...document.querySelectorAll<HTMLElement>("button, input")]
        .filter((e) => e.checkVisibility())
        .flatMap((e) => {
          const box = e.getBoundingClientRect();
          const name = e.dataset["control"] ?? e.outerHTML;
          const inside = box.left >= 0 && box.right <= innerWidth && box.top >= 0 && box.bottom <= innerHeight;
          return [
            ...(inside ? [] : [`${name} is outside`]),
            ...(box.height >= 40 && box.width >= 44 ? [] : [`${name} is ${box.width} x ${box.height}`]),
          ];
        }),
    );
  expect(await check()).toEqual([]);
  await page.tap(control("more"));
  expect(await check()).toEqual([]);
  for (const name of ["ride", "orbit", "fly", "speed", "side", "loop", "reset", "link", "theme", "help"]) {
    expect(await page.isVisible(control(name)), name).toBe(true);
  }
  await page.tap(control("orbit"));
  expect((await state(page)).mode).toBe("orbit");
});

test("every control has a name for those who cannot see it", async () => {
  const page = await desk();
  const nameless = await page.evaluate(() =>
    [...document.querySelectorAll<HTMLElement>("button, input, [role=slider]")]
      .filter((e) => !(e.getAttribute("aria-label") || e.textContent?.trim()))
      .map((e) => e.outerHTML),
  );
  expect(nameless).toEqual([]);
});
