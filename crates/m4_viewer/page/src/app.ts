/** The viewer: time, camera and picture together, and what can be done with them. */

import type { Lens } from "./camera/path";
import { SourcePath } from "./camera/path";
import { CameraRig, type Mode } from "./camera/rig";
import { SafeRegion } from "./camera/safe";
import { type Fitted, fitLens } from "./camera/view";
import { Clock, type Repeat } from "./clock";
import type { Place } from "./link";
import { type Pose, matrixOf } from "./maths";
import type { Stage, View } from "./render/stage";
import type { Manifest, SceneData } from "./scene";

/** Longest step that is taken at once, seconds: a page that was hidden goes on where it was. */
const STEP_MOST_S = 0.1;
const PIXEL_RATIO_MOST = 2;
/** While something moves the picture is drawn smaller if it would come slower than this, milliseconds. */
const SLOW_MS = 48;
const FAST_MS = 24;
const QUALITIES = [1, 0.75, 0.5] as const;
const FRAMES_TO_JUDGE = 12;
/** A drag counts as movement until nothing came for so long, milliseconds. */
const HANDS_OFF_MS = 160;
const REPEATS: readonly Repeat[] = ["loop", "swing", "once"];

/** A camera that was set from outside and stays until somebody moves. */
interface Fixed {
  readonly pose: Pose;
  readonly lens: Omit<Lens, "width" | "height">;
}

export class App {
  clock: Clock;
  rig: CameraRig;
  frozen = false;
  comparing = false;
  /** What was drawn last. */
  view: View | null = null;
  placement: Fitted["placement"] = { x: 0, y: 0, width: 0, height: 0 };
  private fixed: Fixed | null = null;
  private requested = 0;
  private last = 0;
  private quality = 0;
  private paces: number[] = [];
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

  /** Calls back after every picture and every change. */
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

  /** Another scene under the same camera and time. */
  replace(manifest: Manifest, data: SceneData): void {
    const [clock, rig] = [this.clock, this.rig];
    this.stage.load(manifest, data);
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

  togglePlay(): void {
    if (this.clock.playing) this.clock.pause();
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
      this.clock.pause();
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
    // the last picture of a drag is drawn in full
    window.clearTimeout(this.finish);
    this.finish = window.setTimeout(this.invalidate, HANDS_OFF_MS + 20);
    this.moved();
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
    const t = this.clock.time;
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

  /** Whether the picture is that of the source camera, so that its frame fits over it. */
  get riding(): boolean {
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

  // ---------------------------------------------------------------- picture

  private tick(now: number): void {
    this.requested = 0;
    const pace = now - this.last;
    this.last = now;
    const seconds = Math.min(pace / 1000, STEP_MOST_S);
    const playing = this.clock.advance(seconds);
    const moving = this.rig.advance(seconds, this.clock.time) || playing;
    const handled = now - this.touched < HANDS_OFF_MS;
    if (moving || handled) this.judge(pace);
    else this.paces = [];
    this.draw(moving || handled ? (QUALITIES[this.quality] ?? 1) : 1);
    this.changed();
    if (moving || this.clock.playing) this.invalidate();
    else if (!handled) this.last = Number.NEGATIVE_INFINITY;
  }

  /** Chooses how large the picture is drawn while it moves. */
  private judge(pace: number): void {
    if (!Number.isFinite(pace) || pace > 1000) return;
    this.paces.push(pace);
    if (this.paces.length < FRAMES_TO_JUDGE) return;
    const middle = this.paces.toSorted((a, b) => a - b)[FRAMES_TO_JUDGE >> 1] ?? 0;
    this.paces = [];
    if (middle > SLOW_MS && this.quality < QUALITIES.length - 1) this.quality += 1;
    else if (middle < FAST_MS && this.quality > 0) this.quality -= 1;
  }

  private draw(quality: number): void {
    this.view = this.prepare(quality);
    this.stage.draw(this.view);
  }

  private prepare(quality: number): View {
    const canvas = this.stage.canvas;
    const ratio = Math.min(window.devicePixelRatio || 1, PIXEL_RATIO_MOST) * quality;
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio));
    const height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    this.stage.resize(width, height);
    return this.viewFor(width, height, canvas.clientWidth);
  }

  private viewFor(width: number, height: number, cssWidth: number): View {
    const t = this.clock.time;
    const source = this.rig.path.lens(t);
    const fitted = fitLens(source, width, height);
    const css = cssWidth / width;
    this.placement = {
      x: fitted.placement.x * css,
      y: fitted.placement.y * css,
      width: fitted.placement.width * css,
      height: fitted.placement.height * css,
    };
    const pose = this.pose;
    if (this.fixed) return { t, pose, lens: { ...this.fixed.lens, width, height }, magnification: 1, fade: 0, frame: null };
    const fade = this.rig.mode === "ride" ? 0 : this.rig.safe.fade(pose.position);
    const magnification = fitted.lens.fx / source.fx;
    return { t, pose, lens: fitted.lens, magnification, fade, frame: fitted.placement };
  }

  /** Draws everything there is to draw, in full size and in the right order. */
  async settle(): Promise<void> {
    this.view = this.prepare(1);
    await this.stage.settle(this.view);
    this.changed();
  }

  /** The camera as it is drawn: matrix and intrinsics in pixels of the canvas. */
  get camera(): { c2w: number[]; fx: number; fy: number; cx: number; cy: number } {
    const lens = this.view?.lens ?? this.rig.path.lens(this.clock.time);
    return { c2w: matrixOf(this.pose), fx: lens.fx, fy: lens.fy, cx: lens.cx, cy: lens.cy };
  }
}

function clockOf(manifest: Manifest): Clock {
  return new Clock(0, Math.max(manifest.time_frames - 1, 0), manifest.fps);
}

function rigOf(manifest: Manifest, lively: boolean): CameraRig {
  const path = new SourcePath(manifest.cameras);
  const safe = new SafeRegion(path, manifest.safe.radius, manifest.centre);
  return new CameraRig(path, safe, manifest.centre, lively);
}
