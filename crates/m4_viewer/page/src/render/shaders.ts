/**
 * Ellipses on the image, as the renderer of the training draws them: the shapes come at full
 * precision from a float texture, place, opacity and colour from what Spark accumulated.
 */

import { fetchTexel } from "./textures";

/** Added to the image covariance, pixels squared (3DGS). */
export const LOW_PASS = 0.3;
/** The Jacobian is evaluated within this multiple of the half field of view (3DGS). */
const JACOBIAN_MARGIN = 0.3;
const NEAR_MIN = 1e-6;

/** Corners of a parallelogram that holds the ellipse down to an opacity of 1 / 255. */
export const SPLAT_VERTEX = /* glsl */ `
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;
precision highp usampler2DArray;

#include <splatDefines>

uniform usampler2D ordering;
uniform usampler2DArray extSplats;
uniform usampler2DArray extSplats2;
uniform sampler2D m4Shape;
uniform mat4 m4View;      // world to camera, OpenCV axes
uniform vec4 m4Lens;      // fx, fy, cx, cy, pixels
uniform vec2 m4Size;      // of the image, pixels
uniform float m4Near;
uniform float m4LowPass;  // pixels squared
uniform bool m4Mip;

out vec2 vOffset;         // from the centre, standard deviations
out vec4 vColour;

void main() {
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  vOffset = vec2(0.0);
  vColour = vec4(0.0);
  ivec2 slot = ivec2((gl_InstanceID >> 2) & 4095, gl_InstanceID >> 14);
  uint id = texelFetch(ordering, slot, 0)[gl_InstanceID & 3];
  if (id == 0xffffffffu) return;

  ivec3 texel = splatTexCoord(int(id));
  uvec4 first = texelFetch(extSplats, texel, 0);
  uvec4 second = texelFetch(extSplats2, texel, 0);
  float opacity = unpackHalf2x16(first.w).x;
  if (opacity < 1.0 / 255.0) return;
  vec3 colour = vec3(unpackHalf2x16(second.x), unpackHalf2x16(second.y).x);

  mat3 turn = mat3(m4View);
  vec3 p = turn * uintBitsToFloat(first.xyz) + m4View[3].xyz;
  if (!(p.z > max(m4Near, ${NEAR_MIN.toPrecision(10)}))) return;
  vec2 ray = p.xy / p.z;

  // covariance in the camera
  int at = 2 * int(id);
  mat3 axes = scaleQuaternionToMatrix(${fetchTexel("m4Shape", "at")}.xyz, ${fetchTexel("m4Shape", "at + 1")});
  mat3 m = turn * axes;

  // the Jacobian, within a margin of the image
  vec2 margin = ${JACOBIAN_MARGIN.toPrecision(10)} * m4Size / (2.0 * m4Lens.xy);
  vec2 k = clamp(ray, -m4Lens.zw / m4Lens.xy - margin, (m4Size - m4Lens.zw) / m4Lens.xy + margin);
  vec2 f = m4Lens.xy / p.z;
  vec3 row0 = f.x * (vec3(m[0].x, m[1].x, m[2].x) - k.x * vec3(m[0].z, m[1].z, m[2].z));
  vec3 row1 = f.y * (vec3(m[0].y, m[1].y, m[2].y) - k.y * vec3(m[0].z, m[1].z, m[2].z));
  float a = dot(row0, row0), b = dot(row0, row1), d = dot(row1, row1);
  float sharp = max(a * d - b * b, 0.0);
  a += m4LowPass;
  d += m4LowPass;
  float det = a * d - b * b;
  if (!(det > 0.0)) return;
  if (m4Mip) opacity *= sqrt(sharp / det);
  if (!(opacity >= 1.0 / 255.0)) return;

  // the root of the covariance takes the unit circle to the ellipse
  float reach = sqrt(2.0 * log(255.0 * opacity));
  float l00 = sqrt(a), l10 = b / l00, l11 = sqrt(det / a);
  vec2 corner = reach * position.xy;
  vec2 pixel = m4Lens.xy * ray + m4Lens.zw + vec2(l00 * corner.x, l10 * corner.x + l11 * corner.y);
  vec2 ndc = 2.0 * pixel / m4Size - 1.0;
  gl_Position = vec4(ndc.x, -ndc.y, 0.0, 1.0);
  vOffset = corner;
  vColour = vec4(colour, opacity);
}
`;

export const SPLAT_FRAGMENT = /* glsl */ `
precision highp float;

in vec2 vOffset;
in vec4 vColour;
out vec4 fragColour;

void main() {
  float alpha = min(vColour.a * exp(-0.5 * dot(vOffset, vOffset)), 0.99);
  if (alpha < 1.0 / 255.0) discard;
  fragColour = vec4(vColour.rgb * alpha, alpha);
}
`;

export const PRESENT_VERTEX = /* glsl */ `
out vec2 vPlace;
void main() {
  vPlace = position.xy;
  gl_Position = vec4(position.xy, 0.0, 1.0);
}
`;

/**
 * The picture to the screen as it is, less what the safe region takes away and what lies outside of
 * the frame of the source camera: nothing was ever seen there.
 */
export const PRESENT_FRAGMENT = /* glsl */ `
precision highp float;
uniform sampler2D picture;
uniform vec3 fadeTo;
uniform float fade;
uniform vec4 frame;    // left, bottom, right, top, pixels
uniform float feather; // pixels
uniform vec3 outside;
in vec2 vPlace;
out vec4 fragColour;

void main() {
  vec3 colour = texelFetch(picture, ivec2(gl_FragCoord.xy), 0).rgb;
  float edge = smoothstep(0.2, 1.2, length(vPlace));
  colour = mix(colour, fadeTo, fade * mix(0.75, 1.0, edge));
  vec2 beyond = max(max(frame.xy - gl_FragCoord.xy, gl_FragCoord.xy - frame.zw), 0.0);
  float gone = feather > 0.0 ? smoothstep(0.0, 1.0, length(beyond) / feather) : 0.0;
  fragColour = vec4(mix(colour, outside, gone), 1.0);
}
`;
