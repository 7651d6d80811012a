/** How the image of a source camera fits a window of another aspect ratio. */

import type { Lens } from "./path";

/** Where the source frame lies in the window, pixels of the window. */
export interface Placement {
  readonly x: number;
  readonly y: number;
  readonly width: number;
  readonly height: number;
}

/** How much larger than the whole frame the image may be drawn, so that less of the window is empty. */
const CROP_MOST = 1.6;

/** A lens for the window under which the source frame is `placement`. */
export interface Fitted {
  readonly lens: Lens;
  readonly placement: Placement;
}

/**
 * The source lens on a window of `width x height` pixels: the frame fills it where the shapes are
 * alike; else it is cut by no more than `CROP_MOST`, and the rest of the window stays empty.
 */
export function fitLens(source: Lens, width: number, height: number): Fitted {
  const [sx, sy] = [width / source.width, height / source.height];
  const s = Math.min(Math.max(sx, sy), CROP_MOST * Math.min(sx, sy));
  const placement = {
    x: (width - s * source.width) / 2,
    y: (height - s * source.height) / 2,
    width: s * source.width,
    height: s * source.height,
  };
  return {
    placement,
    lens: {
      fx: s * source.fx,
      fy: s * source.fy,
      cx: placement.x + s * source.cx,
      cy: placement.y + s * source.cy,
      width,
      height,
    },
  };
}
