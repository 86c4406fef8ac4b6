/** @import {Camera} from "./camera.js" */
/** @import {Surface} from "./surface.js" */
export const CHUNK = 64; // cells along a chunk's side
export const STEPS = [1, 2, 4, 8, 16, 32]; // cells along the sides of a chunk's squares
const EDGE_PX = 3; // of squares on the screen

/**
 * A square part of the surface.
 * @typedef {object} Chunk
 * @property {number[]} origin - column and row of its north-west corner
 * @property {number} low - its least height, m
 * @property {number} high - its greatest height, m
 * @property {number[]} place - its middle, m
 * @property {number[]} half - half its width and depth, m
 * @property {number} step - of `STEPS`, chosen for the camera
 * @property {boolean} seen - whether the camera may see it
 */
/**
 * A chunk to draw, and the steps of its west, east, north and south edge.
 * @typedef {{chunk: Chunk, edges: number[]}} SeenChunk
 */

/** The surface in chunks, of which those near the eye are drawn finely. */
export class Chunks {
  /** @param {Surface} surface */
  constructor(surface) {
    this.finest = surface.finest;
    this.across = Math.max(Math.ceil((surface.columns - 1) / CHUNK), 1);
    this.along = Math.max(Math.ceil((surface.rows - 1) / CHUNK), 1);
    /** @type {Chunk[]} */
    this.all = [];
    for (let r = 0; r < this.along; r++) {
      for (let c = 0; c < this.across; c++) this.all.push(chunkAt(surface, c * CHUNK, r * CHUNK));
    }
  }

  /**
   * What the camera sees: triangles of about EDGE_PX pixels, and edges between chunks that have the same vertices.
   * @param {Camera} camera
   * @param {number} detail - pixels of the picture for each of the page's
   * @returns {SeenChunk[]}
   */
  seen(camera, detail) {
    const planes = camera.planes();
    for (const chunk of this.all) this.#choose(chunk, camera, planes, detail);
    return this.all.flatMap((chunk, i) => (chunk.seen ? [{chunk, edges: this.#edges(i)}] : []));
  }

  /**
   * @param {Chunk} chunk
   * @param {Camera} camera
   * @param {number[][]} planes
   * @param {number} detail
   */
  #choose(chunk, camera, planes, detail) {
    const [x, y] = chunk.place;
    const z = ((chunk.low + chunk.high) / 2) * camera.exaggeration;
    const [wide, deep] = chunk.half;
    const radius = Math.hypot(wide, deep, ((chunk.high - chunk.low) / 2) * camera.exaggeration);
    const [eyeX, eyeY, eyeZ] = camera.eye;
    const away = Math.max(Math.hypot(x - eyeX, y - eyeY, z - eyeZ) - radius, 1e-3);
    const wanted = EDGE_PX / (camera.pixelsPerMetre(away) * detail * this.finest);
    chunk.step = STEPS[Math.min(Math.max(Math.floor(Math.log2(wanted)), 0), STEPS.length - 1)];
    chunk.seen = planes.every((p) => p[0] * x + p[1] * y + p[2] * z + p[3] > -radius);
  }

  /** @param {number} i */
  #edges(i) {
    const {across, along} = this;
    const c = i % across;
    const r = (i - c) / across;
    const beside = [c ? i - 1 : i, c < across - 1 ? i + 1 : i, r ? i - across : i, r < along - 1 ? i + across : i];
    return beside.map((other) => Math.max(this.all[i].step, this.all[other].step));
  }
}

/**
 * @param {Surface} surface
 * @param {number} left - its first column
 * @param {number} top - its first row
 * @returns {Chunk}
 */
function chunkAt(surface, left, top) {
  const {columns, rows, levels, cellX, cellY} = surface;
  const right = Math.min(left + CHUNK, columns - 1);
  const bottom = Math.min(top + CHUNK, rows - 1);
  let low = 65535;
  let high = 0;
  for (let row = top; row <= bottom; row++) {
    for (const level of levels.subarray(row * columns + left, row * columns + right + 1)) {
      if (level < low) low = level;
      if (level > high) high = level;
    }
  }
  return {
    origin: [left, top],
    low: surface.metres(low),
    high: surface.metres(high),
    place: surface.place((left + right) / 2, (top + bottom) / 2),
    half: [((right - left) / 2) * cellX, ((bottom - top) / 2) * cellY],
    step: 1,
    seen: true,
  };
}
