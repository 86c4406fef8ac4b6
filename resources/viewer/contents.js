import {byId} from "./elements.js";
import {Surface} from "./surface.js";

/**
 * What `viewer/page.py` writes into the page about its DSM.
 * @typedef {object} Facts
 * @property {[number, number]} size - columns and rows
 * @property {[number, number]} corner - of the north-west cell, in units of the CRS
 * @property {[number, number]} step - from cell to cell, in units of the CRS
 * @property {[number, number]} cell_m - a cell's size, m
 * @property {number} decimals - of coordinates
 * @property {string} datum - "" for none
 * @property {number} low - the least height, m
 * @property {number} quantum - m for each step of the levels
 * @property {string} heights - levels, packed
 * @property {string} mask - which cells have a height, packed; "" for all
 * @property {PackedLayer[]} layers
 */
/**
 * @typedef {object} PackedLayer
 * @property {string} kind - "dsm", "ortho", "confidence" or "dsm_error"
 * @property {string[]} [ramp] - colours from `low` to `high`, each "#rrggbb"
 * @property {number} [low]
 * @property {number} [high]
 * @property {string} [values] - 1 to 254 + 1 from `low` to `high`, 0 for none, packed
 * @property {string} [picture] - a JPEG in base64
 */
/**
 * What can be shown on the surface: a picture, values with their colours, or (without both) its heights' colours.
 * @typedef {object} Layer
 * @property {string} kind
 * @property {string} title
 * @property {string[]} ramp - none for a picture
 * @property {number} low
 * @property {number} high
 * @property {Uint8Array | null} values
 * @property {HTMLImageElement | null} picture
 */
/** @typedef {Record<string, string>} Words */

/** @returns {{facts: Facts, words: Words}} */
export function readFacts() {
  const [facts, words] = ["facts", "words"].map((name) => JSON.parse(byId(name).textContent ?? ""));
  return {facts, words};
}

/** The text of what was read is no longer needed. */
export function forgetText() {
  for (const name of ["facts", "words"]) byId(name).remove();
}

/**
 * Throws an error of any kind where the page is damaged.
 * @param {Facts} facts
 */
export async function readSurface(facts) {
  const levels = levelsOf(await unpacked(facts.heights), facts.size);
  const known = maskOf(facts.mask ? await unpacked(facts.mask) : null, levels.length);
  return new Surface(facts, levels, known);
}

/**
 * Throws an error of any kind where the page is damaged.
 * @param {Facts} facts
 * @param {Words} words
 * @returns {Promise<Layer[]>}
 */
export async function readLayers(facts, words) {
  const layers = [];
  for (const packed of facts.layers) {
    const {kind, ramp = [], low = 0, high = 0} = packed;
    const values = packed.values ? await unpacked(packed.values) : null;
    const picture = packed.picture ? await pictureOf(packed.picture) : null;
    layers.push({kind, title: words[kind], ramp, low, high, values, picture});
  }
  return layers;
}

/** @param {string} jpeg - in base64 */
async function pictureOf(jpeg) {
  const picture = new Image();
  picture.src = `data:image/jpeg;base64,${jpeg}`;
  await picture.decode();
  return picture;
}

/** @param {string} text - bytes, deflated, in base64 */
async function unpacked(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/**
 * @param {string} text - bytes in base64
 * @returns {Uint8Array<ArrayBuffer>}
 */
function bytesOf(text) {
  if ("fromBase64" in Uint8Array) return /** @type {any} */ (Uint8Array).fromBase64(text);
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  return bytes;
}

/**
 * Each level is stored as its difference from the one to the left (in the first column, from the one above), low bytes
 * before high bytes.
 * @param {Uint8Array} bytes
 * @param {[number, number]} size
 */
function levelsOf(bytes, [columns, rows]) {
  const count = columns * rows;
  if (bytes.length !== 2 * count) throw new Error("heights");
  const levels = new Uint16Array(count);
  for (let row = 0, i = 0; row < rows; row++) {
    let level = row ? levels[i - columns] : 0;
    for (const end = i + columns; i < end; i++) {
      level += bytes[i] + (bytes[count + i] << 8);
      levels[i] = level;
    }
  }
  return levels;
}

/**
 * @param {Uint8Array | null} bits - eight cells in a byte, the first in its highest bit; null for all cells
 * @param {number} count - of cells
 */
function maskOf(bits, count) {
  const known = new Uint8Array(count).fill(1);
  if (bits) for (let i = 0; i < count; i++) known[i] = (bits[i >> 3] >> (7 - (i & 7))) & 1;
  return known;
}
