/** @import {Surface} from "./surface.js" */
const {m4, v3} = twgl;
const FIELD = radians(40); // of view, from the bottom to the top

/** @param {number} degrees */
export function radians(degrees) {
  return (degrees * Math.PI) / 180;
}

/** Where the surface is looked at from. It looks at `target` (m), `distance` metres away. */
export class Camera {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {Surface} surface
   */
  constructor(canvas, surface) {
    this.canvas = canvas;
    this.surface = surface;
    this.exaggeration = 1; // of heights
    this.target = [0, 0, 0];
    this.distance = 1;
    this.bearing = 0; // of what is up on the screen, degrees from north
    this.tilt = 0; // degrees from looking straight down
    this.eye = [0, 0, 1];
    this.toScreen = m4.identity();
    this.fromScreen = m4.identity();
  }

  /** The whole surface, from the south. */
  reset() {
    const {surface, canvas} = this;
    const ratio = Math.min(canvas.clientWidth / canvas.clientHeight, 1.6);
    this.target = [0, 0, this.heightAt(0, 0)];
    this.distance = (0.62 * Math.max(surface.depth * 1.05, surface.width / ratio)) / Math.tan(FIELD / 2);
    this.bearing = 0;
    this.tilt = 50;
  }

  fromAbove() {
    this.tilt = 0.01;
  }

  /** @param {number} factor - of heights */
  exaggerate(factor) {
    this.target[2] *= factor / this.exaggeration;
    this.exaggeration = factor;
  }

  /**
   * @param {number} factor - of the distance
   * @param {number[]} fixed - the place that stays where it is on the screen
   */
  zoom(factor, fixed) {
    this.target = this.target.map((value, i) => fixed[i] + (value - fixed[i]) * factor);
    this.distance *= factor;
  }

  /**
   * @param {number} bearing - degrees
   * @param {number} tilt - degrees
   */
  turn(bearing, tilt) {
    this.bearing = (this.bearing + bearing + 360) % 360;
    this.tilt += tilt;
  }

  /**
   * Steps to the right and forward, as they are on the screen.
   * @param {number} right
   * @param {number} forward
   */
  step(right, forward) {
    const a = radians(this.bearing);
    const metres = this.distance * 0.06;
    this.shift(
      metres * (right * Math.cos(a) + forward * Math.sin(a)),
      metres * (forward * Math.cos(a) - right * Math.sin(a)),
    );
  }

  /**
   * @param {number} east - m
   * @param {number} north - m
   */
  shift(east, north) {
    this.target[0] += east;
    this.target[1] += north;
  }

  /** Bring the camera within its limits, and compute what it sees. */
  look() {
    const {surface, canvas} = this;
    const {extent, finest} = surface;
    this.tilt = Math.min(Math.max(this.tilt, 0.01), 88);
    this.distance = Math.min(Math.max(this.distance, 3 * finest), 4 * extent);
    const [x, y, z] = this.target;
    this.target = [Math.min(Math.max(x, -extent), extent), Math.min(Math.max(y, -extent), extent), z];
    this.eye = Array.from(v3.add(this.target, v3.mulScalar(this.#towardsEye(), this.distance)));
    const least = this.heightAt(this.eye[0], this.eye[1]) + 2 * finest;
    if (this.eye[2] < least) {
      // Never under the ground.
      this.target[2] += least - this.eye[2];
      this.eye[2] = least;
    }
    const far = this.distance + 2 * extent + 2 * surface.top * this.exaggeration;
    const near = Math.max(
      Math.min(this.distance / 20, this.eye[2] - this.heightAt(this.eye[0], this.eye[1])),
      far / 20000,
    );
    const bearing = radians(this.bearing);
    const up = [Math.sin(bearing), Math.cos(bearing), 0.001];
    const projection = m4.perspective(FIELD, canvas.clientWidth / canvas.clientHeight, near, far);
    this.toScreen = m4.multiply(projection, m4.inverse(m4.lookAt(this.eye, this.target, up)));
    this.fromScreen = m4.inverse(this.toScreen);
  }

  #towardsEye() {
    const tilt = radians(this.tilt);
    const bearing = radians(this.bearing);
    return [-Math.sin(bearing) * Math.sin(tilt), -Math.cos(bearing) * Math.sin(tilt), Math.cos(tilt)];
  }

  /**
   * The surface's height as it is drawn, m.
   * @param {number} x - m east of the middle
   * @param {number} y - m north of it
   */
  heightAt(x, y) {
    const [column, row] = this.surface.cell(x, y);
    return this.surface.height(column, row) * this.exaggeration;
  }

  /** @param {number} distance - m from the eye */
  pixelsPerMetre(distance) {
    return this.canvas.clientHeight / (2 * Math.tan(FIELD / 2) * distance);
  }

  /** Half-spaces that hold what is seen: four numbers each, positive inside, in metres. */
  planes() {
    return [0, 1, 2].flatMap((axis) =>
      [1, -1].map((sign) => {
        const plane = [0, 1, 2, 3].map((i) => this.toScreen[4 * i + 3] + sign * this.toScreen[4 * i + axis]);
        const length = Math.hypot(plane[0], plane[1], plane[2]);
        return plane.map((value) => value / length);
      }),
    );
  }

  /**
   * Where a cell is on the screen, px; null behind the eye.
   * @param {number} column
   * @param {number} row
   */
  onScreen(column, row) {
    const m = this.toScreen;
    const [x, y] = this.surface.place(column, row);
    const z = this.surface.height(column, row) * this.exaggeration;
    if (m[3] * x + m[7] * y + m[11] * z + m[15] <= 0) return null;
    const [u, v] = m4.transformPoint(m, [x, y, z]);
    return [((u + 1) / 2) * this.canvas.clientWidth, ((1 - v) / 2) * this.canvas.clientHeight];
  }

  /**
   * The ray of a pixel: where it begins, and its direction of length 1.
   * @param {number} x - px
   * @param {number} y - px
   * @returns {[number[], number[]]}
   */
  ray(x, y) {
    const at = [(2 * x) / this.canvas.clientWidth - 1, 1 - (2 * y) / this.canvas.clientHeight];
    const [near, far] = [-1, 1].map((z) => m4.transformPoint(this.fromScreen, [...at, z]));
    return [Array.from(near), Array.from(v3.normalize(v3.subtract(far, near)))];
  }

  /**
   * Where a pixel's ray meets a level plane, m; null at or above the horizon.
   * @param {number} x - px
   * @param {number} y - px
   * @param {number} z - of the plane, m
   */
  onPlane(x, y, z) {
    const [from, way] = this.ray(x, y);
    if (way[2] > -0.02) return null;
    const t = (z - from[2]) / way[2];
    return [from[0] + way[0] * t, from[1] + way[1] * t];
  }
}
