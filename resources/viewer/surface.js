/** @import {Facts} from "./contents.js" */

/**
 * The surface: a grid of heights. Places are metres east, north and up of its middle and of its least height. Cells
 * count from the north-west corner, and heights belong to the cells' centres.
 */
export class Surface {
  /**
   * @param {Facts} facts
   * @param {Uint16Array} levels - heights in steps of `facts.quantum`, row by row; cells without a height have a level
   *   to interpolate with
   * @param {Uint8Array} known - 1 for cells that have a height
   */
  constructor(facts, levels, known) {
    this.levels = levels;
    this.known = known;
    this.quantum = facts.quantum;
    this.columns = facts.size[0];
    this.rows = facts.size[1];
    this.cellX = facts.cell_m[0]; // m
    this.cellY = facts.cell_m[1];
    this.finest = Math.min(this.cellX, this.cellY);
    this.middle = [(this.columns - 1) / 2, (this.rows - 1) / 2];
    this.width = this.columns * this.cellX;
    this.depth = this.rows * this.cellY;
    this.extent = Math.hypot(this.width, this.depth);
    this.top = this.metres(levels.reduce((a, b) => Math.max(a, b), 0));
  }

  /** @param {number} level */
  metres(level) {
    return level * this.quantum;
  }

  /**
   * Metres east and north of the middle.
   * @param {number} column
   * @param {number} row
   */
  place(column, row) {
    return [(column - this.middle[0]) * this.cellX, (this.middle[1] - row) * this.cellY];
  }

  /**
   * Column and row.
   * @param {number} x - m east of the middle
   * @param {number} y - m north of it
   */
  cell(x, y) {
    return [x / this.cellX + this.middle[0], this.middle[1] - y / this.cellY];
  }

  /**
   * The height between the centres of cells, in metres above the least; outside, that of the nearest cell.
   * @param {number} column
   * @param {number} row
   */
  height(column, row) {
    const {columns, rows, levels} = this;
    const c = Math.min(Math.max(column, 0), columns - 1);
    const r = Math.min(Math.max(row, 0), rows - 1);
    const c0 = Math.min(Math.floor(c), Math.max(columns - 2, 0));
    const r0 = Math.min(Math.floor(r), Math.max(rows - 2, 0));
    const u = c - c0;
    const v = r - r0;
    const i = r0 * columns + c0;
    const right = columns > 1 ? 1 : 0;
    const down = rows > 1 ? columns : 0;
    const north = levels[i] * (1 - u) + levels[i + right] * u;
    const south = levels[i + down] * (1 - u) + levels[i + down + right] * u;
    return this.metres(north * (1 - v) + south * v);
  }

  /**
   * Whether the nearest cell has a height.
   * @param {number} column
   * @param {number} row
   */
  isKnown(column, row) {
    const c = Math.round(column);
    const r = Math.round(row);
    return c >= 0 && r >= 0 && c < this.columns && r < this.rows && this.known[r * this.columns + c] === 1;
  }
}
