/** All that decides an image: one instant, one camera. */

import type { Lens } from "../camera/path";
import type { Placement } from "../camera/view";
import { type Pose, matrixOf } from "../maths";
import { LOW_PASS } from "./shaders";
import type { SliceView } from "./slice";

export interface View {
  /** Frames. */
  readonly t: number;
  readonly pose: Pose;
  /** For the whole of the canvas, its pixels. */
  readonly lens: Lens;
  /** Focal length of the training over that of the lens; the filter grows with the image. */
  readonly magnification: number;
  /** 0..1: how much of the image is gone. */
  readonly fade: number;
  /** The frame of the source camera, pixels of the canvas; what lies further out is not shown. */
  readonly frame: Placement | null;
  /** Where the frame of the source camera lies, pixels of the window. */
  readonly placement: Placement;
  /** Whether the camera is the source camera, so that its frame fits over the image. */
  readonly riding: boolean;
}

/** How softly the image ends at the frame, as a share of the frame's shorter side. */
const FEATHER = 0.08;

/** Width of the soft edge, pixels of the canvas; 0 where all of the image is shown. */
export const featherOf = ({ frame }: View): number => (frame ? FEATHER * Math.min(frame.width, frame.height) : 0);

/** Variance that is added to every ellipse, pixels squared. */
export const lowPassOf = (view: View): number => LOW_PASS * Math.max(view.magnification, 1) ** 2;

/** The part of the canvas that shows something, whole pixels: left, top, right, bottom. */
export function partOf(view: View): [number, number, number, number] {
  const { frame, lens } = view;
  if (!frame) return [0, 0, lens.width, lens.height];
  const soft = featherOf(view);
  return [
    Math.max(0, Math.floor(frame.x - soft)),
    Math.max(0, Math.floor(frame.y - soft)),
    Math.min(lens.width, Math.ceil(frame.x + frame.width + soft)),
    Math.min(lens.height, Math.ceil(frame.y + frame.height + soft)),
  ];
}

/** World to camera, OpenCV axes, 3x4 row-major. */
export function worldToCamera(pose: Pose): number[] {
  const m = matrixOf(pose);
  const at = (row: number, column: number): number => m[4 * row + column] ?? 0;
  return [0, 1, 2].flatMap((k) => {
    const axis = [at(0, k), at(1, k), at(2, k)];
    return [...axis, -axis.reduce((sum, v, i) => sum + v * at(i, 3), 0)];
  });
}

/** What slicing and sorting need of a view. */
export function sliceViewOf(view: View): SliceView {
  return { ...view.lens, t: view.t, w2c: worldToCamera(view.pose), part: partOf(view), lowPass: lowPassOf(view) };
}

/** Whether two views are the same image. */
export function sameView(a: View, b: View): boolean {
  const numbers = (v: View): number[] => [
    ...[v.t, v.magnification, v.fade, ...v.pose.position, ...v.pose.rotation],
    ...[v.lens.width, v.lens.height, v.lens.fx, v.lens.fy, v.lens.cx, v.lens.cy],
    ...(v.frame ? [v.frame.x, v.frame.y, v.frame.width, v.frame.height] : [-1, -1, -1, -1]),
  ];
  const other = numbers(b);
  return a.riding === b.riding && numbers(a).every((v, i) => v === other[i]);
}
