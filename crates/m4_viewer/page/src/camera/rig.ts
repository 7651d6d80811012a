/** The camera as the user has it: on the source path, swinging, turning about a point, or flying. */

import {
  type Pose,
  type Vec3,
  add,
  axis,
  clamp,
  distance,
  mixPose,
  norm,
  scale,
  smoothstep,
} from "../maths";
import { type Push, fliedVelocity } from "./fly";
import { nearer, pivotOf, shift, turned } from "./orbit";
import type { SourcePath } from "./path";
import type { SafeRegion } from "./safe";
import { REACH, swingAngle, swung } from "./swing";

export type Mode = "ride" | "orbit" | "fly";

const GLIDE_S = 0.7;
/** Seconds in which a turn that was let go of dies away. */
const COAST_S = 0.18;
/** Seconds in which a camera that is too far out for the moment is drawn back. */
const DRAW_S = 0.25;
/** So little beyond, as a factor, is not beyond. */
const DRAWN_WITHIN = 1.001;
/** Flying speed: this share of the distance to the middle of the scene, a second. */
const FLY_SHARE = 0.45;
/** What the camera turns about is at most this many times as far away as the middle of the scene is from its own camera. */
const MOST_DEPTHS = 1.5;
const STILL: Push = { right: 0, up: 0, ahead: 0, fast: false };

interface Swing {
  readonly base: Pose;
  readonly pivot: Vec3;
  readonly angle: number;
  seconds: number;
}

export class CameraRig {
  private current: Mode = "ride";
  private pose: Pose;
  private pivot: Vec3;
  private swing: Swing | null = null;
  private glide: { from: Pose; seconds: number } | null = null;
  private coast: [number, number] = [0, 0];
  private velocity: Vec3 = [0, 0, 0];
  /** The time of the last step, frames. */
  private time = 0;
  /** Being drawn back since the time changed. */
  private drawn = false;
  push: Push = STILL;

  constructor(
    readonly path: SourcePath,
    readonly safe: SafeRegion,
    private readonly centre: Vec3,
    /** False where the user asked for less motion: no swing, no gliding, no coasting. */
    public lively: boolean,
  ) {
    this.pose = path.pose(0);
    this.pivot = this.ahead(this.pose);
  }

  /** What a camera turns about. */
  private ahead(pose: Pose): Vec3 {
    return pivotOf(pose, this.centre, MOST_DEPTHS * this.path.depth(this.centre));
  }

  get mode(): Mode {
    return this.current;
  }

  get swinging(): boolean {
    return this.swing !== null;
  }

  /** Whether it is on its way back to the source path. */
  get gliding(): boolean {
    return this.glide !== null;
  }

  /** The camera at a time. */
  at(t: number): Pose {
    const target = this.current === "ride" ? this.path.pose(t) : this.pose;
    if (!this.glide) return target;
    return mixPose(this.glide.from, target, smoothstep(0, GLIDE_S, this.glide.seconds));
  }

  /** Back to the source camera. */
  ride(t: number): void {
    if (this.current !== "ride") this.glideFrom(this.at(t));
    this.current = "ride";
    this.swing = null;
    this.still();
  }

  /** Takes the camera as it stands at `t` into the user's hands. */
  free(mode: "orbit" | "fly", t: number): void {
    if (this.current === mode && !this.swing && !this.glide) return;
    const pose = this.at(t);
    // a swing keeps its pivot; anything else looks for a new one
    const pivot = this.swing ? this.swing.pivot : this.ahead(pose);
    this.glide = null;
    this.swing = null;
    this.current = mode;
    this.pose = pose;
    this.pivot = pivot;
    this.time = t;
    this.still();
  }

  /** Begins to swing about what the camera looks at. */
  startSwing(t: number): void {
    this.free("orbit", t);
    if (!this.lively) return;
    const angle = swingAngle(this.pose, this.pivot, this.safe.radiusAt(t));
    this.swing = { base: this.pose, pivot: this.pivot, angle, seconds: 0 };
  }

  /** Puts the camera somewhere. */
  place(pose: Pose, t: number): void {
    this.free("orbit", t);
    this.time = t;
    this.pose = pose;
    this.pivot = this.ahead(pose);
  }

  /** Takes over where another rig was, when a new scene comes in. */
  carry(other: CameraRig): void {
    this.current = other.current;
    this.pose = other.pose;
    this.pivot = other.pivot;
    this.swing = other.swing;
    this.push = other.push;
    this.time = other.time;
    this.safe.lifted = other.safe.lifted;
  }

  /** A drag by so many radians; orbits, or looks around while flying. */
  turn(yaw: number, pitch: number, t: number): void {
    if (this.current === "ride" || this.swing) this.free("orbit", t);
    this.coast = [0, 0];
    this.turnBy(yaw, pitch, t);
  }

  /** Lets a turn go at this speed, radians a second. */
  release(yaw: number, pitch: number): void {
    if (this.lively && this.current === "orbit") this.coast = [yaw, pitch];
  }

  /** How far the camera can turn about its pivot to one side until it stops, radians. */
  turnRoom(t: number): number {
    const arm = distance(this.pose.position, this.pivot);
    return arm > 0 ? 2 * Math.asin(clamp(this.safe.stopAt(t) / (2 * arm), 0, 1)) : Math.PI;
  }

