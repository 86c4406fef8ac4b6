import {CHUNK, STEPS} from "./chunks.js";

/** @import {ProgramInfo} from "twgl.js" */
/** @import {SeenChunk} from "./chunks.js" */

/** The squares of chunks of one step, which the graphics card draws for many chunks at once. */
class Lattice {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {ProgramInfo} program
   * @param {number} step - cells along the squares' sides
   * @param {number} most - chunks
   */
  constructor(gl, program, step, most) {
    this.gl = gl;
    this.origin = new Float32Array(2 * most);
    this.edge = new Float32Array(4 * most);
    this.drawn = 0;
    const {corners, triangles} = squares(step);
    this.count = triangles.length;
    const eachChunk = {divisor: 1, drawType: gl.DYNAMIC_DRAW};
    this.buffers = twgl.createBufferInfoFromArrays(gl, {
      corner: {numComponents: 2, data: new Float32Array(corners)},
      origin: {numComponents: 2, data: new Float32Array(2 * most), ...eachChunk},
      edge: {numComponents: 4, data: new Float32Array(4 * most), ...eachChunk},
      indices: {numComponents: 3, data: new Uint16Array(triangles)},
    });
    this.vertices = twgl.createVertexArrayInfo(gl, program, this.buffers);
  }

  /** @param {SeenChunk} seen */
  add({chunk, edges}) {
    this.origin.set(chunk.origin, 2 * this.drawn);
    this.edge.set(edges, 4 * this.drawn++);
  }

  draw() {
    const {gl, drawn} = this;
    const {origin, edge} = this.buffers.attribs ?? {};
    twgl.setAttribInfoBufferFromArray(gl, origin, this.origin.subarray(0, 2 * drawn));
    twgl.setAttribInfoBufferFromArray(gl, edge, this.edge.subarray(0, 4 * drawn));
    gl.bindVertexArray(this.vertices.vertexArrayObject ?? null);
    twgl.drawBufferInfo(gl, this.vertices, gl.TRIANGLES, this.count, 0, drawn);
  }
}

export class Lattices {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {ProgramInfo} program
   * @param {number} most - chunks
   */
  constructor(gl, program, most) {
    this.all = STEPS.map((step) => new Lattice(gl, program, step, most));
  }

  /** @param {SeenChunk[]} chunks */
  draw(chunks) {
    for (const lattice of this.all) lattice.drawn = 0;
    for (const seen of chunks) this.all[STEPS.indexOf(seen.chunk.step)].add(seen);
    for (const lattice of this.all) if (lattice.drawn) lattice.draw();
  }
}

/**
 * The corners of a chunk's squares, in cells, and two triangles for each square.
 * @param {number} step - cells along the squares' sides
 */
function squares(step) {
  const side = CHUNK / step;
  const corners = [];
  const triangles = [];
  for (let r = 0; r <= side; r++) for (let c = 0; c <= side; c++) corners.push(c * step, r * step);
  for (let r = 0; r < side; r++) {
    for (let c = 0; c < side; c++) {
      const a = r * (side + 1) + c;
      const b = a + 1;
      const d = a + side + 1;
      triangles.push(a, d, b, b, d, d + 1);
    }
  }
  return {corners, triangles};
}
