/**
 * The scene as it arrives: what the manifest says, and the splats in columns.
 *
 * Lengths are world units, times are frames, colours are sRGB values in 0..1, pixels count from the
 * corner of the image. Camera axes are those of OpenCV: x right, y down, z forward.
 */

/** A camera of the source clip. */
export interface SourceCamera {
  /** When it was there, frames. */
  t: number;
  /** Camera to world, 4x4, row-major. */
  c2w: number[];
  fx: number;
  fy: number;
  cx: number;
  cy: number;
  width: number;
  height: number;
}

/** The frames of the source clip as JPEGs, one a source camera, in one run of bytes. */
export interface FrameIndex {
  width: number;
  height: number;
  /** Where each begins; one more than there are frames. */
  offsets: number[];
}

/** Where a training run can be followed. */
export interface LiveSource {
  /** Of an event stream. */
  events: string;
  /** Of the newest scene. */
  scene: string;
  token: string;
}

/** What is known of a scene besides its splats. */
export interface Manifest {
  version: 1;
  title: string;
  splats: {
    static: number;
    dynamic: number;
    /** Degree of the spatial harmonics, 0..=3. */
    sh_degree: number;
    /** Highest temporal harmonic, 0..=2. */
    time_degree: number;
    isotropic: boolean;
    bytes: number;
  };
  background: [number, number, number];
  time_frames: number;
  duration_s: number | null;
  fps: number;
  /** Whether the scene was trained with the Mip filter. */
  mip: boolean;
  near: number;
  /** Period of the first temporal harmonic, frames. */
  period_frames: number;
  cameras: SourceCamera[];
  centre: [number, number, number];
  safe: { radius: number };
  frames: FrameIndex | null;
  live: LiveSource | null;
}

/** Splats in columns, the static ones first. */
export interface SceneData {
  nStatic: number;
  nDynamic: number;
  /** `3n`: x, y, z; of a dynamic splat at `timeMean`. */
  mean: Float32Array;
  /** `3n`: standard deviations. */
  scale: Float32Array;
  /** `4n`: unit quaternions `w, x, y, z`. */
  quat: Float32Array;
  /** `n`: 0..1, at the peak in time. */
  opacity: Float32Array;
  /** `3 terms n`: index `splat * 3 * terms + 3 * term + channel`, temporal index of a term major. */
  colour: Float32Array;
  /** `nDynamic`: middle of the life, frames. */
  timeMean: Float32Array;
  /** `nDynamic`: standard deviation in time, frames. */
  timeSd: Float32Array;
  /** `3 nDynamic`: world units a frame. */
  velocity: Float32Array;
}

/** Spatial harmonics a colour channel. */
export function shTerms(manifest: Manifest): number {
  return (manifest.splats.sh_degree + 1) ** 2;
}

/** Colour coefficients a channel. */
export function colourTerms(manifest: Manifest): number {
  return shTerms(manifest) * (manifest.splats.time_degree + 1);
}

/** How many splats a scene has. */
export function splatCount(data: SceneData): number {
  return data.nStatic + data.nDynamic;
}
