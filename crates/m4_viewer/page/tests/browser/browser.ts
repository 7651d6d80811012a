/** A headless Chromium with a software WebGL2. */

import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { pathToFileURL } from "node:url";
import { type Browser, type BrowserContextOptions, type Page, chromium } from "playwright-core";

const EXECUTABLE = process.env["CHROMIUM"] ?? "/usr/bin/chromium";
const SOFTWARE_GL = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"];
const QUIET = [
  "--no-sandbox",
  "--no-first-run",
  "--disable-background-networking",
  "--disable-component-update",
  "--disable-sync",
  "--disable-quic",
];

export class Bench {
  private constructor(
    private readonly browser: Browser,
    private readonly folder: string,
  ) {}

  static async start(gl: readonly string[] = SOFTWARE_GL): Promise<Bench> {
    const browser = await chromium.launch({ executablePath: EXECUTABLE, headless: true, args: [...QUIET, ...gl] });
    return new Bench(browser, mkdtempSync(join(tmpdir(), "minute4d-page-")));
  }

  /** Closes every window: what plays in one slows down the next. */
  async clear(): Promise<void> {
    await Promise.all(this.browser.contexts().map((c) => c.close()));
  }

  async stop(): Promise<void> {
    await this.browser.close();
    rmSync(this.folder, { recursive: true });
  }

  /** A page as a file; the address. */
  file(name: string, html: string): string {
    const path = join(this.folder, name);
    writeFileSync(path, html);
    return pathToFileURL(path).href;
  }

  /** Opens an address in a window of its own; collects what goes wrong and what is asked of the network. */
  async open(url: string, options: BrowserContextOptions = {}, prepare?: (page: Page) => Promise<void>): Promise<Opened> {
    const context = await this.browser.newContext({
      viewport: { width: 320, height: 180 },
      reducedMotion: "reduce",
      ...options,
    });
    const page = await context.newPage();
    await prepare?.(page);
    const requests: string[] = [];
    const errors: string[] = [];
    page.on("request", (r) => {
      if (!/^(file|data|blob):/.test(r.url())) requests.push(r.url());
    });
    page.on("pageerror", (e) => errors.push(e.message));
    page.on("console", (m) => {
      if (m.type() === "error") errors.push(m.text());
    });
    await page.goto(url);
    return { page, requests, errors };
  }
}

export interface Opened {
  page: Page;
  requests: string[];
  errors: string[];
}

/** Waits for the scene. */
export async function ready(page: Page): Promise<void> {
  await page.evaluate(() => window.minute4d.ready);
}
