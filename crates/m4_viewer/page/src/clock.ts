/** The time that is shown: plays, repeats, stands still. Frames; pure, driven by `advance`. */

import { clamp } from "./maths";

/** What happens at the end. */
export type Repeat = "loop" | "swing" | "once";

export const SPEED_MIN = 0.1;
export const SPEED_MAX = 4;

export class Clock {
  private at: number;
  private forward = true;
  private rate = 1;
  repeat: Repeat = "loop";
  playing = false;

  constructor(
    /** First and last instant, frames. */
    readonly start: number,
    readonly end: number,
    /** Frames a second at speed 1. */
    readonly fps: number,
  ) {
    this.at = start;
  }

  /** Frames. */
  get time(): number {
    return this.at;
  }

  set time(t: number) {
    this.at = Number.isFinite(t) ? clamp(t, this.start, this.end) : this.start;
  }

  get speed(): number {
    return this.rate;
  }

  set speed(v: number) {
    this.rate = Number.isFinite(v) ? clamp(v, SPEED_MIN, SPEED_MAX) : 1;
  }

  get length(): number {
    return this.end - this.start;
  }

  /** Seconds since the start. */
  get seconds(): number {
    return (this.at - this.start) / this.fps;
  }

  /** Starts; from the start again where it had stopped at the end. */
  play(): void {
    if (this.repeat === "once" && this.at >= this.end) this.at = this.start;
    if (this.repeat !== "swing") this.forward = true;
    this.playing = this.length > 0;
  }

  pause(): void {
    this.playing = false;
  }

  /** Moves by whole frames, without wrapping, and stops. */
  step(frames: number): void {
    this.pause();
    this.time = Math.round(this.at) + frames;
  }

  /** Goes on for so many seconds of the real world; true when the time changed. */
  advance(seconds: number): boolean {
    if (!this.playing || !(seconds > 0)) return false;
    const before = this.at;
    const move = seconds * this.fps * this.rate;
    if (this.repeat === "swing") {
      // on a circle of twice the length: up, then down
      const position = this.forward ? this.at - this.start : 2 * this.length - (this.at - this.start);
      const next = (position + move) % (2 * this.length);
      this.forward = next < this.length;
      this.at = this.start + (this.forward ? next : 2 * this.length - next);
    } else if (this.repeat === "loop") {
      this.at = this.start + ((this.at - this.start + move) % this.length);
    } else {
      this.at = Math.min(this.at + move, this.end);
      if (this.at >= this.end) this.playing = false;
    }
    return this.at !== before;
  }
}

/** `m:ss.cc`. */
export function timecode(seconds: number): string {
  const hundredths = Math.max(0, Math.round(seconds * 100));
  const two = (v: number): string => String(v).padStart(2, "0");
  const minutes = Math.floor(hundredths / 6000);
  return `${minutes}:${two(Math.floor(hundredths / 100) % 60)}.${two(hundredths % 100)}`;
}
