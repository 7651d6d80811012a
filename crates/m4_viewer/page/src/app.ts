/** The viewer: time, camera and image together, and what can be done with them. */

import type { Lens } from "./camera/path";
import { DistanceLimit } from "./camera/limit";
import { SourcePath } from "./camera/path";
import { CameraRig, type Mode } from "./camera/rig";
import { SafeRegion } from "./camera/safe";
import { fitLens } from "./camera/view";
import { Clock, type Repeat } from "./clock";
import type { Place } from "./link";
import { type Pose, matrixOf } from "./maths";
import type { Stage } from "./render/stage";
import type { View } from "./render/view";
import type { Manifest } from "./scene";

/** Longest step of time that is taken at once, seconds: a page that was hidden goes on where it was. */
const STEP_MOST_S = 1;
/** The same for a camera that moves: its way is made of short steps. */
const CAMERA_STEP_MOST_S = 0.1;
const PIXEL_RATIO_MOST = 2;
/**
 * While something moves a fine screen is drawn more coarsely if drawing takes longer than this, milliseconds;
 * never more coarsely than a pixel of the window.
 */
const SLOW_MS = 150;
const FAST_MS = 40;
const QUALITIES = [1, 0.75, 0.5] as const;
/** Images that are looked at before the size changes. */
const IMAGES_TO_JUDGE = 8;
/** A drag counts as movement until nothing came for so long, milliseconds. */
const HANDS_OFF_MS = 160;
const REPEATS: readonly Repeat[] = ["loop", "swing", "once"];

/** A camera that was set from outside and stays until the user moves. */
interface Fixed {
  readonly pose: Pose;
  readonly lens: Omit<Lens, "width" | "height">;
}

export class App {
  clock: Clock;
  rig: CameraRig;
  frozen = false;
  comparing = false;
  /** A headset shows the scene and takes its time from the clock; the page rests. */
  worn = false;
  private fixed: Fixed | null = null;
  private requested = 0;
  private last = Number.NEGATIVE_INFINITY;
  private quality = 0;
  private touched = Number.NEGATIVE_INFINITY;
  private finish = 0;
  private readonly listeners: (() => void)[] = [];

  constructor(
    public manifest: Manifest,
    readonly stage: Stage,
    /** The user asked for less motion. */
    readonly calm: boolean,
  ) {
    this.clock = clockOf(manifest);
    this.rig = rigOf(manifest, !calm);
  }

  /** Calls back after every image and every change. */
  onChange(listener: () => void): void {
    this.listeners.push(listener);
  }

  private changed(): void {
    for (const listener of this.listeners) listener();
  }

  /** Draws at the next opportunity. */
  invalidate = (): void => {
    if (this.requested === 0) this.requested = requestAnimationFrame((now) => this.tick(now));
  };

  /** Another scene under the same camera and time, from its payload. */
  async replace(manifest: Manifest, bytes: Uint8Array<ArrayBuffer>): Promise<void> {
    await this.stage.load(manifest, bytes, () => undefined);
    const [clock, rig] = [this.clock, this.rig];
    this.manifest = { ...manifest, frames: manifest.frames ?? this.manifest.frames, live: this.manifest.live };
    this.clock = clockOf(manifest);
    this.clock.time = clock.time;
    this.clock.speed = clock.speed;
    this.clock.repeat = clock.repeat;
    if (clock.playing) this.clock.play();
    this.rig = rigOf(manifest, !this.calm);
    this.rig.carry(rig);
    this.invalidate();
    this.changed();
  }

  // ---------------------------------------------------------------- time

  /** The image that is shown; none before the first one. */
  get view(): View | null {
    return this.stage.shown;
  }

  /** The time of the image that is shown, frames. The clock is ahead of it while something is drawn. */
  get time(): number {
    return this.view?.t ?? this.clock.time;
  }

  /** Stops at what is seen. */
  private pause(): void {
    if (this.clock.playing) {
      this.stage.hold();
      this.clock.time = this.time;
    }
    this.clock.pause();
  }

  togglePlay(): void {
    if (this.clock.playing) this.pause();
    else {
      this.frozen = false;
      if (this.rig.swinging) this.rig.free("orbit", this.clock.time);
      this.clock.play();
    }
    this.moved();
  }

  seek(t: number): void {
    this.clock.time = t;
    this.moved();
  }

  step(frames: number): void {
    this.pause();
    this.clock.step(frames);
    this.moved();
  }

  setSpeed(speed: number): void {
    this.clock.speed = speed;
    this.moved();
  }

  cycleRepeat(): Repeat {
    const next = REPEATS[(REPEATS.indexOf(this.clock.repeat) + 1) % REPEATS.length] ?? "loop";
    this.clock.repeat = next;
    this.moved();
    return next;
  }

  /** Bullet time: time stops and the camera swings; again, and all goes on as before. */
  toggleFreeze(): void {
    this.frozen = !this.frozen;
    this.fixed = null;
    if (this.frozen) {
      this.pause();
      this.rig.startSwing(this.clock.time);
    } else {
      this.rig.ride(this.clock.time);
      this.clock.play();
    }
    this.moved();
  }

  // ---------------------------------------------------------------- camera

  setMode(mode: Mode): void {
    this.fixed = null;
    if (mode === "ride") this.rig.ride(this.clock.time);
    else this.rig.free(mode, this.clock.time);
    this.moved();
  }

  /** Hands the camera to the user. */
  touch(move: (rig: CameraRig, t: number) => void): void {
    if (this.fixed) {
      this.rig.place(this.fixed.pose, this.clock.time);
      this.fixed = null;
    }
    move(this.rig, this.clock.time);
    this.touched = performance.now();
    // the last image of a drag is drawn in full
    window.clearTimeout(this.finish);
    this.finish = window.setTimeout(this.invalidate, HANDS_OFF_MS + 20);
    this.moved();
  }

