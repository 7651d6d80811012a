/** A page that follows a training run: plots, newer scenes, the end. */

import { type Server, type ServerResponse, createServer } from "node:http";
import type { AddressInfo } from "node:net";
import { afterAll, beforeAll, expect, test } from "vitest";
import { Bench, ready } from "./browser";
import { elements, fixture, pageWith } from "./fixture";

const TOKEN = "secret";
/** What the program's own server allows the page. */
const POLICY =
  "default-src 'none'; script-src 'unsafe-inline' blob: data:; style-src 'unsafe-inline'; " +
  "img-src data: blob:; font-src data:; connect-src 'self' data: blob:; worker-src blob: data:; base-uri 'none'; " +
  "form-action 'none'; frame-ancestors 'none'";
const scene = fixture();
let bench: Bench;
let server: Server;
let address: string;
let stream: ServerResponse | null = null;
let served = 0;

/** The newest scene as the program sends it: length of the manifest, manifest, splats. */
function answer(): Buffer {
  const json = Buffer.from(JSON.stringify({ ...scene.manifest, title: "Newer", frames: null }));
  const length = Buffer.alloc(4);
  length.writeUInt32LE(json.length);
  return Buffer.concat([length, json, scene.bytes]);
}

beforeAll(async () => {
  bench = await Bench.start();
  server = createServer((request, response) => {
    const url = new URL(request.url ?? "/", "http://localhost");
    if (url.pathname === "/") {
      const live = { events: "/events", scene: "/scene", token: TOKEN };
      response.setHeader("content-type", "text/html");
      response.setHeader("content-security-policy", POLICY);
      const parts = elements({ ...scene, manifest: { ...scene.manifest, live } });
      response.end(pageWith({ ...parts, splats: null }));
    } else if (url.searchParams.get("token") !== TOKEN) {
      response.writeHead(403).end();
    } else if (url.pathname === "/events") {
      response.writeHead(200, { "content-type": "text/event-stream" });
      response.write(":\n\n");
      stream = response;
    } else if (url.pathname === "/scene") {
      served += 1;
      response.end(answer());
    } else {
      response.writeHead(404).end();
    }
  });
  await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
  address = `http://127.0.0.1:${(server.address() as AddressInfo).port}/`;
});
afterAll(async () => {
  await bench.stop();
  server.closeAllConnections();
  server.close();
});

const send = (event: object): boolean | undefined => stream?.write(`data: ${JSON.stringify(event)}\n\n`);

test("a run from its first splats to its end", async () => {
  const { page, errors } = await bench.open(address, { viewport: { width: 1000, height: 600 } });
  await ready(page);
  await expect.poll(() => stream !== null).toBe(true);
  expect(await page.innerText("#hint")).toMatch(/first splats/);

  for (let i = 1; i <= 5; i++) {
    send({ event: "metrics", iteration: 100 * i, iterations: 1000, loss: 0.2 / i, psnr: 20 + i, splats: 1000 * i });
  }
  await expect.poll(() => page.getAttribute("#live", "data-state")).toBe("training");
  await expect.poll(() => page.innerText("#live")).toMatch(/500 \/ 1,000[^]*25\.00 dB[^]*0\.0400[^]*5,000/);
  expect(await page.getAttribute('[data-plot="psnr"] .line', "d")).toMatch(/^M0\.00,40\.00L.*L232\.00,0\.00$/);

  send({ event: "scene", version: 1 });
  await expect.poll(() => page.innerText(".title h1"), { timeout: 20_000 }).toBe("Newer");
  await page.evaluate(() => window.minute4d.settle());
  const first = await page.evaluate(() => window.minute4d.state());
  expect(first.active).toBeGreaterThan(100);
  await expect.poll(() => page.isVisible("#hint")).toBe(false);

  // a newer scene changes neither time nor camera
  await page.evaluate(() => window.minute4d.setTime(7));
  await page.mouse.move(500, 250);
  await page.mouse.down();
  await page.mouse.move(520, 250, { steps: 3 });
  await page.mouse.up();
  await page.evaluate(() => window.minute4d.settle());
  const before = await page.evaluate(async () => ({ ...window.minute4d.state(), png: await window.minute4d.capture() }));
  const asked = served;
  send({ event: "scene", version: 2 });
  await expect.poll(() => served).toBe(asked + 1);
  await page.waitForTimeout(500);
  const after = await page.evaluate(async () => ({ ...window.minute4d.state(), png: await window.minute4d.capture() }));
  expect(after.camera).toEqual(before.camera);
  expect(after).toMatchObject({ time: 7, mode: "orbit", sorted: true });
  expect(after.png, "the same scene gives the same image").toBe(before.png);

  send({ event: "end", ok: true });
  await expect.poll(() => page.getAttribute("#live", "data-state")).toBe("finished");
  expect(errors).toEqual([]);
});
