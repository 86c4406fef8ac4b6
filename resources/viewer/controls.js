import {byId, inputOf} from "./elements.js";
import {held} from "./picking.js";

/** @import {Drawing} from "./drawing.js" */
/** @import {Legend} from "./legend.js" */
/** @import {Profile} from "./profile.js" */
const ZOOM = 0.85;
const TURN_KEY = 5; // degrees

/**
 * The sliders and the switch of the panel.
 * @param {Drawing} drawing
 */
export function addSliders(drawing) {
  const {camera, sun} = drawing;
  inputOf("shade").addEventListener("change", () => {
    drawing.shade = inputOf("shade").checked;
    drawing.draw();
  });
  /** @type {[string, string, (value: number) => void][]} */
  const sliders = [
    ["azimuth", "°", (value) => Object.assign(sun, {azimuth: value})],
    ["altitude", "°", (value) => Object.assign(sun, {altitude: value})],
    ["exaggeration", "×", (value) => camera.exaggerate(value)],
  ];
  for (const [id, unit, set] of sliders) {
    const slide = () => {
      const {value} = inputOf(id);
      set(Number(value));
      byId(`${id}-text`).textContent = `${Number(value)}${unit}`;
      drawing.draw();
    };
    inputOf(id).addEventListener("input", slide);
    slide();
  }
}

/**
 * Buttons and keys.
 * @param {Drawing} drawing
 * @param {Profile} profile
 * @param {Legend} legend
 */
export function addActions(drawing, profile, legend) {
  const {camera} = drawing;
  const {canvas} = camera;
  /** @param {() => void} change - of the camera */
  const seen = (change) => {
    change();
    drawing.draw();
  };
  /** @param {number} factor */
  const zoom = (factor) => camera.zoom(factor, held(camera, canvas.clientWidth / 2, canvas.clientHeight / 2));
  /**
   * @param {number} right
   * @param {number} up
   * @returns {(turns: boolean) => void}
   */
  const arrow = (right, up) => (turns) =>
    seen(() => (turns ? camera.turn(TURN_KEY * right, TURN_KEY * up) : camera.step(right, up)));
  const reset = () => seen(() => camera.reset());
  const fromAbove = () => seen(() => camera.fromAbove());
  const closer = () => seen(() => zoom(ZOOM));
  const toggle = () => profile.switch(!profile.on);
  const close = () => profile.switch(false);
  /** @type {Record<string, (shift: boolean) => void>} */
  const keys = {
    ArrowLeft: arrow(-1, 0),
    ArrowRight: arrow(1, 0),
    ArrowUp: arrow(0, 1),
    ArrowDown: arrow(0, -1),
    "+": closer,
    "=": closer,
    "-": () => seen(() => zoom(1 / ZOOM)),
    r: reset,
    t: fromAbove,
    n: () => seen(() => camera.turn(-camera.bearing, 0)),
    p: toggle,
    Escape: close,
  };
  byId("reset").addEventListener("click", reset);
  byId("above").addEventListener("click", fromAbove);
  byId("profile").addEventListener("click", toggle);
  byId("close").addEventListener("click", close);
  document.addEventListener("keydown", (event) => {
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    // Arrows are a slider's, or those of the choice of what is shown.
    const owner = event.target instanceof HTMLInputElement && key.startsWith("Arrow");
    if (event.ctrlKey || event.altKey || event.metaKey || owner) return;
    const index = Number(key) - 1;
    if (legend.layers[index]) legend.show(index);
    else if (Object.hasOwn(keys, key)) {
      event.preventDefault();
      keys[key](event.shiftKey);
    }
  });
}
