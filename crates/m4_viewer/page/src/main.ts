/** Starts the page: reads what it carries, shows it, and hands it to the user. */

import "./style/base.css";
import "./style/overlays.css";
import "./style/bars.css";
import "./style/wishes.css";
import { pageApi } from "./api";
import { App } from "./app";
import { embeddedFrames, embeddedManifest, embeddedSplats } from "./embedded";
import { PageError, toPageError } from "./errors";
import { SourceFrames } from "./frames";
import { isSlider, startFlying, startPointer } from "./input";
import { offerHeadset } from "./headset/session";
import { type Place, fromFragment } from "./link";
import { Follower } from "./live/follow";
import { LivePanel } from "./live/panel";
import { Stage } from "./render/stage";
import type { Manifest } from "./scene";
import { Actions } from "./ui/actions";
import { Compare } from "./ui/compare";
import { dropPoster, showMessage, showProgress, uncover } from "./ui/cover";
import { Dock } from "./ui/dock";
import { control, find } from "./ui/dom";
import { Help } from "./ui/help";
import { Idle } from "./ui/idle";
import { startLayout } from "./ui/layout";
import { Meter } from "./ui/meter";
import { hint, toast } from "./ui/notices";
import { Popovers } from "./ui/popovers";
import { startScrubThumb } from "./ui/scrub-thumb";
import { startTips } from "./ui/tips";
import { startTheme } from "./ui/theme";

const FADE_TOLD = 0.05;
const OUTSIDE = "Outside the filmed region: the scene is a guess from here";

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

/** The scene in the page onto the stage; false where there is none yet. */
async function fill(app: App, place: Place | null): Promise<boolean> {
  const packed = await embeddedSplats(app.manifest, (share, doing) => showProgress(0.3 * share, doing));
  if (!packed) return false;
  await app.stage.load(app.manifest, packed, (share, doing) => showProgress(0.3 + 0.65 * share, doing));
  showProgress(0.95, "Drawing");
  if (place) app.go(place);
  await app.settle();
  return true;
}

/** What is said over the image. */
function wordsFor(app: App): string | null {
  if (app.manifest.live && app.stage.active === 0) return "Waiting for the first splats";
  return app.caution ?? ((app.view?.fade ?? 0) > FADE_TOLD ? OUTSIDE : null);
}

async function start(): Promise<App> {
  startTheme();
  startLayout(() => undefined);
  const root = find(HTMLElement, "#app");
  const manifest = embeddedManifest();
  title(manifest);

  const calm = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  let invalidate = (): void => undefined;
  const stage = new Stage(find(HTMLCanvasElement, "#view"), {
    onReady: () => invalidate(),
    onLost: () =>
      showMessage(
        new PageError(
          "The graphics context was lost",
          "This happens when the device sleeps or runs out of memory. Reload to continue; close other pages if it happens again.",
        ),
      ),
    onFailure: showMessage,
  });
  const app = new App(manifest, stage, calm);
  invalidate = app.invalidate;

  const place = fromFragment(location.hash);
  // the poster shows the beginning
  if (place) dropPoster();
  const filled = await fill(app, place);

  const popovers = new Popovers();
  const help = new Help();
  const actions = new Actions(app, root, help, popovers, new Meter(app));
  const dock = new Dock(app, actions);
  const idle = new Idle(root, () => app.moving && !actions.open);
  startPointer(stage.canvas, app, {
    hidden: () => idle.idle,
    tap: (wasHidden) => {
      if (!wasHidden && app.moving) idle.hide();
    },
  });
  startFlying(app, () => !actions.busy && !isSlider(document.activeElement));
  startTips(root);
  void offerHeadset(app);
  new ResizeObserver(app.invalidate).observe(stage.canvas);
  app.onChange(() => {
    const words = wordsFor(app);
    hint(words, words !== null && words === app.caution);
  });

  control(HTMLElement, "side").hidden = true;
  addFrames(app, manifest).catch((error: unknown) => toast(toPageError(error).title));
  if (manifest.live) {
    const panel = new LivePanel();
    if (!filled) panel.show();
    new Follower(app, manifest.live, panel, () => title(app.manifest));
  }

  find(HTMLElement, ".dock").hidden = false;
  dock.refresh();
  uncover();
  if (!calm && !place && filled) app.togglePlay();
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