  /** Why the camera is limited by moving parts, where it matters now. */
  get caution(): string | null {
    return this.fixed ? null : this.rig.caution(this.clock.time);
  }

  /** Lifts that limit for as long as the page is open; false where there is none. */
  turnFurther(): boolean {
    const { safe } = this.rig;
    if (!safe.limit || safe.lifted) return false;
    safe.lifted = true;
    this.moved();
    return true;
  }

  /** To the beginning, on the source camera. */
  reset(): void {
    this.fixed = null;
    this.frozen = false;
    this.clock.time = this.clock.start;
    this.clock.speed = 1;
    this.rig.ride(this.clock.time);
    this.moved();
  }

  /** Where to look from and when, as a link says. */
  go(place: Place): void {
    this.fixed = null;
    this.frozen = false;
    this.clock.pause();
    this.clock.time = place.t;
    if (place.pose) this.rig.place(place.pose, this.clock.time);
    else this.rig.ride(this.clock.time);
    this.moved();
  }

  get place(): Place {
    const t = this.clock.playing ? this.time : this.clock.time;
    return this.rig.mode === "ride" && !this.fixed ? { t } : { t, pose: this.pose };
  }

  /** A camera to the letter: no fitting, no limits. Intrinsics in pixels of the canvas. */
  fix(fixed: Fixed): void {
    this.fixed = fixed;
    this.clock.pause();
    this.moved();
  }

  private get pose(): Pose {
    return this.fixed?.pose ?? this.rig.at(this.clock.time);
  }

  /** Whether the camera is the source camera. */
  private get riding(): boolean {
    return this.rig.mode === "ride" && !this.fixed && !this.rig.gliding;
  }

  get moving(): boolean {
    return this.clock.playing || this.rig.swinging;
  }

  toggleCompare(): void {
    this.comparing = !this.comparing;
    this.moved();
  }

  private moved(): void {
    this.invalidate();
    this.changed();
  }

  // ---------------------------------------------------------------- image

  private tick(now: number): void {
    this.requested = 0;
    if (this.worn) return;
    // the first tick after a rest begins a step and takes none
    const passed = Number.isFinite(this.last) ? Math.max(now - this.last, 0) / 1000 : 0;
    const seconds = Math.min(passed, STEP_MOST_S);
    this.last = now;
    const presented = this.stage.present();
    const playing = this.clock.advance(seconds);
    const moving = this.rig.advance(Math.min(passed, CAMERA_STEP_MOST_S), this.clock.time) || playing;
    const handled = now - this.touched < HANDS_OFF_MS;
    if (presented && (moving || handled)) this.judge();
    this.stage.want(this.prepare(moving || handled ? (QUALITIES[this.quality] ?? 1) : 1));
    this.changed();
    if (moving || this.clock.playing) this.invalidate();
    else if (!handled) this.last = Number.NEGATIVE_INFINITY;
  }

  /** Chooses how large the image is drawn while it moves. */
  private judge(): void {
    const { timing } = this.stage;
    if (timing.count < IMAGES_TO_JUDGE) return;
    const { draw } = timing.cost;
    const before = this.quality;
    if (draw > SLOW_MS) this.quality = Math.min(before + 1, QUALITIES.length - 1);
    else if (draw < FAST_MS) this.quality = Math.max(before - 1, 0);
    if (this.quality !== before) timing.restart();
  }

  /** What is to be seen now, drawn at a share of full size. */
  private prepare(quality: number): View {
    const canvas = this.stage.canvas;
    const full = Math.min(window.devicePixelRatio || 1, PIXEL_RATIO_MOST);
    const ratio = Math.min(full, Math.max(1, full * quality));
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio));
    const height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    const t = this.clock.time;
    const source = this.rig.path.lens(t);
    const fitted = fitLens(source, width, height);
    const css = canvas.clientWidth / width;
    const placement = {
      x: fitted.placement.x * css,
      y: fitted.placement.y * css,
      width: fitted.placement.width * css,
      height: fitted.placement.height * css,
    };
    const { pose, riding } = this;
    const view = { t, pose, placement, riding };
    if (this.fixed) return { ...view, lens: { ...this.fixed.lens, width, height }, magnification: 1, fade: 0, frame: null };
    const fade = this.rig.mode === "ride" ? 0 : this.rig.safe.fade(pose.position, t);
    const magnification = fitted.lens.fx / source.fx;
    return { ...view, lens: fitted.lens, magnification, fade, frame: fitted.placement };
  }

  /** Draws what is to be seen now, in full size. */
  async settle(): Promise<void> {
    await this.stage.settle(this.prepare(1));
    this.changed();
  }

  /** The camera of the image that is shown: matrix and intrinsics in pixels of the canvas. */
  get camera(): { c2w: number[]; fx: number; fy: number; cx: number; cy: number } {
    const lens = this.view?.lens ?? this.rig.path.lens(this.clock.time);
    return { c2w: matrixOf(this.view?.pose ?? this.pose), fx: lens.fx, fy: lens.fy, cx: lens.cx, cy: lens.cy };
  }
}

function clockOf(manifest: Manifest): Clock {
  return new Clock(0, Math.max(manifest.time_frames - 1, 0), manifest.fps);
}

function rigOf(manifest: Manifest, lively: boolean): CameraRig {
  const path = new SourcePath(manifest.cameras);
  const limit = DistanceLimit.of(path, manifest.cameras, manifest.centre, manifest.fps);
  const safe = new SafeRegion(path, manifest.safe.radius, manifest.centre, limit);
  return new CameraRig(path, safe, manifest.centre, lively);
}
