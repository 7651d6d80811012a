/** Columns of splats as texels, every value at full precision. */

import { type SceneData, splatCount } from "../scene";

/** Texels in a row, a power of two that every WebGL2 device has. */
export const ROW_BITS = 11;
export const ROW = 1 << ROW_BITS;

/** Whole rows of RGBA texels of 32-bit floats. */
export interface Texels {
  /** A texel a splat: mean, opacity. */
  readonly place: Float32Array<ArrayBuffer>;
  /** Two texels a splat: scale and the third velocity; quaternion `x, y, z, w`. */
  readonly shape: Float32Array<ArrayBuffer>;
  /** A texel a dynamic splat: middle and standard deviation in time, first two velocities. */
  readonly life: Float32Array<ArrayBuffer>;
  /** `ceil(3 terms / 4)` texels a splat: the colour coefficients in their order. */
  readonly colour: Float32Array<ArrayBuffer>;
}

/** GLSL that fetches texel `i` of a texture of this module. */
export const fetchTexel = (texture: string, i: string): string =>
  `texelFetch(${texture}, ivec2((${i}) & ${ROW - 1}, (${i}) >> ${ROW_BITS}), 0)`;

/** Rows that so many texels take. */
export const rowsOf = (texels: number): number => Math.max(1, Math.ceil(texels / ROW));

/** Rows of the tallest texture of a scene. */
export function mostRows(splats: number, terms: number): number {
  return rowsOf(Math.max(2, Math.ceil((3 * terms) / 4)) * splats);
}

function fill(texels: number, write: (out: Float32Array) => void): Float32Array<ArrayBuffer> {
  const out = new Float32Array(4 * ROW * rowsOf(texels));
  write(out);
  return out;
}

/** `terms` colour coefficients a channel. */
export function texelsOf(data: SceneData, terms: number): Texels {
  const n = splatCount(data);
  const { mean, scale, quat, opacity, colour, timeMean, timeSd, velocity, nStatic, nDynamic } = data;
  const v = (column: Float32Array, i: number): number => column[i] ?? 0;
  const texels = Math.ceil((3 * terms) / 4);
  return {
    place: fill(n, (out) => {
      for (let i = 0; i < n; i++) {
        for (let k = 0; k < 3; k++) out[4 * i + k] = v(mean, 3 * i + k);
        out[4 * i + 3] = v(opacity, i);
      }
    }),
    shape: fill(2 * n, (out) => {
      for (let i = 0; i < n; i++) {
        const d = i - nStatic;
        for (let k = 0; k < 3; k++) {
          out[8 * i + k] = v(scale, 3 * i + k);
          out[8 * i + 4 + k] = v(quat, 4 * i + 1 + k);
        }
        out[8 * i + 3] = d >= 0 ? v(velocity, 3 * d + 2) : 0;
        out[8 * i + 7] = v(quat, 4 * i);
      }
    }),
    life: fill(nDynamic, (out) => {
      for (let d = 0; d < nDynamic; d++) {
        out[4 * d] = v(timeMean, d);
        out[4 * d + 1] = v(timeSd, d);
        out[4 * d + 2] = v(velocity, 3 * d);
        out[4 * d + 3] = v(velocity, 3 * d + 1);
      }
    }),
    colour: fill(texels * n, (out) => {
      const length = 3 * terms;
      for (let i = 0; i < n; i++) {
        for (let k = 0; k < length; k++) out[4 * texels * i + k] = v(colour, length * i + k);
      }
    }),
  };
}
