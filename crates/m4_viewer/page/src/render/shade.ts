/**
 * GLSL of a splat's colour: real spherical harmonics up to degree 3 in the order and with the signs of
 * the 3DGS family, times cosines of time.
 */

import { fetchTexel } from "./columns";

const C0 = 0.28209479177387814;
const C1 = 0.4886025119029199;
const C2 = [1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396];
const C3 = [
  -0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154, -0.4570457994644658,
  1.445305721320277, -0.5900435899266435,
];

/** Each harmonic of a unit direction `x, y, z` as GLSL, without its factor. */
const POLYNOMIALS: readonly (readonly [number, string])[] = [
  [C0, "1.0"],
  [-C1, "y"],
  [C1, "z"],
  [-C1, "x"],
  [C2[0] ?? 0, "x * y"],
  [C2[1] ?? 0, "y * z"],
  [C2[2] ?? 0, "(2.0 * z * z - x * x - y * y)"],
  [C2[3] ?? 0, "x * z"],
  [C2[4] ?? 0, "(x * x - y * y)"],
  [C3[0] ?? 0, "y * (3.0 * x * x - y * y)"],
  [C3[1] ?? 0, "x * y * z"],
  [C3[2] ?? 0, "y * (4.0 * z * z - x * x - y * y)"],
  [C3[3] ?? 0, "z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y)"],
  [C3[4] ?? 0, "x * (4.0 * z * z - x * x - y * y)"],
  [C3[5] ?? 0, "z * (x * x - y * y)"],
  [C3[6] ?? 0, "x * (x * x - 3.0 * y * y)"],
];

/**
 * Statements that leave the colour in `vec3 colour`. They read `int index`, `vec3 toSplat` (a unit
 * vector from the camera), `float turns` (`(t - time_mean) / period`, 0 for static and bound splats) and `vec3 change` (of the
 * first coefficients since they were stored).
 */
export function shadeStatements(texture: string, shTerms: number, timeTerms: number): string[] {
  const terms = shTerms * timeTerms;
  const texels = Math.ceil((3 * terms) / 4);
  const out = [`vec3 colour = vec3(0.5) + ${C0.toPrecision(10)} * change;`, `int first = index * ${texels};`];
  for (let k = 0; k < texels; k++) out.push(`vec4 k${k} = ${fetchTexel(texture, `first + ${k}`)};`);
  if (shTerms > 1) out.push("float x = toSplat.x, y = toSplat.y, z = toSplat.z;");
  const component = (i: number): string => `k${i >> 2}.${"xyzw"[i & 3] ?? "x"}`;
  for (let n = 0; n < timeTerms; n++) {
    if (n > 0) out.push(`float wave${n} = cos(${(2 * Math.PI * n).toPrecision(10)} * turns);`);
    for (let l = 0; l < shTerms; l++) {
      const [factor, polynomial] = POLYNOMIALS[l] ?? [0, "0.0"];
      const term = n * shTerms + l;
      const k = [0, 1, 2].map((c) => component(3 * term + c)).join(", ");
      const wave = n > 0 ? ` * wave${n}` : "";
      out.push(`colour += (${factor.toPrecision(10)} * ${polynomial}${wave}) * vec3(${k});`);
    }
  }
  out.push("colour = max(colour, vec3(0.0));");
  return out;
}
