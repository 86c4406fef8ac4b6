/** @import {Layer} from "./contents.js" */
/** @import {Surface} from "./surface.js" */

/** The surface and its layers as pictures for the graphics card. */
export class Textures {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {Surface} surface
   */
  constructor(gl, surface) {
    this.gl = gl;
    this.size = {width: surface.columns, height: surface.rows};
    this.plain = {wrap: gl.CLAMP_TO_EDGE, unpackAlignment: 1};
    this.smooth = {...this.plain, min: gl.LINEAR_MIPMAP_LINEAR, mag: gl.LINEAR, auto: true};
    this.heights = twgl.createTexture(gl, {
      ...this.plain,
      ...this.size,
      minMag: gl.NEAREST,
      src: surface.levels,
      auto: false,
      internalFormat: gl.R16UI,
      format: gl.RED_INTEGER,
      type: gl.UNSIGNED_SHORT,
    });
    this.normals = twgl.createTexture(gl, {...this.smooth, ...this.size, src: normals(surface)});
    /** @type {Map<Layer, {draped: WebGLTexture, ramp: WebGLTexture}>} */
    this.layers = new Map();
  }

  /**
   * What is draped, and the colours of its values; the normals for want of either. Made when a layer is first shown.
   * @param {Layer} layer
   */
  of(layer) {
    const made = this.layers.get(layer) ?? {draped: this.#draped(layer), ramp: this.#ramp(layer.ramp)};
    this.layers.set(layer, made);
    return made;
  }

  /** @param {Layer} layer */
  #draped({picture, values}) {
    const {gl, smooth, size} = this;
    if (picture) return twgl.createTexture(gl, {...smooth, src: picture});
    if (!values) return this.normals;
    const pairs = new Uint8Array(2 * values.length); // the value, and whether there is one: means of both are right
    for (let i = 0; i < values.length; i++) {
      pairs[2 * i] = values[i];
      pairs[2 * i + 1] = values[i] ? 255 : 0;
    }
    return twgl.createTexture(gl, {...smooth, ...size, src: pairs, internalFormat: gl.RG8, format: gl.RG});
  }

  /** @param {string[]} colours - each "#rrggbb" */
  #ramp(colours) {
    const {gl, plain} = this;
    if (!colours.length) return this.normals;
    const bytes = colours.flatMap((text) => [1, 3, 5].map((i) => Number.parseInt(text.slice(i, i + 2), 16)));
    return twgl.createTexture(gl, {
      ...plain,
      min: gl.LINEAR,
      mag: gl.LINEAR,
      src: new Uint8Array(bytes),
      width: colours.length,
      height: 1,
      internalFormat: gl.RGB8,
      format: gl.RGB,
    });
  }
}

/**
 * The east and north parts of the cells' normals, and whether cells have a height (the fourth byte). The parts' roots
 * are stored: 8 bit are fine near flat ground.
 * @param {Surface} surface
 */
function normals({columns, rows, levels, known, quantum, cellX, cellY}) {
  const found = new Uint8Array(columns * rows * 4);
  const byX = quantum / cellX;
  const byY = quantum / cellY;
  /** @param {number} part */
  const byte = (part) => 127.5 + 127.5 * Math.sign(part) * Math.sqrt(Math.abs(part)) + 0.5;
  for (let row = 0, i = 0; row < rows; row++) {
    const up = row ? columns : 0;
    const down = row < rows - 1 ? columns : 0;
    const spanY = byY / Math.max((up + down) / columns, 1);
    for (let column = 0; column < columns; column++, i++) {
      const left = column ? 1 : 0;
      const right = column < columns - 1 ? 1 : 0;
      const x = ((levels[i - left] - levels[i + right]) * byX) / Math.max(left + right, 1);
      const y = (levels[i + down] - levels[i - up]) * spanY;
      const steep = 1 / Math.sqrt(1 + x * x + y * y);
      found[4 * i] = byte(x * steep);
      found[4 * i + 1] = byte(y * steep);
      found[4 * i + 3] = known[i] ? 255 : 0;
    }
  }
  return found;
}
