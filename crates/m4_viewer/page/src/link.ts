/**
 * What is seen as the fragment of an address, and back: `#t=12.34` rides the source camera,
 * `#t=12.34&c=x,y,z,qw,qx,qy,qz` looks from there. Times in frames; the scene itself is not in it.
 */

import { type Pose, quatUnit } from "./maths";

export interface Place {
  t: number;
  /** Absent: the source camera's at that time. */
  pose?: Pose;
}

const short = (v: number, digits: number): string => String(Number(v.toPrecision(digits)));

export function toFragment(place: Place): string {
  let out = `#t=${Number(place.t.toFixed(3))}`;
  if (place.pose) {
    const numbers = [...place.pose.position, ...place.pose.rotation];
    out += `&c=${numbers.map((v) => short(v, 6)).join(",")}`;
  }
  return out;
}

/** `null` where the fragment holds no place, or a senseless one. */
export function fromFragment(fragment: string): Place | null {
  const fields = new URLSearchParams(fragment.replace(/^#/, ""));
  const text = fields.get("t");
  if (text === null || text.trim() === "") return null;
  const t = Number(text);
  if (!Number.isFinite(t)) return null;
  const camera = fields.get("c");
  if (camera === null) return { t };
  const parts = camera.split(",");
  const v = parts.map(Number);
  const [x, y, z, qw, qx, qy, qz] = v;
  if (
    v.length !== 7 ||
    !v.every(Number.isFinite) ||
    x === undefined ||
    y === undefined ||
    z === undefined ||
    qw === undefined ||
    qx === undefined ||
    qy === undefined ||
    qz === undefined ||
    Math.hypot(qw, qx, qy, qz) < 1e-6
  ) {
    return null;
  }
  return { t, pose: { position: [x, y, z], rotation: quatUnit([qw, qx, qy, qz]) } };
}
