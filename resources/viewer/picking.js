/** @import {Camera} from "./camera.js" */
/**
 * A place of the surface under a pixel: its cell (with decimals), and its place as it is drawn, m.
 * @typedef {{column: number, row: number, world: number[]}} Picked
 */

/**
 * What lies under a pixel; null beside the surface and where it has no height.
 * @param {Camera} camera
 * @param {number} x - px
 * @param {number} y - px
 * @returns {Picked | null}
 */
export function pick(camera, x, y) {
  const {surface} = camera;
  const [from, way] = camera.ray(x, y);
  const stretch = inBox(camera, from, way);
  if (!stretch) return null;
  const [begin, end] = stretch;
  /** @param {number} t - m along the ray */
  const cell = (t) => surface.cell(from[0] + way[0] * t, from[1] + way[1] * t);
  /** @param {number} t - m along the ray */
  const above = (t) => from[2] + way[2] * t - camera.heightAt(from[0] + way[0] * t, from[1] + way[1] * t);
  const flat = Math.max(Math.abs(way[0]) / surface.cellX, Math.abs(way[1]) / surface.cellY, 1e-6);
  const step = Math.max(0.5 / flat > end - begin ? (end - begin) / 8 : 0.5 / flat, 1e-6);
  for (let t = begin, before = above(begin) + 1e-6; t <= end + step; t += step) {
    const now = above(t);
    if (now <= 0 && before > 0) {
      const met = crossing(above, t - step, t);
      const [column, row] = cell(met);
      if (surface.isKnown(column, row)) return {column, row, world: from.map((value, i) => value + way[i] * met)};
    }
    before = now;
  }
  return null;
}

/**
 * What a hand holds at a pixel, m: the surface, or the plane of what the camera looks at.
 * @param {Camera} camera
 * @param {number} x - px
 * @param {number} y - px
 */
export function held(camera, x, y) {
  const [east, north, up] = camera.target;
  return pick(camera, x, y)?.world ?? [...(camera.onPlane(x, y, up) ?? [east, north]), up];
}

/**
 * The stretch of a ray that is inside the surface's box, m; null where there is none.
 * @param {Camera} camera
 * @param {number[]} from
 * @param {number[]} way
 * @returns {[number, number] | null}
 */
function inBox(camera, from, way) {
  const {surface} = camera;
  const top = surface.top * camera.exaggeration;
  const [east, north] = [surface.middle[0] * surface.cellX, surface.middle[1] * surface.cellY];
  const low = [-east, -north, -1];
  const high = [east, north, top + 1];
  let begin = 0;
  let end = 8 * surface.extent + 2 * top;
  for (const axis of [0, 1, 2]) {
    if (Math.abs(way[axis]) < 1e-9) {
      if (from[axis] < low[axis] || from[axis] > high[axis]) return null;
      continue;
    }
    const ends = [low, high].map((side) => (side[axis] - from[axis]) / way[axis]);
    begin = Math.max(begin, Math.min(...ends));
    end = Math.min(end, Math.max(...ends));
  }
  return begin > end ? null : [begin, end];
}

/**
 * Where a function that falls from above 0 crosses it.
 * @param {(t: number) => number} above
 * @param {number} low
 * @param {number} high
 */
function crossing(above, low, high) {
  let [positive, negative] = [low, high];
  for (let i = 0; i < 20; i++) {
    const half = (positive + negative) / 2;
    if (above(half) > 0) positive = half;
    else negative = half;
  }
  return negative;
}
