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
  /** A texel a dynamic splat: middle (of a bound one: birth), standard deviation in time (trend of red), first two velocities. */
  readonly life: Float32Array<ArrayBuffer>;
  /** `ceil(3 terms / 4)` texels a splat: the colour coefficients in their order. */
  readonly colour: Float32Array<ArrayBuffer>;
  /** Two texels a bound splat: node in the texture of nodes + 65536 x weight in 255ths, four times; begin, end, trend of green, blue. */
  readonly bound: Float32Array<ArrayBuffer>;
}

/** Frames that are always past or to come: shaders need not know infinity. */
const FAR = 1e9;

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

/** `terms` colour coefficients a channel; `places` of the windows in the texture of nodes. */
export function texelsOf(data: SceneData, terms: number, places: readonly { readonly first: number }[]): Texels {
  const n = splatCount(data);
  const { mean, scale, quat, opacity, colour, bound, timeMean, timeSd, velocity, nStatic, nBound, nFree } = data;
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
        out[8 * i + 3] = d < 0 ? 0 : d < nBound ? v(bound.velocity, 3 * d + 2) : v(velocity, 3 * (d - nBound) + 2);
        out[8 * i + 7] = v(quat, 4 * i);
      }
    }),
    life: fill(nBound + nFree, (out) => {
      for (let i = 0; i < nBound; i++) {
        out[4 * i] = v(bound.birth, i);
        out[4 * i + 1] = v(bound.trend, 3 * i);
        out[4 * i + 2] = v(bound.velocity, 3 * i);
        out[4 * i + 3] = v(bound.velocity, 3 * i + 1);
      }
      for (let d = 0; d < nFree; d++) {
        const at = 4 * (nBound + d);
        out[at] = v(timeMean, d);
        out[at + 1] = v(timeSd, d);
        out[at + 2] = v(velocity, 3 * d);
        out[at + 3] = v(velocity, 3 * d + 1);
      }
    }),
    colour: fill(texels * n, (out) => {
      const length = 3 * terms;
      for (let i = 0; i < n; i++) {
        for (let k = 0; k < length; k++) out[4 * texels * i + k] = v(colour, length * i + k);
      }
    }),
    bound: fill(2 * nBound, (out) => {
      bound.windows.forEach(({ from, to }, w) => {
        const first = places[w]?.first ?? 0;
        for (let i = from; i < to; i++) {
          for (let k = 0; k < 4; k++) {
            out[8 * i + k] = first + (bound.nodes[4 * i + k] as number) + 65536 * (bound.weights[4 * i + k] as number);
          }
          for (let k = 0; k < 2; k++) {
            out[8 * i + 4 + k] = Math.min(Math.max(v(bound.life, 2 * i + k), -FAR), FAR);
            out[8 * i + 6 + k] = v(bound.trend, 3 * i + 1 + k);
          }
        }
      });
    }),
  };
}
