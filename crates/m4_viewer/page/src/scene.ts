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
  /** Relative standard deviation of the distance of the frame's dynamic objects, where known. */
  distance_sigma?: number;
}

/** The frames of the source clip, one a source camera, as H.264 in a byte stream (Annex B). */
export interface FrameIndex {
  width: number;
  height: number;
  /** Profile and level, as `VideoDecoder` is asked for them. */
  codec: string;
  /** Frames from one at which decoding can begin to the next; the first is one. */
  key_every: number;
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
  version: 2;
  title: string;
  splats: {
    static: number;
    dynamic: number;
    /** Of the dynamic ones. */
    bound: number;
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

/** Nodes and their motion over a span of time; which splats they carry. */
export interface MotionWindow {
  /** Bound splats `from..to`. */
  from: number;
  to: number;
  /** Frames, rising; at least one. */
  keys: Float32Array;
  /** `3 nodes`: where nodes are when they have not moved. */
  anchors: Float32Array;
  /** `3 nodes` a key. */
  positions: Float32Array;
  /** `4 nodes` a key: unit quaternions `w, x, y, z`. */
  rotations: Float32Array;
}

/** What bound splats have beside what all have, in the order of their windows. */
export interface BoundData {
  /** When a splat is as it is stored, frames. */
  birth: Float32Array;
  /** `3n`: world units a frame, of its own where the nodes have not moved. */
  velocity: Float32Array;
  /** `3n`: change of the first coefficients of the colour a frame. */
  trend: Float32Array;
  /** `2n`: begin and end, frames; infinite where no frame shows it. */
  life: Float32Array;
  /** `4n`: nodes of the window. */
  nodes: Uint16Array;
  /** `4n`: their shares in 255ths, which sum to 255. */
  weights: Uint8Array;
  windows: readonly MotionWindow[];
}

/** Of a scene without bound splats. */
export const NOTHING_BOUND: BoundData = {
  birth: new Float32Array(0),
  velocity: new Float32Array(0),
  trend: new Float32Array(0),
  life: new Float32Array(0),
  nodes: new Uint16Array(0),
  weights: new Uint8Array(0),
  windows: [],
};

/** Splats in columns: the static ones, those that are bound to nodes, and those that move by themselves. */
export interface SceneData {
  nStatic: number;
  nBound: number;
  nFree: number;
  /** `3n`: x, y, z; of a free splat at `timeMean`, of a bound one at its birth where nodes have not moved. */
  mean: Float32Array;
  /** `3n`: standard deviations. */
  scale: Float32Array;
  /** `4n`: unit quaternions `w, x, y, z`. */
  quat: Float32Array;
  /** `n`: 0..1, at the peak in time. */
  opacity: Float32Array;
  /** `3 terms n`: index `splat * 3 * terms + 3 * term + channel`, temporal index of a term major. */
  colour: Float32Array;
  bound: BoundData;
  /** `nFree`: middle of the life, frames. */
  timeMean: Float32Array;
  /** `nFree`: standard deviation in time, frames. */
  timeSd: Float32Array;
  /** `3 nFree`: world units a frame. */
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
  return data.nStatic + data.nBound + data.nFree;
}
