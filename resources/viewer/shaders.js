import {CHUNK} from "./chunks.js";

export const VERTICES = `#version 300 es
  precision highp float;
  uniform highp usampler2D heights;
  uniform mat4 seen;
  uniform vec2 cell, middle;
  uniform float rise;
  in vec2 corner;       // of a chunk's lattice, in cells
  in vec2 origin;       // of the chunk
  in vec4 edge;         // cells between the vertices of its west, east, north and south edge
  out vec2 place;
  out float level;
  void main() {
    vec2 at = corner;
    if (corner.x == 0.0) at.y = floor(corner.y / edge.x) * edge.x;
    if (corner.x == ${CHUNK}.0) at.y = floor(corner.y / edge.y) * edge.y;
    if (corner.y == 0.0) at.x = floor(corner.x / edge.z) * edge.z;
    if (corner.y == ${CHUNK}.0) at.x = floor(corner.x / edge.w) * edge.w;
    ivec2 size = textureSize(heights, 0);
    ivec2 index = min(ivec2(origin + at), size - 1);
    level = float(texelFetch(heights, index, 0).r);
    place = (vec2(index) + 0.5) / vec2(size);
    gl_Position = seen * vec4((float(index.x) - middle.x) * cell.x, (middle.y - float(index.y)) * cell.y, level * rise, 1);
  }`;

export const PIXELS = `#version 300 es
  precision highp float;
  uniform sampler2D normals, draped, ramp;
  uniform vec3 sun;
  uniform vec2 range;   // of the levels that the ramp's colours are spread over
  uniform float exaggeration, shading;
  uniform int kind;     // 0 elevation, 1 picture, 2 values
  in vec2 place;
  in float level;
  out vec4 colour;
  void main() {
    vec4 normal = texture(normals, place);
    vec2 texels = fwidth(place) * vec2(textureSize(normals, 0));
    if (normal.a < mix(0.98, 0.5, clamp(log2(max(max(texels.x, texels.y), 1.0)), 0.0, 1.0))) discard;
    vec2 root = normal.xy * 2.0 - 1.0, level_xy = root * abs(root);
    vec3 bent = normalize(vec3(level_xy / sqrt(max(1.0 - dot(level_xy, level_xy), 1e-4)) * exaggeration, 1.0));
    float light = max(dot(bent, sun), 0.0) / max(sun.z, 0.2);
    vec3 paint;
    if (kind == 0) paint = texture(ramp, vec2((level - range.x) / (range.y - range.x), 0.5)).rgb;
    else if (kind == 1) paint = texture(draped, place).rgb;
    else {
      vec2 found = texture(draped, place).rg;
      paint = found.y < 0.5 ? vec3(0.55) : texture(ramp, vec2((found.x / found.y * 255.0 - 1.0) / 254.0, 0.5)).rgb;
    }
    vec3 dark = paint * (0.4 + 0.6 * min(light, 1.0));
    colour = vec4(mix(paint, dark + (1.0 - dark) * clamp(light - 1.0, 0.0, 1.0) * 0.45, shading), 1.0);
  }`;
