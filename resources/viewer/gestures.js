import {byId} from "./elements.js";
import {held, pick} from "./picking.js";

/** @import {Drawing} from "./drawing.js" */
/** @import {Profile} from "./profile.js" */
/** @import {Texts} from "./texts.js" */
const CLICK_PX = 5; // that a pointer may move in a click
const TURN = 0.3; // degrees for each pixel
const TILT = 0.25; // of two fingers
const LINE_PX = 30; // of a wheel that counts in lines
const MOST_WHEEL_PX = 300;

/** Mouse, pen and fingers on the surface. */
export class Gestures {
  /**
   * @param {Drawing} drawing
   * @param {Profile} profile
   * @param {Texts} texts
   */
  constructor(drawing, profile, texts) {
    this.drawing = drawing;
    this.camera = drawing.camera;
    this.profile = profile;
    this.texts = texts;
    this.hint = byId("status").textContent;
    /** Pointers that are down, by their numbers. @type {Map<number, {x: number, y: number}>} */
    this.fingers = new Map();
    /** What may become a click. @type {{x: number, y: number, button: number} | null} */
    this.pressed = null;
    this.grabbed = [0, 0, 0]; // what is held, m
    this.turning = false;
    /** Where the pointer was last. @type {[number, number] | null} */
    this.pointing = null;
    const {canvas} = this.camera;
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("pointerdown", (event) => this.#press(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    canvas.addEventListener("pointerup", (event) => this.#release(event));
    canvas.addEventListener("pointercancel", (event) => this.#release(event));
    canvas.addEventListener("wheel", (event) => this.#roll(event), {passive: false});
  }

  /** @param {PointerEvent} event */
  #press(event) {
    const {clientX: x, clientY: y, button} = event;
    this.camera.canvas.setPointerCapture(event.pointerId);
    this.fingers.set(event.pointerId, {x, y});
    this.pressed = this.fingers.size === 1 ? {x, y, button} : null;
    this.turning = button !== 0 || event.ctrlKey || event.shiftKey || event.metaKey;
    this.grabbed = held(this.camera, x, y);
  }

  /** @param {PointerEvent} event */
  #move({pointerId, clientX: x, clientY: y}) {
    const finger = this.fingers.get(pointerId);
    if (!finger) return this.#tell(x, y);
    if (this.fingers.size === 2) return this.#pinch(finger, x, y);
    if (this.pressed && Math.hypot(x - this.pressed.x, y - this.pressed.y) > CLICK_PX) this.pressed = null;
    if (this.fingers.size > 1 || this.pressed) return;
    if (this.turning) {
      this.camera.turn((x - finger.x) * TURN, (finger.y - y) * TURN);
      this.drawing.draw();
    } else this.#drag(x, y);
    Object.assign(finger, {x, y});
  }

  /**
   * What is held stays under the pointer.
   * @param {number} x - px
   * @param {number} y - px
   */
  #drag(x, y) {
    const [east, north, up] = this.grabbed;
    const place = this.camera.onPlane(x, y, up);
    if (!place) return;
    this.camera.shift(east - place[0], north - place[1]);
    this.camera.look();
    this.drawing.draw();
  }

  /**
   * @param {{x: number, y: number}} finger - of two, the one that has moved
   * @param {number} x - px
   * @param {number} y - px
   */
  #pinch(finger, x, y) {
    const before = this.#between();
    Object.assign(finger, {x, y});
    const after = this.#between();
    this.#zoom(before.far / Math.max(after.far, 1), after.x, after.y);
    this.camera.turn(((before.angle - after.angle) * 180) / Math.PI, (before.y - after.y) * TILT);
  }

  /** The middle of two fingers (px), how far apart they are, and the direction from one to the other. */
  #between() {
    const [a, b] = [...this.fingers.values()];
    const [dx, dy] = [b.x - a.x, b.y - a.y];
    return {x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, far: Math.hypot(dx, dy), angle: Math.atan2(dy, dx)};
  }

  /** @param {PointerEvent} event */
  #release({pointerId, type, clientX: x, clientY: y}) {
    this.fingers.delete(pointerId);
    if (this.fingers.size === 1) {
      const [rest] = this.fingers.values();
      this.grabbed = held(this.camera, rest.x, rest.y);
    }
    if (this.pressed && type === "pointerup" && this.pressed.button === 0) {
      this.#tell(x, y);
      const at = this.profile.on ? pick(this.camera, x, y) : null;
      if (at) this.profile.addEnd(at);
    }
    this.pressed = null;
  }

  /** @param {WheelEvent} event */
  #roll(event) {
    event.preventDefault();
    const pixels = event.deltaY * (event.deltaMode === WheelEvent.DOM_DELTA_LINE ? LINE_PX : 1);
    const limited = Math.min(Math.max(pixels, -MOST_WHEEL_PX), MOST_WHEEL_PX);
    this.#zoom(Math.exp(limited * 0.0015), event.clientX, event.clientY);
  }

  /**
   * @param {number} factor - of the distance
   * @param {number} x - px
   * @param {number} y - px
   */
  #zoom(factor, x, y) {
    this.camera.zoom(factor, held(this.camera, x, y));
    this.drawing.draw();
  }

  /**
   * Say what is under the pointer, once for each picture.
   * @param {number} x - px
   * @param {number} y - px
   */
  #tell(x, y) {
    const waiting = this.pointing !== null;
    this.pointing = [x, y];
    if (waiting) return;
    requestAnimationFrame(() => {
      const at = this.pointing && pick(this.camera, ...this.pointing);
      this.pointing = null;
      byId("status").textContent = at ? this.texts.place(at, this.drawing.layer) : this.hint;
    });
  }
}
