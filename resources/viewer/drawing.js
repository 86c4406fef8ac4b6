import {radians} from "./camera.js";
import {Chunks} from "./chunks.js";
import {Lattices} from "./lattices.js";
import {PIXELS, VERTICES} from "./shaders.js";
import {Textures} from "./textures.js";

/** @import {Camera} from "./camera.js" */
/** @import {Facts, Layer} from "./contents.js" */
/** @import {Surface} from "./surface.js" */
const REST_MS = 300; // after which a slow picture is drawn finely
const COARSE = 0.4; // of the pixels along a side, while a slow picture moves
const SLOW_MS = 80; // of a picture

/** Draws the surface with one layer, lit by the sun. */
export class Drawing {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {Facts} facts
   * @param {Surface} surface
   * @param {Camera} camera
   * @param {Layer} layer - to begin with
   */
  constructor(gl, facts, surface, camera, layer) {
    this.gl = gl;
    this.surface = surface;
    this.camera = camera;
    this.layer = layer;
    this.low = facts.low;
    this.sun = {azimuth: 315, altitude: 45}; // degrees
    this.shade = true;
    /** What is drawn on the picture whenever this is. @type {(() => void)[]} */
    this.overlays = [];
    this.program = twgl.createProgramInfo(gl, [VERTICES, PIXELS]);
    this.textures = new Textures(gl, surface);
    this.chunks = new Chunks(surface);
    this.lattices = new Lattices(gl, this.program, this.chunks.all.length);
    this.waiting = false;
    // Without a graphics card the surface moves coarsely, and is drawn finely once it rests.
    this.slow = false;
    this.moving = 0;
  }

  /** Draw soon. */
  draw() {
    if (this.slow) {
      clearTimeout(this.moving);
      this.moving = setTimeout(() => {
        this.moving = 0;
        this.#paintSoon();
      }, REST_MS);
    }
    if (!this.waiting) {
      this.waiting = true;
      this.#paintSoon();
    }
  }

  #paintSoon() {
    requestAnimationFrame(() => this.#paint());
  }

  /** Call back once the first picture is there, and learn how fast the machine is. @param {() => void} ready */
  begin(ready) {
    this.draw();
    requestAnimationFrame(() => {
      this.#finish();
      ready();
      requestAnimationFrame((start) => {
        // The first picture has compiled the program, too.
        this.#paint();
        this.#finish();
        this.slow = performance.now() - start > SLOW_MS;
      });
    });
  }

  /** Wait until the picture is drawn. */
  #finish() {
    const {gl} = this;
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  }

  #paint() {
    const {gl, camera, program} = this;
    this.waiting = false;
    const detail = Math.min(window.devicePixelRatio || 1, 2) * (this.slow && this.moving ? COARSE : 1);
    this.#resize(detail);
    camera.look();
    gl.clearColor(...background(), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.useProgram(program.program);
    twgl.setUniforms(program, {...this.#placed(), ...this.#painted()});
    this.lattices.draw(this.chunks.seen(camera, detail));
    for (const overlay of this.overlays) overlay();
  }

  /** @param {number} detail - pixels of the picture for each of the page's */
  #resize(detail) {
    const {canvas} = this.camera;
    const width = Math.round(canvas.clientWidth * detail);
    const height = Math.round(canvas.clientHeight * detail);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, {width, height});
    this.gl.viewport(0, 0, width, height);
  }

  /** Of the program's values those that say where vertices are. */
  #placed() {
    const {surface, camera} = this;
    return {
      heights: this.textures.heights,
      seen: camera.toScreen,
      cell: [surface.cellX, surface.cellY],
      middle: surface.middle,
      rise: surface.quantum * camera.exaggeration,
    };
  }

  /** Of the program's values those that say which colours pixels have. */
  #painted() {
    const {layer, surface} = this;
    const azimuth = radians(this.sun.azimuth);
    const altitude = radians(this.sun.altitude);
    return {
      normals: this.textures.normals,
      ...this.textures.of(layer),
      sun: [Math.sin(azimuth) * Math.cos(altitude), Math.cos(azimuth) * Math.cos(altitude), Math.sin(altitude)],
      range: [layer.low, layer.high].map((value) => (value - this.low) / surface.quantum),
      exaggeration: this.camera.exaggeration,
      shading: this.shade ? 1 : 0,
      kind: layer.picture ? 1 : layer.values ? 2 : 0,
    };
  }
}

/**
 * The page's colour.
 * @returns {[number, number, number]}
 */
function background() {
  const found = getComputedStyle(document.body).backgroundColor.match(/\d+/g) ?? [];
  const [red, green, blue] = [0, 1, 2].map((i) => Number(found[i] ?? 0) / 255);
  return [red, green, blue];
}
