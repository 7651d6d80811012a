/** `window.minute4d`: the page in the hands of tests and scripts. */

import type { App } from "./app";
import { poseOf } from "./maths";
import { theme } from "./ui/theme";

export interface PageState {
  /** Of the image that is shown, frames. */
  time: number;
  /** Where playback is, frames: ahead of the image by the time that drawing takes. */
  clock: number;
  playing: boolean;
  frozen: boolean;
  speed: number;
  repeat: string;
  mode: string;
  swinging: boolean;
  comparing: boolean;
  theme: string;
  /** Whether the controls are out of sight. */
  idle: boolean;
  /** As drawn last; intrinsics in pixels of the canvas. */
  camera: { c2w: number[]; fx: number; fy: number; cx: number; cy: number };
  /** 0..1: how much of the image is gone. */
  fade: number;
  /** Pixels of the canvas. */
  width: number;
  height: number;
  splats: number;
  /** Those that take part in the image. */
  active: number;
  /** Whether nothing newer is wanted than what is shown. */
  sorted: boolean;
  /** What the last instants cost, medians; how many come in a second. */
  instant: {
    /** Choosing the splats that can be seen, in the worker. */
    slice_ms: number;
    /** The order's way from the worker into graphics memory; nothing is read back from there. */
    readback_ms: number;
    /** Sorting them by depth, in the worker. */
    sort_ms: number;
    /** Until the graphics driver has done all of it. */
    draw_ms: number;
    per_second: number;
  };
}

export interface PageApi {
  /** When the scene is shown; rejects where it cannot be. */
  ready: Promise<void>;
  /** Stops and goes to a time, frames. */
  setTime(frames: number): void;
  /** A camera to the letter: 4x4 row-major camera to world, OpenCV axes; pixels of the canvas. */
  setCamera(c2w: readonly number[], fx: number, fy: number, cx: number, cy: number): void;
  /** When the image is that of the time and the camera that were set, in full size. */
  settle(): Promise<void>;
  state(): PageState;
  /** The settled image as a PNG, without controls. */
  capture(): Promise<string>;
}

declare global {
  interface Window {
    minute4d: PageApi;
  }
}

function instantOf({ stage: { timing } }: App): PageState["instant"] {
  const { slice, readback, sort, draw } = timing.cost;
  const perSecond = timing.rate(performance.now());
  return { slice_ms: slice, readback_ms: readback, sort_ms: sort, draw_ms: draw, per_second: perSecond };
}

/** The page's interface; `app` may come later, everything but `ready` needs it. */
export function pageApi(ready: Promise<App>): PageApi {
  let app: App | null = null;
  const done = ready.then((a) => {
    app = a;
  });
  // a failure is shown on the page; whoever waits for `ready` gets it too
  done.catch(() => undefined);
  const there = (): App => {
    if (!app) throw new Error("the scene is not loaded yet: wait for `minute4d.ready`");
    return app;
  };
  return {
    ready: done,
    setTime(frames) {
      there().clock.pause();
      there().seek(frames);
    },
    setCamera(c2w, fx, fy, cx, cy) {
      if (c2w.length !== 16 || ![...c2w, fx, fy, cx, cy].every(Number.isFinite)) {
        throw new RangeError("a camera is a row-major 4x4 matrix of finite numbers, fx, fy, cx, cy");
      }
      there().fix({ pose: poseOf(c2w), lens: { fx, fy, cx, cy } });
    },
    settle: () => there().settle(),
    async capture() {
      await there().settle();
      return there().stage.canvas.toDataURL("image/png");
    },
    state() {
      const a = there();
      const { canvas } = a.stage;
      return {
        time: a.time,
        clock: a.clock.time,
        playing: a.clock.playing,
        frozen: a.frozen,
        speed: a.clock.speed,
        repeat: a.clock.repeat,
        mode: a.rig.mode,
        swinging: a.rig.swinging,
        comparing: a.comparing,
        theme: theme(),
        idle: document.querySelector("#app")?.classList.contains("idle") ?? false,
        camera: a.camera,
        fade: a.view?.fade ?? 0,
        width: canvas.width,
        height: canvas.height,
        splats: a.manifest.splats.static + a.manifest.splats.dynamic,
        active: a.stage.active,
        sorted: a.stage.sorted,
        instant: instantOf(a),
      };
    },
  };
}
