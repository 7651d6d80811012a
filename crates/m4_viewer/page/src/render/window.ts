/**
 * How much of a dynamic splat's opacity is left at a distance from the middle of its life: the one place where
 * the page has the temporal window, for the worker and for the shaders.
 */

import type { TimeWindow } from "../scene";

/** A splat with less of its opacity left at an instant is not there (as the renderer of the training). */
export const MARGINAL_MIN = 0.05;

/** The window at `dt` frames from the middle, for a standard deviation of `sd` frames. */
export function marginal(window: TimeWindow, dt: number, sd: number): number {
  const q = (dt * dt) / (sd * sd);
  return Math.exp(-0.5 * (window === "flat" ? q * q : q));
}

/** Where the window falls to [MARGINAL_MIN], standard deviations. */
export function reachSds(window: TimeWindow): number {
  const q = Math.sqrt(-2 * Math.log(MARGINAL_MIN));
  return window === "flat" ? Math.sqrt(q) : q;
}

/** GLSL of [marginal] for two floats. */
export function marginalGlsl(window: TimeWindow, dt: string, sd: string): string {
  const r = `((${dt}) / (${sd}))`;
  const q = `(${r} * ${r})`;
  return window === "flat" ? `exp(-0.5 * ${q} * ${q})` : `exp(-0.5 * ${q})`;
}
