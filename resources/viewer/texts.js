/** @import {Facts, Layer, Words} from "./contents.js" */
/** @import {Surface} from "./surface.js" */

/** What the page says of places, in its reader's language. */
export class Texts {
  /**
   * @param {Facts} facts
   * @param {Words} words
   * @param {Surface} surface
   */
  constructor(facts, words, surface) {
    this.facts = facts;
    this.words = words;
    this.surface = surface;
  }

  /** @param {number} z - m above the least height; NaN for none */
  height(z) {
    if (Number.isNaN(z)) return this.words.none;
    return `${this.words.height} ${(this.facts.low + z).toFixed(2)} m`;
  }

  /**
   * @param {number} column
   * @param {number} row
   */
  coordinates(column, row) {
    const {corner, step, decimals} = this.facts;
    const [x, y] = [column, row].map((cell, i) => (corner[i] + (cell + 0.5) * step[i]).toFixed(decimals));
    return `x ${x}, y ${y}`;
  }

  /**
   * A point of a profile.
   * @param {{distance: number, z: number, column: number, row: number}} point
   */
  onProfile({distance, z, column, row}) {
    return `${this.words.distance} ${distance.toFixed(1)} m · ${this.height(z)} · ${this.coordinates(column, row)}`;
  }

  /**
   * A place of the surface, and what a layer has there.
   * @param {{column: number, row: number}} at
   * @param {Layer} layer
   */
  place({column, row}, layer) {
    const {facts, words, surface} = this;
    const datum = facts.datum ? ` (${words.above} ${facts.datum})` : "";
    const parts = [this.coordinates(column, row), this.height(surface.height(column, row)) + datum];
    const value = layer.values?.[Math.round(row) * surface.columns + Math.round(column)];
    if (value) parts.push(`${layer.title} ${valueText(value, layer)}`);
    return parts.join(" · ");
  }
}

/**
 * How many decimals a layer's range asks for.
 * @param {Layer} layer
 */
export function decimalsOf({low, high}) {
  return Math.max(Math.min(2 - Math.floor(Math.log10(high - low || 1)), 6), 0);
}

/**
 * @param {number} value - 1 to 255; its ends are for all that is beyond them, too
 * @param {Layer} layer
 */
function valueText(value, layer) {
  const {low, high, kind} = layer;
  const sign = value === 1 && kind !== "confidence" ? "≤ " : value === 255 ? "≥ " : "";
  const shown = low + ((value - 1) / 254) * (high - low);
  return `${sign}${shown.toFixed(Math.max(decimalsOf(layer) - 1, 1))} m`;
}

/**
 * The greatest of 1, 2, 5, 10, 20 ... (and 0.5, 0.2 ...) that is not above a value.
 * @param {number} value
 */
export function niceBelow(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  const digit = [5, 2].find((larger) => larger * power <= value) ?? 1;
  return Number((digit * power).toPrecision(3));
}

/**
 * Nice values of a range, at most so many steps.
 * @param {number} low
 * @param {number} high
 * @param {number} most
 */
export function ticks(low, high, most) {
  let step = niceBelow((high - low) / most || 1);
  while ((high - low) / step > most) step *= 2;
  const found = [];
  for (let value = Math.ceil(low / step) * step; value <= high + 1e-9 * step; value += step) found.push(value);
  return found;
}
