/** Columns of splats as float textures, every value at full precision. */

import { DataTexture, FloatType, NearestFilter, RGBAFormat } from "three";
import { PageError } from "../errors";
import { type SceneData, splatCount } from "../scene";

/** Texels in a row, a power of two that every WebGL2 device has. */
export const ROW_BITS = 11;
const ROW = 1 << ROW_BITS;

export interface SplatTextures {
  /** A texel a splat: mean, opacity. */
  readonly place: DataTexture;
  /** Two texels a splat: scale and the third velocity; quaternion `x, y, z, w`. */
  readonly shape: DataTexture;
  /** A texel a dynamic splat: middle and standard deviation in time, first two velocities. */
  readonly life: DataTexture;
  /** `texels` texels a splat: the colour coefficients in their order. */
  readonly colour: DataTexture;
  /** Colour texels a splat. */
  readonly texels: number;
}

/** GLSL that fetches texel `i` of a texture of this module. */
export const fetchTexel = (texture: string, i: string): string =>
  `texelFetch(${texture}, ivec2((${i}) & ${ROW - 1}, (${i}) >> ${ROW_BITS}), 0)`;

function texture(name: string, texels: number, mostRows: number, fill: (out: Float32Array) => void): DataTexture {
  const rows = Math.max(1, Math.ceil(texels / ROW));
  if (rows > mostRows) {
    throw new PageError(
      "This scene is too large for this device",
      `Its ${name} need ${rows} rows of a texture and the graphics driver has ${mostRows}. Export the scene with fewer splats.`,
    );
  }
  const data = new Float32Array(4 * ROW * rows);
  fill(data);
  const out = new DataTexture(data, ROW, rows, RGBAFormat, FloatType);
  out.minFilter = NearestFilter;
  out.magFilter = NearestFilter;
  out.generateMipmaps = false;
  out.needsUpdate = true;
  // the device has it then; a context that is lost is a page that is loaded again
  out.onUpdate = () => {
    out.image.data = null;
  };
  return out;
}

/** Uploads happen at first use. `mostRows` is the device's largest texture. */
export function splatTextures(data: SceneData, terms: number, mostRows: number): SplatTextures {
  const n = splatCount(data);
  const { mean, scale, quat, opacity, colour, timeMean, timeSd, velocity, nStatic, nDynamic } = data;
  const v = (column: Float32Array, i: number): number => column[i] ?? 0;
  const texels = Math.ceil((3 * terms) / 4);
  return {
    texels,
    place: texture("places", n, mostRows, (out) => {
      for (let i = 0; i < n; i++) {
        for (let k = 0; k < 3; k++) out[4 * i + k] = v(mean, 3 * i + k);
        out[4 * i + 3] = v(opacity, i);
      }
    }),
    shape: texture("shapes", 2 * n, mostRows, (out) => {
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
    life: texture("lives", nDynamic, mostRows, (out) => {
      for (let d = 0; d < nDynamic; d++) {
        out[4 * d] = v(timeMean, d);
        out[4 * d + 1] = v(timeSd, d);
        out[4 * d + 2] = v(velocity, 3 * d);
        out[4 * d + 3] = v(velocity, 3 * d + 1);
      }
    }),
    colour: texture("colours", texels * n, mostRows, (out) => {
      const length = 3 * terms;
      for (let i = 0; i < n; i++) {
        for (let k = 0; k < length; k++) out[4 * texels * i + k] = v(colour, length * i + k);
      }
    }),
  };
}

export function disposeTextures(textures: SplatTextures): void {
  for (const t of [textures.place, textures.shape, textures.life, textures.colour]) t.dispose();
}
