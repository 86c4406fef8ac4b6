// What a page of 'repm:viewer' does. 'viewer/script.py' puts this module and all that it imports into the page.
import {Camera} from "./camera.js";
import {forgetText, readFacts, readLayers, readSurface} from "./contents.js";
import {addActions, addSliders} from "./controls.js";
import {Drawing} from "./drawing.js";
import {byId, select} from "./elements.js";
import {Gestures} from "./gestures.js";
import {Legend} from "./legend.js";
import {showOrientation} from "./orientation.js";
import {Profile} from "./profile.js";
import {Texts} from "./texts.js";

/** @import {Facts, Layer, Words} from "./contents.js" */
/** @import {Surface} from "./surface.js" */

/** @param {string} text - "" for none */
function say(text) {
  byId("message").hidden = !text;
  byId("message").textContent = text;
}

/** @param {string} text */
function giveUp(text) {
  say(text);
  document.body.classList.add("empty");
}

/**
 * What draws on the canvas; null where this browser cannot draw the surface or read it.
 * @param {HTMLCanvasElement} canvas
 * @param {Facts} facts
 */
function context(canvas, facts) {
  const gl = canvas.getContext("webgl2", {antialias: true, alpha: false});
  if (!gl || typeof DecompressionStream === "undefined") return null;
  return gl.getParameter(gl.MAX_TEXTURE_SIZE) < Math.max(...facts.size) ? null : gl;
}

/**
 * @param {WebGL2RenderingContext} gl
 * @param {HTMLCanvasElement} canvas
 * @param {{facts: Facts, words: Words, surface: Surface, layers: Layer[]}} contents
 */
function show(gl, canvas, {facts, words, surface, layers}) {
  const camera = new Camera(canvas, surface);
  const drawing = new Drawing(gl, facts, surface, camera, layers[0]);
  const texts = new Texts(facts, words, surface);
  const profile = new Profile(drawing, texts);
  const legend = new Legend(drawing, layers);
  new Gestures(drawing, profile, texts);
  addSliders(drawing);
  addActions(drawing, profile, legend);
  drawing.overlays.push(
    () => showOrientation(camera),
    () => profile.drawMarks(),
  );
  window.addEventListener("resize", () => {
    profile.drawChart();
    drawing.draw();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawing.draw());
  if (window.innerWidth <= 640) select(HTMLDetailsElement, byId("panel"), "details").open = false;
  say("");
  camera.reset();
  legend.show(0);
  drawing.begin(() => {
    document.documentElement.dataset.ready = String(Math.round(performance.now()));
  });
}

async function start() {
  const {facts, words} = readFacts();
  const canvas = select(HTMLCanvasElement, document, "#view");
  const gl = context(canvas, facts);
  if (!gl) return giveUp(words.webgl);
  canvas.addEventListener("webglcontextlost", () => giveUp(words.lost));
  let surface;
  let layers;
  try {
    surface = await readSurface(facts);
    layers = await readLayers(facts, words);
  } catch {
    return giveUp(words.damaged);
  }
  forgetText();
  show(gl, canvas, {facts, words, surface, layers});
}

start();
