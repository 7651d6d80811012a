/**
 * How much of a dynamic splat's opacity is left at a distance from the middle of its life (Minute4D Eq. 1): the one
 * place where the page has the temporal window, for the worker and for the shaders.
 */

/** A splat with less of its opacity left at an instant is not there (as the renderer of the training). */
export const MARGINAL_MIN = 0.05;

/** Where the window falls to that, standard deviations. */
export const REACH_SDS = Math.sqrt(-2 * Math.log(MARGINAL_MIN));

/** The window at `dt` frames from the middle, for a standard deviation of `sd` frames. */
export function marginal(dt: number, sd: number): number {
  return Math.exp((-0.5 * (dt * dt)) / (sd * sd));
}

/** GLSL of [marginal] for two floats. */
export function marginalGlsl(dt: string, sd: string): string {
  const r = `((${dt}) / (${sd}))`;
  return `exp(-0.5 * (${r} * ${r}))`;
}