  /** Why the camera cannot leave the source camera further, if moving parts are the reason and it matters now. */
  caution(t: number): string | null {
    const { safe } = this;
    if (this.current === "ride" || !safe.limit) return null;
    if (this.swing && safe.limitAt(t) < safe.radius) return safe.limit.words(t);
    return safe.caution(this.pose.position, t);
  }

  /** Nearer (below 1) or further (above 1). */
  zoom(factor: number, t: number): void {
    if (this.current === "ride" || this.swing) this.free("orbit", t);
    const from = this.pose;
    if (this.current === "fly") {
      const step = scale(axis(from, 2), (1 - factor) * distance(from.position, this.centre));
      this.pose = { ...from, position: this.safe.hold(from.position, add(from.position, step), t) };
      return;
    }
    const way = (share: number): Pose => nearer(from, this.pivot, 1 + (factor - 1) * share);
    this.pose = way(this.safe.furthest(from.position, (s) => way(s).position, t));
  }

  /** Shifts by a share of the focal length, in the plane of the image. */
  pan(right: number, down: number, t: number): void {
    if (this.current === "ride" || this.swing) this.free("orbit", t);
    const arm = distance(this.pose.position, this.pivot);
    const move = shift(this.pose, -right * arm, -down * arm);
    const from = this.pose.position;
    const share = this.safe.furthest(from, (s) => add(from, scale(move, s)), t);
    this.pose = { ...this.pose, position: add(from, scale(move, share)) };
    this.pivot = add(this.pivot, scale(move, share));
  }

  /** Goes on for so many seconds; true while something moves by itself. */
  advance(seconds: number, t: number): boolean {
    let moving = this.drawBack(seconds, t);
    if (this.glide) {
      this.glide.seconds += seconds;
      if (this.glide.seconds >= GLIDE_S) this.glide = null;
      moving = true;
    }
    if (this.swing) {
      this.swing.seconds += seconds;
      this.pose = swung(this.swing.base, this.swing.pivot, this.path.up, this.swing.angle, this.swing.seconds);
      return true;
    }
    if (Math.hypot(...this.coast) > 1e-3) {
      this.turnBy(this.coast[0] * seconds, this.coast[1] * seconds, t);
      const left = Math.exp(-seconds / COAST_S);
      this.coast = [this.coast[0] * left, this.coast[1] * left];
      moving = true;
    }
    const pushed = this.push.right !== 0 || this.push.up !== 0 || this.push.ahead !== 0;
    if (pushed && this.current !== "fly") this.free("fly", t);
    if (this.current === "fly") {
      const reach = FLY_SHARE * Math.max(distance(this.pose.position, this.centre), this.safe.radius);
      this.velocity = fliedVelocity(this.velocity, this.pose, this.path.up, this.push, reach, seconds);
      if (norm(this.velocity) > 1e-3 * reach) {
        const to = add(this.pose.position, scale(this.velocity, seconds));
        this.pose = { ...this.pose, position: this.safe.hold(this.pose.position, to, t) };
        moving = true;
      }
    }
    return moving || pushed;
  }

  /**
   * Keeps a camera in hands within what moving parts allow while time passes: it goes along with the source camera
   * where it is at that limit, and comes back gently where it is beyond. True while it does.
   */
  private drawBack(seconds: number, t: number): boolean {
    const before = this.time;
    this.time = t;
    this.drawn ||= t !== before;
    // a swing needs its own room
    const room = (at: number): number => this.safe.limitAt(at) * (this.swing ? 1 - REACH : 1);
    if (this.current === "ride" || !this.drawn || room(t) === Infinity) {
      this.drawn = false;
      return false;
    }
    const pose = this.swing?.base ?? this.pose;
    const [source, last] = [this.path.pose(t), this.path.pose(before).position];
    const far = distance(pose.position, source.position);
    // after a cut, as from the end to the start, all of the way is left; else what was left before
    const step = distance(last, source.position) + Math.abs(room(before) - room(t));
    const isCut = step > seconds * distance(source.position, this.centre);
    const beyond = Math.max(isCut ? far - room(t) : distance(pose.position, last) - room(before), 0);
    const allowed = room(t) + (this.lively ? beyond * Math.exp(-seconds / DRAW_S) : 0);
    if (far > allowed) {
      const back = mixPose(pose, source, 1 - allowed / far);
      // who flies looks where they like
      const next = this.current === "fly" ? { ...pose, position: back.position } : back;
      const pivot = this.ahead(next);
      if (this.swing) {
        const angle = swingAngle(next, pivot, this.safe.radiusAt(t));
        this.swing = { ...this.swing, base: next, pivot, angle };
      } else {
        [this.pose, this.pivot] = [next, pivot];
      }
    }
    this.drawn = far > DRAWN_WITHIN * room(t);
    return this.drawn;
  }

  private still(): void {
    this.drawn = false;
    this.coast = [0, 0];
    this.velocity = [0, 0, 0];
  }

  private glideFrom(pose: Pose): void {
    this.glide = this.lively ? { from: pose, seconds: 0 } : null;
  }

  private turnBy(yaw: number, pitch: number, t: number): void {
    const from = this.pose;
    if (this.current === "fly") {
      const seen = turned(from, from.position, this.path.up, -yaw, -pitch);
      this.pose = { ...from, rotation: seen.rotation };
      return;
    }
    const way = (share: number): Pose => turned(from, this.pivot, this.path.up, yaw * share, pitch * share);
    this.pose = way(this.safe.furthest(from.position, (s) => way(s).position, t));
  }
}
