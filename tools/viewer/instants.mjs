#!/usr/bin/env node
/**
 * What an instant of a page costs in a headless Chromium that draws in software.
 *
 *     tools/viewer/instants.mjs out/viewer.html [--size 640x420] [--instants 24] [--seconds 10] [--shots FOLDER]
 *
 * `settled`: milliseconds from setting a time to its finished image, one instant after the other, and CPU milliseconds
 * of all of the browser's processes for it, which hold on a busy machine too.
 * `playing`: how many different images were drawn in a second while it played by itself, and what the page
 * reports of them. `first`: milliseconds from opening the file to the first thing painted and to the scene.
 * `--shots` keeps screenshots of playback at 1x and 2x.
 *
 * Playwright is that of crates/m4_viewer/page (`npm ci` there first); CHROMIUM=/path, default /usr/bin/chromium.
 */

import { mkdirSync } from "node:fs";
import { createRequire } from "node:module";
import { resolve } from "node:path";
import { pathToFileURL } from "node:url";
import { parseArgs } from "node:util";

const require = createRequire(new URL("../../crates/m4_viewer/page/package.json", import.meta.url));
const { chromium } = require("playwright-core");
const { values, positionals } = parseArgs({
  allowPositionals: true,
  options: {
    size: { type: "string", default: "640x420" },
    instants: { type: "string", default: "24" },
    seconds: { type: "string", default: "10" },
    shots: { type: "string" },
  },
});
const [file] = positionals;
if (!file) throw new Error("give it a viewer.html");
const [width, height] = values.size.split("x").map(Number);
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  headless: true,
  args: [
    ...["--no-sandbox", "--no-first-run", "--disable-background-networking", "--disable-component-update"],
    ...["--disable-sync", "--disable-quic", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
  ],
});

const device = await browser.newBrowserCDPSession();

/** CPU milliseconds of all processes of the browser so far. */
async function cpuMs() {
  const { processInfo } = await device.send("SystemInfo.getProcessInfo");
  return 1000 * processInfo.reduce((sum, p) => sum + p.cpuTime, 0);
}

async function open(reducedMotion) {
  const context = await browser.newContext({ viewport: { width, height }, reducedMotion });
  const page = await context.newPage();
  await page.goto(pathToFileURL(resolve(file)).href, { waitUntil: "commit" });
  await page.waitForFunction(() => window.minute4d, null, { timeout: 120_000 });
  await page.evaluate(() => window.minute4d.ready);
  return page;
}

/** Milliseconds of settled instants, all over the clip; the finished image is waited for by reading a pixel. */
async function settled() {
  const page = await open("reduce");
  const first = await page.evaluate(() => ({
    painted: performance.getEntriesByName("first-contentful-paint")[0]?.startTime ?? null,
    scene: performance.now(),
  }));
  const before = await cpuMs();
  const times = await page.evaluate(async (instants) => {
    const canvas = document.querySelector("#view");
    const gl = canvas.getContext("webgl2");
    const frames = Number(document.querySelector('[data-control="scrub"]').max);
    const out = [];
    for (let i = 0; i < instants; i++) {
      const from = performance.now();
      window.minute4d.setTime((frames * ((i * 7) % instants)) / instants);
      await window.minute4d.settle();
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
      out.push(performance.now() - from);
    }
    return out;
  }, Number(values.instants));
  const cpu = ((await cpuMs()) - before) / times.length;
  await page.context().close();
  times.sort((a, b) => a - b);
  return { first, medianMs: times[times.length >> 1], leastMs: times[0], mostMs: times.at(-1), cpuMs: cpu };
}

async function playing() {
  const page = await open("no-preference");
  await page.waitForTimeout(2000);
  const seen = await page.evaluate(async (seconds) => {
    const different = new Set();
    const from = performance.now();
    const active = [];
    while (performance.now() - from < 1000 * seconds) {
      await new Promise((done) => requestAnimationFrame(done));
      const s = window.minute4d.state();
      // a page that does not tell what an instant costs draws times whose order is not there
      if (s.instant) different.add(s.time);
      active.push(s.active);
    }
    const s = window.minute4d.state();
    return { images: different.size / seconds, active: Math.max(...active), width: s.width, height: s.height, instant: s.instant };
  }, Number(values.seconds));
  if (values.shots) {
    mkdirSync(values.shots, { recursive: true });
    for (const speed of [1, 2]) {
      await page.evaluate((v) => {
        const range = document.querySelector('[data-control="speed"]');
        range.value = String(v);
        range.dispatchEvent(new Event("input"));
      }, speed);
      for (let i = 0; i < 3; i++) {
        await page.waitForTimeout(1100);
        await page.screenshot({ path: `${values.shots}/${width}x${height}-${speed}x-${i}.png` });
      }
    }
  }
  await page.context().close();
  return seen;
}

try {
  process.stdout.write(`${JSON.stringify({ settled: await settled(), playing: await playing() }, null, 1)}\n`);
} finally {
  await browser.close();
}
