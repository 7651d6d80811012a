/**
 * Splats at an instant: place, opacity and colour, and the ellipse on the image as the renderer of the
 * training draws it. All of a splat comes at full precision from float textures.
 */

import { type Manifest, shTerms } from "../scene";
import { fetchTexel } from "./columns";
import { shadeStatements } from "./shade";
import { JACOBIAN_MARGIN, NOTHING } from "./slice";
import { MARGINAL_MIN, marginalGlsl } from "./window";

/** Added to the image covariance, pixels squared (3DGS). */
export const LOW_PASS = 0.3;
const NEAR_MIN = 1e-6;
/**
 * Splats that are drawn as one instance. One of four vertices each would do, and is slow: drivers take instances
 * one by one.
 */
export const BATCH = 1024;

const number = (v: number): string => v.toPrecision(10);

/** Corners of a parallelogram that holds the ellipse down to an opacity of 1 / 255. */
export const splatVertex = (manifest: Manifest): string => /* glsl */ `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;

uniform usampler2D order;
uniform sampler2D place;
uniform sampler2D shape;
uniform sampler2D life;
uniform sampler2D colours;
uniform int dynamicFrom;  // the first dynamic splat
uniform float time;       // frames
uniform vec3 eye;
uniform mat4 view;        // world to camera, OpenCV axes
uniform vec4 lens;        // fx, fy, cx, cy, pixels
uniform vec2 size;        // of the image, pixels
uniform float near;
uniform float lowPass;    // pixels squared
uniform bool mip;

out vec2 vOffset;         // from the centre, standard deviations
out vec4 vColour;

mat3 axesOf(vec3 s, vec4 q) {
  vec3 r = 2.0 * q.xyz;
  float xx = q.x * r.x, yy = q.y * r.y, zz = q.z * r.z;
  float xy = q.x * r.y, xz = q.x * r.z, yz = q.y * r.z;
  float wx = q.w * r.x, wy = q.w * r.y, wz = q.w * r.z;
  return mat3(
    s.x * vec3(1.0 - yy - zz, xy + wz, xz - wy),
    s.y * vec3(xy - wz, 1.0 - xx - zz, yz + wx),
    s.z * vec3(xz + wy, yz - wx, 1.0 - xx - yy)
  );
}

void main() {
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  vOffset = vec2(0.0);
  vColour = vec4(0.0);

  uint id = ${fetchTexel("order", `gl_InstanceID * ${BATCH} + (gl_VertexID >> 2)`)}.x;
  if (id == ${NOTHING}u) return;
  int index = int(id);
  vec4 placed = ${fetchTexel("place", "index")};
  vec4 scaled = ${fetchTexel("shape", "2 * index")};
  vec3 mean = placed.xyz;
  float opacity = placed.w;
  float turns = 0.0;
  if (index >= dynamicFrom) {
    vec4 lived = ${fetchTexel("life", "(index - dynamicFrom)")};
    float dt = time - lived.x;
    float marginal = ${marginalGlsl("dt", "lived.y")};
    if (!(marginal > ${number(MARGINAL_MIN)})) return;
    opacity *= marginal;
    mean += dt * vec3(lived.zw, scaled.w);
    turns = dt * ${number(1 / manifest.period_frames)};
  }
  if (opacity < 1.0 / 255.0) return;

  mat3 turn = mat3(view);
  vec3 p = turn * mean + view[3].xyz;
  if (!(p.z > max(near, ${number(NEAR_MIN)}))) return;
  vec2 ray = p.xy / p.z;

  // covariance in the camera
  mat3 m = turn * axesOf(scaled.xyz, ${fetchTexel("shape", "2 * index + 1")});

  // the Jacobian, within a margin of the image
  vec2 margin = ${number(JACOBIAN_MARGIN)} * size / (2.0 * lens.xy);
  vec2 k = clamp(ray, -lens.zw / lens.xy - margin, (size - lens.zw) / lens.xy + margin);
  vec2 f = lens.xy / p.z;
  vec3 row0 = f.x * (vec3(m[0].x, m[1].x, m[2].x) - k.x * vec3(m[0].z, m[1].z, m[2].z));
  vec3 row1 = f.y * (vec3(m[0].y, m[1].y, m[2].y) - k.y * vec3(m[0].z, m[1].z, m[2].z));
  float a = dot(row0, row0), b = dot(row0, row1), d = dot(row1, row1);
  float sharp = max(a * d - b * b, 0.0);
  a += lowPass;
  d += lowPass;
  float det = a * d - b * b;
  if (!(det > 0.0)) return;
  if (mip) opacity *= sqrt(sharp / det);
  if (!(opacity >= 1.0 / 255.0)) return;

  vec3 toSplat = normalize(mean - eye);
  ${shadeStatements("colours", shTerms(manifest), manifest.splats.time_degree + 1).join("\n  ")}

  // the root of the covariance takes the unit circle to the ellipse
  float reach = sqrt(2.0 * log(255.0 * opacity));
  float l00 = sqrt(a), l10 = b / l00, l11 = sqrt(det / a);
  vec2 corner = reach * vec2((gl_VertexID & 1) == 0 ? -1.0 : 1.0, (gl_VertexID & 2) == 0 ? -1.0 : 1.0);
  vec2 pixel = lens.xy * ray + lens.zw + vec2(l00 * corner.x, l10 * corner.x + l11 * corner.y);
  vec2 ndc = 2.0 * pixel / size - 1.0;
  gl_Position = vec4(ndc.x, -ndc.y, 0.0, 1.0);
  vOffset = corner;
  vColour = vec4(colour, opacity);
}
`;

export const SPLAT_FRAGMENT = /* glsl */ `#version 300 es
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

/** A triangle over everything. */
export const PRESENT_VERTEX = /* glsl */ `#version 300 es
out vec2 vPlace;
void main() {
  vPlace = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(vPlace, 0.0, 1.0);
}
`;

/**
 * The image to the screen as it is, less what the safe region takes away and what lies outside of
 * the frame of the source camera: nothing was ever seen there.
 */
export const PRESENT_FRAGMENT = /* glsl */ `#version 300 es
precision highp float;
uniform highp sampler2D image;
uniform vec3 fadeTo;
uniform float fade;
uniform vec4 frame;    // left, bottom, right, top, pixels
uniform float feather; // pixels
uniform vec3 outside;
in vec2 vPlace;
out vec4 fragColour;

void main() {
  vec3 colour = texelFetch(image, ivec2(gl_FragCoord.xy), 0).rgb;
  float edge = smoothstep(0.2, 1.2, length(vPlace));
  colour = mix(colour, fadeTo, fade * mix(0.75, 1.0, edge));
  vec2 beyond = max(max(frame.xy - gl_FragCoord.xy, gl_FragCoord.xy - frame.zw), 0.0);
  float gone = feather > 0.0 ? smoothstep(0.0, 1.0, length(beyond) / feather) : 0.0;
  fragColour = vec4(mix(colour, outside, gone), 1.0);
}
`;
