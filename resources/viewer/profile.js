import {Chart} from "./chart.js";
import {byId, lineThrough, svg} from "./elements.js";

/** @import {Drawing} from "./drawing.js" */
/** @import {Picked} from "./picking.js" */
/** @import {Texts} from "./texts.js" */
/**
 * A point of the line: its cell, the distance from the line's first end (m), and its height (m above the least), NaN
 * for none.
 * @typedef {{column: number, row: number, distance: number, z: number}} ProfilePoint
 */

/** The profile between two places that were clicked on: its line on the surface, and its chart. */
export class Profile {
  on = false;
  /** @type {Picked[]} */
  ends = [];
  /** @type {ProfilePoint[]} */
  points = [];
  /** Where the chart is pointed at. @type {ProfilePoint | null} */
  at = null;

  /**
   * @param {Drawing} drawing
   * @param {Texts} texts
   */
  constructor(drawing, texts) {
    this.drawing = drawing;
    this.texts = texts;
    this.chart = new Chart(texts, (point) => {
      this.at = point;
      this.drawMarks();
    });
  }

  #clear() {
    this.ends = [];
    this.points = [];
    this.at = null;
  }

  /** @param {boolean} on */
  switch(on) {
    this.#clear();
    this.on = on;
    this.drawing.camera.canvas.classList.toggle("profile", on);
    byId("profile").setAttribute("aria-pressed", String(on));
    this.drawChart();
    this.drawing.draw();
  }

  /** @param {Picked} at */
  addEnd(at) {
    if (this.ends.length === 2) this.#clear();
    this.ends.push(at);
    if (this.ends.length === 2) this.points = this.#pointsBetween(this.ends[0], this.ends[1]);
    this.drawChart();
    this.drawing.draw();
  }

  /**
   * Two points for each cell, at most 4001.
   * @param {Picked} a
   * @param {Picked} b
   * @returns {ProfilePoint[]}
   */
  #pointsBetween(a, b) {
    const {surface} = this.drawing;
    const dx = b.column - a.column;
    const dy = b.row - a.row;
    const length = Math.hypot(dx * surface.cellX, dy * surface.cellY);
    const count = Math.min(Math.max(Math.ceil(2 * Math.hypot(dx, dy)), 2), 4000);
    return Array.from({length: count + 1}, (_, i) => {
      const column = a.column + (dx * i) / count;
      const row = a.row + (dy * i) / count;
      const z = surface.isKnown(column, row) ? surface.height(column, row) : Number.NaN;
      return {column, row, distance: (length * i) / count, z};
    });
  }

  /** The line and its ends on the surface. */
  drawMarks() {
    const {camera} = this.drawing;
    const marks = byId("marks");
    marks.replaceChildren();
    const thin = this.points.filter((_, i) => i % Math.ceil(this.points.length / 600) === 0);
    const line = lineThrough(thin.map(({column, row, z}) => (Number.isNaN(z) ? null : camera.onScreen(column, row))));
    if (line) marks.append(svg("path", {d: line}), svg("path", {d: line}));
    for (const {column, row} of this.at ? [...this.ends, this.at] : this.ends) {
      const place = camera.onScreen(column, row);
      if (place) marks.append(svg("circle", {cx: place[0], cy: place[1], r: 5}));
    }
  }

  /** The chart, or what to do for one. */
  drawChart() {
    const {words} = this.texts;
    byId("chart").hidden = !this.on;
    this.chart.draw(this.points);
    if (!this.points.length) this.chart.say(this.on ? (this.ends.length ? words.second : words.first) : "");
  }
}
