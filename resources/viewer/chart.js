import {byId, lineThrough, select, svg} from "./elements.js";
import {ticks} from "./texts.js";

/** @import {ProfilePoint} from "./profile.js" */
/** @import {Texts} from "./texts.js" */
const TICK_PX = 90; // between distances, at least
const LEAST_RANGE_M = 0.5; // of heights

/** The chart of a profile, and the sentence under it. */
export class Chart {
  /**
   * @param {Texts} texts
   * @param {(point: ProfilePoint) => void} pointed - called with the point that the pointer is at
   */
  constructor(texts, pointed) {
    this.texts = texts;
    this.pointed = pointed;
    this.svg = select(SVGSVGElement, byId("chart"), "svg");
    this.svg.addEventListener("pointermove", (event) => this.#point(event.clientX));
    /** @type {ProfilePoint[]} */
    this.points = [];
    this.box = {left: 0, right: 0, top: 0, bottom: 0};
  }

  /** @param {string} text */
  say(text) {
    byId("under").textContent = text;
  }

  /** @param {ProfilePoint[]} points - none for an empty chart */
  draw(points) {
    this.svg.replaceChildren();
    this.say("");
    const {low} = this.texts.facts;
    const heights = points.map(({z}) => low + z);
    const known = heights.filter((height) => !Number.isNaN(height));
    this.points = known.length ? points : [];
    if (!known.length) return;
    this.box = {left: 58, right: this.svg.clientWidth - 34, top: 8, bottom: this.svg.clientHeight - 20};
    const y = this.#drawHeights(known);
    const x = this.#drawDistances();
    const line = heights.map((height, i) => (Number.isNaN(height) ? null : [x(points[i].distance), y(height)]));
    const {top, bottom} = this.box;
    this.svg.append(
      svg("path", {d: lineThrough(line)}),
      svg("line", {class: "at", y1: top, y2: bottom, x1: -9, x2: -9}),
    );
    this.say(this.texts.onProfile(points[points.length - 1]));
  }

  /**
   * Draws the axis, and gives where a height is on it, px.
   * @param {number[]} heights - m
   */
  #drawHeights(heights) {
    const {left, right, top, bottom} = this.box;
    let low = Math.min(...heights);
    let high = Math.max(...heights);
    if (high - low < LEAST_RANGE_M) {
      const middle = (low + high) / 2;
      [low, high] = [middle - LEAST_RANGE_M / 2, middle + LEAST_RANGE_M / 2];
    }
    /** @param {number} height */
    const y = (height) => bottom - ((height - low) / (high - low)) * (bottom - top);
    for (const height of ticks(low, high, 5)) {
      this.svg.append(
        svg("line", {x1: left, x2: right, y1: y(height), y2: y(height)}),
        svg("text", {x: left - 6, y: y(height) + 4, "text-anchor": "end"}, metresText(height)),
      );
    }
    return y;
  }

  /** Draws the axis, and gives where a distance is on it, px. */
  #drawDistances() {
    const {left, right, bottom} = this.box;
    const length = this.points[this.points.length - 1].distance || 1;
    /** @param {number} distance */
    const x = (distance) => left + (distance / length) * (right - left);
    for (const distance of ticks(0, length, Math.max(right - left, 100) / TICK_PX)) {
      const at = {x: x(distance), y: bottom + 15, "text-anchor": "middle"};
      this.svg.append(svg("text", at, metresText(distance)));
    }
    return x;
  }

  /** @param {number} clientX - px */
  #point(clientX) {
    if (!this.points.length) return;
    const {left, right} = this.box;
    const inChart = clientX - this.svg.getBoundingClientRect().left;
    const share = Math.min(Math.max((inChart - left) / (right - left), 0), 1);
    const x = String(left + share * (right - left));
    const line = select(SVGLineElement, this.svg, "line.at");
    line.setAttribute("x1", x);
    line.setAttribute("x2", x);
    const point = this.points[Math.round(share * (this.points.length - 1))];
    this.say(this.texts.onProfile(point));
    this.pointed(point);
  }
}

/** @param {number} value */
function metresText(value) {
  return `${Number(value.toPrecision(8))} m`;
}
