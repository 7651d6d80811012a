/** Every failure shows a message instead of a blank page. */

import type { Page } from "playwright-core";
import { afterAll, afterEach, beforeAll, expect, test } from "vitest";
import { Bench, ready } from "./browser";
import { type Elements, elements, fixture, pageWith } from "./fixture";

const scene = fixture();
const good = elements(scene);
let bench: Bench;

beforeAll(async () => {
  bench = await Bench.start();
});
afterEach(() => bench.clear());
afterAll(() => bench.stop());

async function message(page: Page): Promise<string> {
  await page.waitForSelector(".card.message");
  expect(await page.isVisible('[data-control="reload"]')).toBe(true);
  return page.innerText(".card.message");
}

const packed = Buffer.from(good.splats ?? "", "base64");
const flipped = Buffer.from(packed);
flipped[packed.length >> 1] = (flipped[packed.length >> 1] ?? 0) ^ 255;

test.each<[string, Partial<Elements>, RegExp]>([
  ["no manifest", { manifest: null }, /no scene in this page/],
  ["no JSON", { manifest: "{" }, /not JSON/],
  ["another version", { manifest: '{"version":1}' }, /another version/],
  ["a field that is missing", { manifest: '{"version":2}' }, /`splats`/],
  ["no splats", { splats: null }, /truncated/],
  ["half of the splats", { splats: (good.splats ?? "").slice(0, 4000) }, /damaged/],
  ["other bytes", { splats: flipped.toString("base64") }, /damaged/],
  ["no base64", { splats: "%%%%" }, /damaged/],
])("%s", async (name, change, expected) => {
  const { page } = await bench.open(bench.file(`${name}.html`, pageWith({ ...good, ...change })));
  expect(await message(page)).toMatch(expected);
  const reason = await page.evaluate(() => window.minute4d.ready.then(() => "ready", (e: unknown) => String(e)));
  expect(reason, "a waiting script gets the error, too").toMatch(/PageError/);
});

test("truncated input frames leave the scene intact", async () => {
  const frames = (good.frames ?? "").slice(0, 200);
  const { page } = await bench.open(bench.file("frames.html", pageWith({ ...good, frames })));
  await ready(page);
  await page.waitForSelector("#toast:not([hidden])");
  expect(await page.innerText("#toast")).toMatch(/input frames/);
  expect(await page.isVisible('[data-control="side"]')).toBe(false);
});

async function withoutDecoder(page: Page): Promise<void> {
  await page.addInitScript(() => Reflect.deleteProperty(window, "VideoDecoder"));
}
test.each([
  ["damaged input frames", {}, undefined, /frames are damaged/],
  ["a browser without WebCodecs", good, withoutDecoder, /browser cannot show/],
])("%s: said in their place", async (name, change, prepare, expected) => {
  // of the right length, and no H.264
  const frames = "A".repeat((good.frames ?? "").length);
  const url = bench.file(`${name}.html`, pageWith({ ...good, frames, ...change }));
  const { page } = await bench.open(url, { viewport: { width: 1000, height: 600 } }, prepare);
  await ready(page);
  await page.click('[data-control="side"]');
  await expect.poll(() => page.innerText("#compare .tag")).toMatch(expected);
  expect(await page.isVisible(".card.message"), "the scene stays").toBe(false);
});

test("a scene without input frames has nothing to compare with", async () => {
  const { page } = await bench.open(bench.file("alone.html", pageWith({ ...good, frames: null })), {
    viewport: { width: 1000, height: 600 },
  });
  await ready(page);
  expect(await page.isVisible('[data-control="reset"]')).toBe(true);
  expect(await page.isVisible('[data-control="side"]')).toBe(false);
});

const poster = (page: Page): Promise<string | null> =>
  page.evaluate(() => {
    const image = document.querySelector<HTMLElement>("#m4-poster");
    return image && `${getComputedStyle(image).visibility} ${image.className}`.trim();
  });

test("the poster lies where the frame will be, until the scene is there", async () => {
  const viewport = { width: 400, height: 600 };
  const { page } = await bench.open(bench.file("poster.html", pageWith(good)), { viewport });
  await ready(page);
  expect(await poster(page)).toBe("hidden done");
  const box = await page.evaluate(() => {
    const image = document.querySelector<HTMLElement>("#m4-poster");
    const { x, y, width, height } = image?.getBoundingClientRect() ?? { x: 0, y: 0, width: 0, height: 0 };
    return { x, y, width, height };
  });
  const { camera } = await page.evaluate(async () => {
    await window.minute4d.settle();
    return window.minute4d.state();
  });
  const [source] = scene.manifest.cameras;
  if (!source) throw new Error("the scene has cameras");
  const scale = camera.fx / source.fx;
  expect(box.width).toBeCloseTo(scale * source.width, 0);
  expect(box.height).toBeCloseTo(scale * source.height, 0);
  expect(box.x).toBeCloseTo(camera.cx - scale * source.cx, 0);
});

test("a link to another instant, and a failed page, show no poster", async () => {
  const file = bench.file("linked.html", pageWith(good));
  const { page } = await bench.open(`${file}#t=5`);
  await ready(page);
  expect(await poster(page)).toBe(null);
  const broken = await bench.open(bench.file("broken.html", pageWith({ ...good, splats: "%%%%" })));
  expect(await message(broken.page)).toMatch(/damaged/);
  expect(await poster(broken.page)).toBe(null);
});

test("a graphics context that is lost", async () => {
  const { page } = await bench.open(bench.file("lost.html", pageWith(good)));
  await ready(page);
  await page.evaluate(() => {
    const canvas = document.querySelector<HTMLCanvasElement>("#view");
    canvas?.getContext("webgl2")?.getExtension("WEBGL_lose_context")?.loseContext();
  });
  expect(await message(page)).toMatch(/graphics context was lost/);
});

test("a browser without WebGL2", async () => {
  const plain = await Bench.start(["--disable-3d-apis"]);
  try {
    const { page } = await plain.open(plain.file("plain.html", pageWith(good)));
    expect(await message(page)).toMatch(/WebGL2/);
  } finally {
    await plain.stop();
  }
});
