/** The scene in a headset: a stand-in device (IWER) in place of the browser's. */

import { fileURLToPath } from "node:url";
import type { XRDevice } from "iwer";
import type { Page } from "playwright-core";
import { afterAll, afterEach, beforeAll, expect, test } from "vitest";
import { type Pose, type Vec3, add, axis, axisAngle, distance, matrixOf, poseOf, quatMul, scale } from "../../src/maths";
import { Bench, ready } from "./browser";
import { elements, fixture, pageWith } from "./fixture";
import { type Shot, render } from "./reference";

declare global {
  interface Window {
    IWER: typeof import("iwer");
    device: XRDevice;
  }
}

const scene = fixture();
const HEADSET = '[data-control="headset"]';
let bench: Bench;
let url: string;

beforeAll(async () => {
  bench = await Bench.start();
  url = bench.file("page.html", pageWith(elements(scene)));
});
afterEach(() => bench.clear());
afterAll(() => bench.stop());

/** Between images of the stand-in, milliseconds: it does not wait for the software that draws them, as a headset does. */
const IMAGE_MS = 600;
/** Most for what is waited for, milliseconds: the definition takes seconds an image on a slow machine. */
const PATIENCE = { timeout: 60_000 };
const TEST_MS = 240_000;

/** A browser with a headset whose eyes are side by side on the canvas. */
async function withDevice(): Promise<Page> {
  const { page } = await bench.open(url, {}, async (page) => {
    await page.addInitScript({ path: fileURLToPath(new URL("../../node_modules/iwer/build/iwer.min.js", import.meta.url)) });
    await page.addInitScript((pause) => {
      const next = window.requestAnimationFrame.bind(window);
      window.requestAnimationFrame = (callback) => window.setTimeout(() => next(callback), pause);
      const device = new window.IWER.XRDevice(window.IWER.metaQuest3);
      device.stereoEnabled = true;
      device.installRuntime({ forceInstall: true });
      window.device = device;
    }, IMAGE_MS);
  });
  await ready(page);
  await expect.poll(() => page.$eval(HEADSET, (button) => (button as HTMLElement).hidden), PATIENCE).toBe(false);
  return page;
}

async function enter(page: Page): Promise<void> {
  // the button may be in the sheet of a narrow window
  await page.$eval(HEADSET, (button) => (button as HTMLElement).click());
  await expect.poll(() => page.getAttribute(HEADSET, "aria-pressed"), PATIENCE).toBe("true");
}

interface Seen {
  width: number;
  height: number;
  rgba: number[];
}

/** What both eyes see. */
const seen = (page: Page): Promise<Seen> =>
  page.evaluate(async () => {
    const image = new Image();
    image.src = (document.querySelector("#view") as HTMLCanvasElement).toDataURL("image/png");
    await image.decode();
    const canvas = new OffscreenCanvas(image.width, image.height);
    const context = canvas.getContext("2d");
    if (!context) throw new Error("no canvas");
    context.drawImage(image, 0, 0);
    return { width: image.width, height: image.height, rgba: [...context.getImageData(0, 0, image.width, image.height).data] };
  });

/** How well both halves agree with the definition for a head in the scene, the worse one, dB. */
async function agreement(page: Page, head: Pose, t: number): Promise<number> {
  const { width, height, rgba } = await seen(page);
  const half = Math.floor(width / 2);
  const { ipd, fovy } = await page.evaluate(() => ({ ipd: window.device.ipd, fovy: window.device.fovy }));
  const f = height / 2 / Math.tan(fovy / 2);
  const values = [-1, 1].map((side) => {
    const eye = { ...head, position: add(head.position, scale(axis(head, 0), (side * ipd * perMetre()) / 2)) };
    const shot: Shot = { t, c2w: matrixOf(eye), fx: f, fy: f, cx: half / 2, cy: height / 2, width: half, height };
    const expected = render(scene.data, scene.manifest, shot);
    let squares = 0;
    for (let i = 0; i < expected.length; i++) {
      const [pixel, channel] = [Math.floor(i / 3), i % 3];
      const column = (pixel % half) + (side < 0 ? 0 : width - half);
      const at = 4 * (Math.floor(pixel / half) * width + column) + channel;
      squares += ((rgba[at] ?? 0) - (expected[i] ?? 0)) ** 2;
    }
    return 10 * Math.log10(255 ** 2 / (squares / expected.length));
  });
  return Math.min(...values);
}

const [first] = scene.manifest.cameras;
if (!first) throw new Error("the scene has cameras");
const camera = poseOf(first.c2w);
/** The middle of the scene begins two metres ahead. */
const perMetre = (): number => distance(camera.position, scene.manifest.centre) / 2;

test("without a headset there is no button", async () => {
  const { page } = await bench.open(url);
  await ready(page);
  expect(await page.$eval(HEADSET, (button) => (button as HTMLElement).hidden)).toBe(true);
});

test("both eyes see the scene from where the head is", async () => {
  const page = await withDevice();
  await enter(page);
  await expect.poll(() => agreement(page, camera, 0), PATIENCE).toBeGreaterThan(40);
  // 20 cm to the right and 10 up, and a look to the left
  const place: Vec3 = await page.evaluate(() => {
    const { device } = window;
    device.position.x += 0.2;
    device.position.y += 0.1;
    device.quaternion.set(0, Math.sin(0.15), 0, Math.cos(0.15));
    return [0.2, -0.1, 0];
  });
  const offset = add(scale(axis(camera, 0), place[0] * perMetre()), scale(axis(camera, 1), place[1] * perMetre()));
  const head: Pose = {
    position: add(camera.position, offset),
    rotation: quatMul(camera.rotation, axisAngle([0, 1, 0], -0.3)),
  };
  await expect.poll(() => agreement(page, head, 0), PATIENCE).toBeGreaterThan(40);
}, TEST_MS);

test("a trigger plays, and the page goes on where the headset was", async () => {
  const page = await withDevice();
  await enter(page);
  const time = (): Promise<number> => page.evaluate(() => window.minute4d.state().time);
  const press = (value: number): Promise<void> =>
    page.evaluate((v) => window.device.controllers["right"]?.updateButtonValue("trigger", v), value);
  const playing = (): Promise<boolean> => page.evaluate(() => window.minute4d.state().playing);
  expect(await playing()).toBe(false);
  await press(1);
  await new Promise((resolve) => setTimeout(resolve, 3 * IMAGE_MS));
  await press(0);
  await expect.poll(playing, PATIENCE).toBe(true);
  await expect.poll(time, PATIENCE).toBeGreaterThan(0);
  await page.evaluate(() => window.device.activeSession?.end());
  await expect.poll(() => page.getAttribute(HEADSET, "aria-pressed"), PATIENCE).toBe("false");
  await page.keyboard.press("Space");
  expect(await playing()).toBe(false);
  await page.evaluate(() => window.minute4d.settle());
  const state = await page.evaluate(() => window.minute4d.state());
  expect(state.time).toBeGreaterThan(0);
  expect([state.width, state.height]).toEqual([320, 180]);
}, TEST_MS);
