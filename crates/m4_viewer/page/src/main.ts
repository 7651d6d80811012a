/** Starts the page: reads what it carries, shows it, and hands it to the user. */

import "./style.css";
import { pageApi } from "./api";
import { App } from "./app";
import { breath } from "./bytes";
import { embeddedFrames, embeddedManifest, embeddedScene } from "./embedded";
import { PageError, toPageError } from "./errors";
import { SourceFrames } from "./frames";
import { isSlider, startFlying, startPointer } from "./input";
import { fromFragment } from "./link";
import { Follower } from "./live/follow";
import { LivePanel } from "./live/panel";
import { Stage } from "./render/stage";
import type { Manifest } from "./scene";
import { Actions } from "./ui/actions";
import { Compare } from "./ui/compare";
import { showMessage, showProgress, uncover } from "./ui/cover";
import { Dock } from "./ui/dock";
import { control, find } from "./ui/dom";
import { Help } from "./ui/help";
import { Idle } from "./ui/idle";
import { startLayout } from "./ui/layout";
import { hint, toast } from "./ui/notices";
import { Popovers } from "./ui/popovers";
import { startScrubThumb } from "./ui/scrub-thumb";
import { startTips } from "./ui/tips";
import { startTheme } from "./ui/theme";

const OUTSIDE = "Outside of what was filmed: the scene is a guess from here";

function title(manifest: Manifest): void {
  document.title = `${manifest.title} · minute4d`;
  const splats = manifest.splats.static + manifest.splats.dynamic;
  find(HTMLElement, ".title h1").textContent = manifest.title;
  find(HTMLElement, ".title p").textContent = splats > 0 ? `${splats.toLocaleString("en")} splats` : "";
}

/** The input frames come after the scene: nothing waits for them. */
async function addFrames(app: App, manifest: Manifest): Promise<void> {
  const side = control(HTMLButtonElement, "side");
  const bytes = await embeddedFrames(manifest);
  if (!bytes || !manifest.frames) return;
  const frames = new SourceFrames(manifest.frames, bytes);
  side.hidden = false;
  new Compare(app, frames);
  startScrubThumb(app, frames);
}

async function start(): Promise<App> {
  startTheme();
  startLayout(() => undefined);
  const root = find(HTMLElement, "#app");
  const manifest = embeddedManifest();
  title(manifest);

  const calm = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  let invalidate = (): void => undefined;
  const stage = new Stage(
    find(HTMLCanvasElement, "#view"),
    () => invalidate(),
    () =>
      showMessage(
        new PageError(
          "The graphics driver took the picture away",
          "That happens when the device sleeps or runs out of memory. Reload to go on; close other pages if it happens again.",
        ),
      ),
  );
  const app = new App(manifest, stage, calm);
  invalidate = app.invalidate;

  const data = await embeddedScene(manifest, showProgress);
  if (data) {
    showProgress(0.85, "Preparing");
    await breath();
    app.stage.load(manifest, data);
    showProgress(0.95, "Sorting");
    const place = fromFragment(location.hash);
    if (place) app.go(place);
    await app.settle();
  }

  const popovers = new Popovers();
  const help = new Help();
  const actions = new Actions(app, root, help, popovers);
  const dock = new Dock(app, actions);
  const idle = new Idle(root, () => app.moving && !actions.open);
  startPointer(stage.canvas, app, () => {
    if (idle.idle) idle.wake();
    else if (app.moving) root.classList.add("idle");
  });
  startFlying(app, () => !actions.busy && !isSlider(document.activeElement));
  startTips(root);
  new ResizeObserver(app.invalidate).observe(stage.canvas);
  app.onChange(() => hint(!data && app.stage.active === 0 ? "Waiting for the first splats" : (app.view?.fade ?? 0) > 0.05 ? OUTSIDE : null));

  control(HTMLElement, "side").hidden = true;
  addFrames(app, manifest).catch((error: unknown) => toast(toPageError(error).title));
  if (manifest.live) {
    const panel = new LivePanel();
    if (!data) panel.show();
    new Follower(app, manifest.live, panel, () => title(app.manifest));
  }

  find(HTMLElement, ".dock").hidden = false;
  dock.refresh();
  uncover();
  if (!calm && !fromFragment(location.hash) && data) app.togglePlay();
  app.invalidate();
  return app;
}

function fail(error: unknown): void {
  showMessage(toPageError(error));
}

const started = start();
started.catch(fail);
window.addEventListener("unhandledrejection", (event) => fail(event.reason));
window.minute4d = pageApi(started);
