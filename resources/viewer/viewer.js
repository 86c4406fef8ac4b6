"use strict";
// Draws the surface of a page of 'repm:viewer'. Places are metres east, north and up of the surface's middle and of its
// least height; cells count from the north-west corner, and heights belong to the cells' centres.
(async () => {
  const {m4, v3} = twgl;
  const CHUNK = 64, STEPS = [1, 2, 4, 8, 16, 32]; // cells along a chunk's side, and along the sides of its squares
  const EDGE_PX = 3, FIELD = 40 * Math.PI / 180; // of squares on the screen; of the camera
  const $ = id => document.getElementById(id);
  const facts = JSON.parse($("facts").textContent), words = JSON.parse($("words").textContent);
  const [columns, rows] = facts.size, [cellX, cellY] = facts.cell_m, {quantum} = facts;
  const middle = [(columns - 1) / 2, (rows - 1) / 2];
  const canvas = $("view"), message = $("message");
  const say = text => { message.hidden = !text; message.textContent = text; };
  const giveUp = text => { say(text); document.body.classList.add("empty"); };

  const gl = canvas.getContext("webgl2", {antialias: true, alpha: false});
  if (!gl || typeof DecompressionStream === "undefined" || gl.getParameter(gl.MAX_TEXTURE_SIZE) < Math.max(columns, rows)) {
    return giveUp(words.webgl);
  }
  canvas.addEventListener("webglcontextlost", () => giveUp(words.lost));

  // What the page holds ---------------------------------------------------------------------------------------------

  async function inflated(text) {
    let packed;
    if (Uint8Array.fromBase64) packed = Uint8Array.fromBase64(text);
    else {
      const letters = atob(text);
      packed = new Uint8Array(letters.length);
      for (let i = 0; i < letters.length; i++) packed[i] = letters.charCodeAt(i);
    }
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  function levelsOf(bytes) {
    const count = columns * rows, found = new Uint16Array(count);
    if (bytes.length !== 2 * count) throw new Error("heights");
    for (let row = 0, i = 0; row < rows; row++) {
      let level = row ? found[i - columns] : 0;
      for (const end = i + columns; i < end; i++) found[i] = level = level + bytes[i] + (bytes[count + i] << 8);
    }
    return found;
  }

  function maskOf(bits) {
    const found = new Uint8Array(columns * rows).fill(1);
    if (bits) for (let i = 0; i < found.length; i++) found[i] = bits[i >> 3] >> (7 - (i & 7)) & 1;
    return found;
  }

  let levels, known;
  const drapes = [];
  try {
    levels = levelsOf(await inflated(facts.heights));
    known = maskOf(facts.mask && await inflated(facts.mask));
    for (const layer of facts.layers) {
      const drape = {...layer};
      if (layer.values) drape.values = await inflated(layer.values);
      if (layer.picture) {
        drape.picture = new Image();
        drape.picture.src = "data:image/jpeg;base64," + layer.picture;
        await drape.picture.decode();
      }
      drapes.push(drape);
    }
  } catch (error) {
    return giveUp(words.damaged);
  }
  for (const name of ["facts", "words"]) $(name).remove(); // the text is no longer needed

  const zOf = level => level * quantum;
  // The height between the centres of cells, in metres above the least; cells without a height have one to interpolate.
  function surfaceAt(column, row) {
    const c = Math.min(Math.max(column, 0), columns - 1), r = Math.min(Math.max(row, 0), rows - 1);
    const c0 = Math.min(c | 0, Math.max(columns - 2, 0)), r0 = Math.min(r | 0, Math.max(rows - 2, 0));
    const u = c - c0, v = r - r0, i = r0 * columns + c0, right = columns > 1 ? 1 : 0, down = rows > 1 ? columns : 0;
    const top = levels[i] * (1 - u) + levels[i + right] * u;
    const low = levels[i + down] * (1 - u) + levels[i + down + right] * u;
    return zOf(top * (1 - v) + low * v);
  }
  const isKnown = (column, row) => {
    const c = Math.round(column), r = Math.round(row);
    return c >= 0 && r >= 0 && c < columns && r < rows && known[r * columns + c] === 1;
  };

  // Pictures for the graphics card ----------------------------------------------------------------------------------

  // The slopes as the east and north parts of the normal, whose roots are stored: 8 bit are fine near flat ground.
  function normals() {
    const found = new Uint8Array(columns * rows * 4);
    const byX = quantum / cellX, byY = quantum / cellY;
    for (let row = 0, i = 0; row < rows; row++) {
      const up = row ? columns : 0, down = row < rows - 1 ? columns : 0, spanY = byY / Math.max((up + down) / columns, 1);
      for (let column = 0; column < columns; column++, i++) {
        const left = column ? 1 : 0, right = column < columns - 1 ? 1 : 0;
        const x = (levels[i - left] - levels[i + right]) * byX / Math.max(left + right, 1);
        const y = (levels[i + down] - levels[i - up]) * spanY;
        const steep = 1 / Math.sqrt(1 + x * x + y * y), at = 4 * i;
        found[at] = 127.5 + 127.5 * Math.sign(x) * Math.sqrt(Math.abs(x) * steep) + 0.5;
        found[at + 1] = 127.5 + 127.5 * Math.sign(y) * Math.sqrt(Math.abs(y) * steep) + 0.5;
        found[at + 3] = known[i] ? 255 : 0;
      }
    }
    return found;
  }

  const plain = {wrap: gl.CLAMP_TO_EDGE, unpackAlignment: 1};
  const smooth = {...plain, min: gl.LINEAR_MIPMAP_LINEAR, mag: gl.LINEAR, auto: true};
  function textureOf(drape) {
    if (drape.picture) return twgl.createTexture(gl, {...smooth, src: drape.picture});
    if (!drape.values) return null;
    const pairs = new Uint8Array(2 * drape.values.length); // the value, and whether there is one: means of both are right
    drape.values.forEach((value, i) => { if (value) { pairs[2 * i] = value; pairs[2 * i + 1] = 255; } });
    return twgl.createTexture(gl, {...smooth, src: pairs, width: columns, height: rows, internalFormat: gl.RG8, format: gl.RG});
  }
  const rgb = text => [1, 3, 5].map(i => parseInt(text.slice(i, i + 2), 16));
  const rampOf = colours => colours && twgl.createTexture(gl, {
    ...plain, min: gl.LINEAR, mag: gl.LINEAR, src: new Uint8Array(colours.flatMap(rgb)), width: colours.length, height: 1,
    internalFormat: gl.RGB8, format: gl.RGB,
  });
  const heightsTexture = twgl.createTexture(gl, {
    ...plain, minMag: gl.NEAREST, src: levels, width: columns, height: rows, auto: false,
    internalFormat: gl.R16UI, format: gl.RED_INTEGER, type: gl.UNSIGNED_SHORT,
  });
  const normalsTexture = twgl.createTexture(gl, {...smooth, src: normals(), width: columns, height: rows});
  for (const drape of drapes) {
    drape.colours = rampOf(drape.ramp);
    drape.title = words[drape.kind];
  }

  const program = twgl.createProgramInfo(gl, [`#version 300 es
    precision highp float;
    uniform highp usampler2D heights;
    uniform mat4 seen;
    uniform vec2 cell, middle;
    uniform float rise;
    in vec2 corner;       // of a chunk's lattice, in cells
    in vec2 origin;       // of the chunk
    in vec4 edge;         // cells between the vertices of its west, east, north and south edge
    out vec2 place;
    out float level;
    void main() {
      vec2 at = corner;
      if (corner.x == 0.0) at.y = floor(corner.y / edge.x) * edge.x;
      if (corner.x == ${CHUNK}.0) at.y = floor(corner.y / edge.y) * edge.y;
      if (corner.y == 0.0) at.x = floor(corner.x / edge.z) * edge.z;
      if (corner.y == ${CHUNK}.0) at.x = floor(corner.x / edge.w) * edge.w;
      ivec2 size = textureSize(heights, 0);
      ivec2 index = min(ivec2(origin + at), size - 1);
      level = float(texelFetch(heights, index, 0).r);
      place = (vec2(index) + 0.5) / vec2(size);
      gl_Position = seen * vec4((float(index.x) - middle.x) * cell.x, (middle.y - float(index.y)) * cell.y, level * rise, 1);
    }`, `#version 300 es
    precision highp float;
    uniform sampler2D normals, draped, ramp;
    uniform vec3 sun;
    uniform vec2 range;   // of the levels that the ramp's colours are spread over
    uniform float exaggeration, shading;
    uniform int kind;     // 0 elevation, 1 picture, 2 values
    in vec2 place;
    in float level;
    out vec4 colour;
    void main() {
      vec4 normal = texture(normals, place);
      vec2 texels = fwidth(place) * vec2(textureSize(normals, 0));
      if (normal.a < mix(0.98, 0.5, clamp(log2(max(max(texels.x, texels.y), 1.0)), 0.0, 1.0))) discard;
      vec2 root = normal.xy * 2.0 - 1.0, level_xy = root * abs(root);
      vec3 bent = normalize(vec3(level_xy / sqrt(max(1.0 - dot(level_xy, level_xy), 1e-4)) * exaggeration, 1.0));
      float light = max(dot(bent, sun), 0.0) / max(sun.z, 0.2);
      vec3 paint;
      if (kind == 0) paint = texture(ramp, vec2((level - range.x) / (range.y - range.x), 0.5)).rgb;
      else if (kind == 1) paint = texture(draped, place).rgb;
      else {
        vec2 found = texture(draped, place).rg;
        paint = found.y < 0.5 ? vec3(0.55) : texture(ramp, vec2((found.x / found.y * 255.0 - 1.0) / 254.0, 0.5)).rgb;
      }
      vec3 dark = paint * (0.4 + 0.6 * min(light, 1.0));
      colour = vec4(mix(paint, dark + (1.0 - dark) * clamp(light - 1.0, 0.0, 1.0) * 0.45, shading), 1.0);
    }`]);

  // Chunks ----------------------------------------------------------------------------------------------------------

  const across = Math.max(Math.ceil((columns - 1) / CHUNK), 1), along = Math.max(Math.ceil((rows - 1) / CHUNK), 1);
  const chunks = [];
  for (let r = 0; r < along; r++) {
    for (let c = 0; c < across; c++) {
      const left = c * CHUNK, top = r * CHUNK;
      const right = Math.min(left + CHUNK, columns - 1), bottom = Math.min(top + CHUNK, rows - 1);
      let low = 65535, high = 0;
      for (let row = top; row <= bottom; row++) {
        for (let i = row * columns + left, end = row * columns + right; i <= end; i++) {
          if (levels[i] < low) low = levels[i];
          if (levels[i] > high) high = levels[i];
        }
      }
      chunks.push({
        origin: [left, top], low: zOf(low), high: zOf(high), step: 1,
        x: ((left + right) / 2 - middle[0]) * cellX, y: (middle[1] - (top + bottom) / 2) * cellY,
        half: [(right - left) / 2 * cellX, (bottom - top) / 2 * cellY],
      });
    }
  }
  const lattices = STEPS.map(step => {
    const side = CHUNK / step, corners = [], triangles = [];
    for (let r = 0; r <= side; r++) for (let c = 0; c <= side; c++) corners.push(c * step, r * step);
    for (let r = 0; r < side; r++) {
      for (let c = 0; c < side; c++) {
        const a = r * (side + 1) + c, b = a + 1, d = a + side + 1;
        triangles.push(a, d, b, b, d, d + 1);
      }
    }
    const most = chunks.length;
    const buffers = twgl.createBufferInfoFromArrays(gl, {
      corner: {numComponents: 2, data: new Float32Array(corners)},
      origin: {numComponents: 2, data: new Float32Array(2 * most), divisor: 1, drawType: gl.DYNAMIC_DRAW},
      edge: {numComponents: 4, data: new Float32Array(4 * most), divisor: 1, drawType: gl.DYNAMIC_DRAW},
      indices: {numComponents: 3, data: new Uint16Array(triangles)},
    });
    return {buffers, vertices: twgl.createVertexArrayInfo(gl, program, buffers), count: 6 * side * side,
            origin: new Float32Array(2 * most), edge: new Float32Array(4 * most), drawn: 0};
  });

  // The camera ------------------------------------------------------------------------------------------------------

  const width = columns * cellX, depth = rows * cellY, top = zOf(levels.reduce((a, b) => Math.max(a, b), 0));
  const extent = Math.hypot(width, depth);
  const camera = {};
  const view = {exaggeration: 1, azimuth: 315, altitude: 45, shade: true, layer: 0};
  function reset() {
    const high = surfaceAt(middle[0], middle[1]) * view.exaggeration, wide = canvas.clientWidth / canvas.clientHeight;
    const distance = 0.62 * Math.max(depth * 1.05, width / Math.min(wide, 1.6)) / Math.tan(FIELD / 2);
    Object.assign(camera, {target: [0, 0, high], distance, bearing: 0, tilt: 50});
    draw();
  }
  const direction = () => {
    const tilt = camera.tilt * Math.PI / 180, bearing = camera.bearing * Math.PI / 180;
    return [-Math.sin(bearing) * Math.sin(tilt), -Math.cos(bearing) * Math.sin(tilt), Math.cos(tilt)];
  };
  const heightAt = (x, y) => surfaceAt(x / cellX + middle[0], middle[1] - y / cellY) * view.exaggeration;

  let eye = [0, 0, 1], seen = m4.identity(), back = m4.identity(), waiting = false;
  function look() {
    camera.tilt = Math.min(Math.max(camera.tilt, 0.01), 88);
    camera.distance = Math.min(Math.max(camera.distance, 3 * Math.min(cellX, cellY)), 4 * extent);
    camera.target = camera.target.map((value, i) => i < 2 ? Math.min(Math.max(value, -extent), extent) : value);
    eye = Array.from(v3.add(camera.target, v3.mulScalar(direction(), camera.distance)));
    const least = heightAt(eye[0], eye[1]) + 2 * Math.min(cellX, cellY);
    if (eye[2] < least) { // never under the ground
      camera.target[2] += least - eye[2];
      eye[2] = least;
    }
    const far = camera.distance + 2 * extent + 2 * top * view.exaggeration;
    const near = Math.max(Math.min(camera.distance / 20, eye[2] - heightAt(eye[0], eye[1])), far / 20000);
    const bearing = camera.bearing * Math.PI / 180, up = [Math.sin(bearing), Math.cos(bearing), 0.001];
    const projection = m4.perspective(FIELD, canvas.clientWidth / canvas.clientHeight, near, far);
    seen = m4.multiply(projection, m4.inverse(m4.lookAt(eye, camera.target, up)));
    back = m4.inverse(seen);
  }
  const pixelsPerMetre = distance => canvas.clientHeight / (2 * Math.tan(FIELD / 2) * distance);

  // Triangles of about EDGE_PX pixels: finer chunks near the eye, and edges between them that have the same vertices.
  function choose() {
    const planes = [0, 1, 2].flatMap(axis => [1, -1].map(sign => {
      const plane = [0, 1, 2, 3].map(i => seen[4 * i + 3] + sign * seen[4 * i + axis]);
      const length = Math.hypot(plane[0], plane[1], plane[2]);
      return plane.map(value => value / length);
    }));
    const ratio = detail(), k = view.exaggeration;
    for (const chunk of chunks) {
      const z = (chunk.low + chunk.high) / 2 * k;
      const radius = Math.hypot(chunk.half[0], chunk.half[1], (chunk.high - chunk.low) / 2 * k);
      const away = Math.max(Math.hypot(chunk.x - eye[0], chunk.y - eye[1], z - eye[2]) - radius, 1e-3);
      const wanted = EDGE_PX / (pixelsPerMetre(away) * ratio * Math.min(cellX, cellY));
      chunk.step = STEPS[Math.min(Math.max(Math.floor(Math.log2(wanted)), 0), STEPS.length - 1)];
      chunk.seen = planes.every(p => p[0] * chunk.x + p[1] * chunk.y + p[2] * z + p[3] > -radius);
    }
    for (const lattice of lattices) lattice.drawn = 0;
    chunks.forEach((chunk, i) => {
      if (!chunk.seen) return;
      const c = i % across, r = (i - c) / across, lattice = lattices[STEPS.indexOf(chunk.step)];
      const beside = [c ? i - 1 : i, c < across - 1 ? i + 1 : i, r ? i - across : i, r < along - 1 ? i + across : i];
      lattice.origin.set(chunk.origin, 2 * lattice.drawn);
      lattice.edge.set(beside.map(other => Math.max(chunk.step, chunks[other].step)), 4 * lattice.drawn++);
    });
  }

  function paint() {
    waiting = false;
    const ratio = detail();
    const size = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    look();
    choose();
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...(getComputedStyle(document.body).backgroundColor.match(/\d+/g) || [0, 0, 0]).slice(0, 3).map(v => v / 255), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.useProgram(program.program);
    const drape = drapes[view.layer], azimuth = view.azimuth * Math.PI / 180, altitude = view.altitude * Math.PI / 180;
    if (drape.texture === undefined) drape.texture = textureOf(drape);
    twgl.setUniforms(program, {
      heights: heightsTexture, normals: normalsTexture, draped: drape.texture || normalsTexture,
      ramp: drape.colours || normalsTexture, seen, cell: [cellX, cellY], middle, rise: quantum * view.exaggeration,
      sun: [Math.sin(azimuth) * Math.cos(altitude), Math.cos(azimuth) * Math.cos(altitude), Math.sin(altitude)],
      range: drape.kind === "dsm" ? [drape.low, drape.high].map(value => (value - facts.low) / quantum) : [0, 1],
      exaggeration: view.exaggeration, shading: view.shade ? 1 : 0, kind: drape.picture ? 1 : drape.values ? 2 : 0,
    });
    for (const lattice of lattices) {
      if (!lattice.drawn) continue;
      const {origin, edge} = lattice.buffers.attribs;
      twgl.setAttribInfoBufferFromArray(gl, origin, lattice.origin.subarray(0, 2 * lattice.drawn));
      twgl.setAttribInfoBufferFromArray(gl, edge, lattice.edge.subarray(0, 4 * lattice.drawn));
      gl.bindVertexArray(lattice.vertices.vertexArrayObject);
      twgl.drawBufferInfo(gl, lattice.vertices, gl.TRIANGLES, lattice.count, 0, lattice.drawn);
    }
    $("north").firstElementChild.setAttribute("transform", `scale(1 ${Math.max(Math.cos(camera.tilt * Math.PI / 180), 0.35)}) rotate(${-camera.bearing})`);
    const wanted = 120 / pixelsPerMetre(camera.distance), nice = niceBelow(wanted);
    $("scale").firstElementChild.textContent = nice >= 1000 ? `${nice / 1000} km` : `${nice} m`;
    $("scale").lastElementChild.style.width = `${nice * pixelsPerMetre(camera.distance)}px`;
    drawMarks();
  }
  // Without a graphics card the surface moves coarsely, and is drawn finely once it rests.
  let slow = false, moving = 0;
  const detail = () => Math.min(window.devicePixelRatio || 1, 2) * (slow && moving ? 0.4 : 1);
  function draw() {
    if (slow) {
      clearTimeout(moving);
      moving = setTimeout(() => { moving = 0; requestAnimationFrame(paint); }, 300);
    }
    if (!waiting) {
      waiting = true;
      requestAnimationFrame(paint);
    }
  }
  function niceBelow(value) {
    const power = 10 ** Math.floor(Math.log10(value));
    return +([5, 2, 1].find(digit => digit * power <= value) * power).toPrecision(3);
  }

  // What lies under a pixel -----------------------------------------------------------------------------------------

  function ray(x, y) {
    const at = [2 * x / canvas.clientWidth - 1, 1 - 2 * y / canvas.clientHeight];
    const [near, far] = [-1, 1].map(z => m4.transformPoint(back, [...at, z]));
    return [near, v3.normalize(v3.subtract(far, near))];
  }
  function pick(x, y) {
    const [from, way] = ray(x, y), k = view.exaggeration;
    const cells = t => [(from[0] + way[0] * t) / cellX + middle[0], middle[1] - (from[1] + way[1] * t) / cellY];
    let begin = 0, end = 8 * extent + 2 * top * k;
    for (const [start, speed, low, high] of [
      [from[0], way[0], -middle[0] * cellX, middle[0] * cellX], [from[1], way[1], -middle[1] * cellY, middle[1] * cellY],
      [from[2], way[2], -1, top * k + 1],
    ]) {
      if (Math.abs(speed) < 1e-9) {
        if (start < low || start > high) return null;
        continue;
      }
      const [a, b] = [(low - start) / speed, (high - start) / speed].sort((p, q) => p - q);
      begin = Math.max(begin, a);
      end = Math.min(end, b);
    }
    if (begin > end) return null;
    const above = t => from[2] + way[2] * t - surfaceAt(...cells(t)) * k;
    const flat = Math.max(Math.abs(way[0]) / cellX, Math.abs(way[1]) / cellY, 1e-6);
    const step = Math.max(0.5 / flat > end - begin ? (end - begin) / 8 : 0.5 / flat, 1e-6);
    for (let t = begin, before = above(begin) + 1e-6; t <= end + step; t += step) {
      const now = above(t);
      if (now <= 0 && before > 0) {
        let low = t - step, high = t;
        for (let i = 0; i < 20; i++) above((low + high) / 2) > 0 ? low = (low + high) / 2 : high = (low + high) / 2;
        const [column, row] = cells(high);
        if (isKnown(column, row)) return {column, row, world: [0, 1, 2].map(i => from[i] + way[i] * high)};
      }
      before = now;
    }
    return null;
  }
  const number = (value, decimals) => value.toFixed(decimals);
  const heightText = z => `${number(facts.low + z, 2)} m`;
  const coordinates = (column, row) =>
    `x ${number(facts.corner[0] + (column + 0.5) * facts.step[0], facts.decimals)}, ` +
    `y ${number(facts.corner[1] + (row + 0.5) * facts.step[1], facts.decimals)}`;
  const span = drape => Math.max(Math.min(2 - Math.floor(Math.log10(drape.high - drape.low || 1)), 6), 0);
  function describe(at) {
    const {column, row} = at, drape = drapes[view.layer];
    const parts = [coordinates(column, row), `${words.height} ${heightText(surfaceAt(column, row))}`];
    if (facts.datum) parts[1] += ` (${words.above} ${facts.datum})`;
    const value = drape.values && drape.values[Math.round(row) * columns + Math.round(column)];
    if (value) {
      const sign = value === 1 && drape.kind !== "confidence" ? "≤ " : value === 255 ? "≥ " : "";
      const shown = drape.low + (value - 1) / 254 * (drape.high - drape.low);
      parts.push(`${drape.title} ${sign}${number(shown, Math.max(span(drape) - 1, 1))} m`);
    }
    return parts.join(" · ");
  }

  // The profile -----------------------------------------------------------------------------------------------------

  const profile = {on: false, ends: [], points: [], at: null};
  const SVG = "http://www.w3.org/2000/svg";
  function element(kind, attributes, text) {
    const made = document.createElementNS(SVG, kind);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    if (text !== undefined) made.textContent = text;
    return made;
  }
  function onScreen(column, row) {
    const x = (column - middle[0]) * cellX, y = (middle[1] - row) * cellY;
    const place = [x, y, surfaceAt(column, row) * view.exaggeration];
    const depthOf = seen[3] * x + seen[7] * y + seen[11] * place[2] + seen[15];
    if (depthOf <= 0) return null;
    const [u, v] = m4.transformPoint(seen, place);
    return [(u + 1) / 2 * canvas.clientWidth, (1 - v) / 2 * canvas.clientHeight];
  }
  function drawMarks() {
    const marks = $("marks");
    marks.replaceChildren();
    const thin = profile.points.filter((_, i) => i % Math.ceil(profile.points.length / 600) === 0);
    let line = "", pen = "M";
    for (const point of thin) {
      const place = isNaN(point.z) ? null : onScreen(point.column, point.row);
      line += place ? `${pen}${place[0].toFixed(1)} ${place[1].toFixed(1)}` : "";
      pen = place ? "L" : "M";
    }
    if (line) for (let i = 0; i < 2; i++) marks.append(element("path", {d: line}));
    for (const end of [...profile.ends, ...(profile.at ? [profile.at] : [])]) {
      const place = onScreen(end.column, end.row);
      if (place) marks.append(element("circle", {cx: place[0], cy: place[1], r: 5}));
    }
  }
  function addEnd(at) {
    if (profile.ends.length === 2) Object.assign(profile, {ends: [], points: [], at: null});
    profile.ends.push(at);
    if (profile.ends.length === 2) {
      const [a, b] = profile.ends, dx = b.column - a.column, dy = b.row - a.row;
      const length = Math.hypot(dx * cellX, dy * cellY), count = Math.min(Math.max(Math.ceil(2 * Math.hypot(dx, dy)), 2), 4000);
      profile.points = Array.from({length: count + 1}, (_, i) => {
        const column = a.column + dx * i / count, row = a.row + dy * i / count;
        return {column, row, distance: length * i / count, z: isKnown(column, row) ? surfaceAt(column, row) : NaN};
      });
    }
    drawChart();
    draw();
  }
  function ticks(low, high, most) {
    let step = niceBelow((high - low) / most || 1);
    while ((high - low) / step > most) step *= 2;
    const found = [];
    for (let value = Math.ceil(low / step) * step; value <= high + 1e-9 * step; value += step) found.push(value);
    return found;
  }
  let chartScale = null;
  function drawChart() {
    const svg = $("chart").querySelector("svg"), points = profile.points;
    $("chart").hidden = !profile.on;
    svg.replaceChildren();
    chartScale = null;
    $("under").textContent = profile.on && points.length === 0 ? profile.ends.length ? words.second : words.first : "";
    const heights = points.map(p => p.z).filter(z => !isNaN(z)).map(z => facts.low + z);
    if (!heights.length) return;
    const box = {left: 58, right: svg.clientWidth - 34, top: 8, bottom: svg.clientHeight - 20};
    let low = Math.min(...heights), high = Math.max(...heights);
    if (high - low < 0.5) [low, high] = [(low + high) / 2 - 0.25, (low + high) / 2 + 0.25];
    const length = points[points.length - 1].distance || 1;
    const x = distance => box.left + distance / length * (box.right - box.left);
    const y = height => box.bottom - (height - low) / (high - low) * (box.bottom - box.top);
    for (const height of ticks(low, high, 5)) {
      svg.append(element("line", {x1: box.left, x2: box.right, y1: y(height), y2: y(height)}),
                 element("text", {x: box.left - 6, y: y(height) + 4, "text-anchor": "end"}, `${+height.toPrecision(8)} m`));
    }
    for (const distance of ticks(0, length, Math.max(box.right - box.left, 100) / 90)) {
      svg.append(element("text", {x: x(distance), y: box.bottom + 15, "text-anchor": "middle"}, `${+distance.toPrecision(8)} m`));
    }
    let path = "", pen = "M";
    for (const point of points) {
      if (isNaN(point.z)) pen = "M";
      else {
        path += `${pen}${x(point.distance).toFixed(1)} ${y(facts.low + point.z).toFixed(1)}`;
        pen = "L";
      }
    }
    svg.append(element("path", {d: path}), element("line", {class: "at", y1: box.top, y2: box.bottom, x1: -9, x2: -9}));
    chartScale = {box, length, x};
    under(points[points.length - 1]);
  }
  function under(point) {
    const height = isNaN(point.z) ? words.none : `${words.height} ${heightText(point.z)}`;
    $("under").textContent = `${words.distance} ${number(point.distance, 1)} m · ${height} · ${coordinates(point.column, point.row)}`;
  }
  $("chart").querySelector("svg").addEventListener("pointermove", event => {
    if (!chartScale) return;
    const {box, length, x} = chartScale, left = event.currentTarget.getBoundingClientRect().left;
    const share = Math.min(Math.max((event.clientX - left - box.left) / (box.right - box.left), 0), 1);
    profile.at = profile.points[Math.round(share * (profile.points.length - 1))];
    const line = $("chart").querySelector("line.at");
    line.setAttribute("x1", x(share * length));
    line.setAttribute("x2", x(share * length));
    under(profile.at);
    drawMarks();
  });
  function setProfile(on) {
    Object.assign(profile, {on, ends: [], points: [], at: null});
    canvas.classList.toggle("profile", on);
    $("profile").setAttribute("aria-pressed", on);
    drawChart();
    draw();
  }

  // Hands -----------------------------------------------------------------------------------------------------------

  const fingers = new Map();
  let grabbed = null, pressed = null, turning = false;
  const onPlane = (x, y, z) => {
    const [from, way] = ray(x, y);
    if (way[2] > -0.02) return null; // at or above the horizon
    const t = (z - from[2]) / way[2];
    return [0, 1].map(i => from[i] + way[i] * t);
  };
  const held = (x, y) => {
    const at = pick(x, y), z = camera.target[2];
    return at ? at.world : [...(onPlane(x, y, z) || camera.target.slice(0, 2)), z];
  };
  function zoom(factor, x, y) {
    const point = held(x, y);
    camera.target = camera.target.map((value, i) => point[i] + (value - point[i]) * factor);
    camera.distance *= factor;
    draw();
  }
  function turn(bearing, tilt) {
    camera.bearing = (camera.bearing + bearing + 360) % 360;
    camera.tilt += tilt;
    draw();
  }
  function move(right, forward) {
    const a = camera.bearing * Math.PI / 180, far = camera.distance * 0.06;
    camera.target[0] += far * (right * Math.cos(a) + forward * Math.sin(a));
    camera.target[1] += far * (forward * Math.cos(a) - right * Math.sin(a));
    draw();
  }
  const between = () => {
    const [a, b] = [...fingers.values()];
    return {x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, far: Math.hypot(b.x - a.x, b.y - a.y), angle: Math.atan2(b.y - a.y, b.x - a.x)};
  };
  canvas.addEventListener("contextmenu", event => event.preventDefault());
  canvas.addEventListener("pointerdown", event => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, {x: event.clientX, y: event.clientY});
    pressed = fingers.size === 1 ? {x: event.clientX, y: event.clientY, button: event.button} : null;
    turning = event.button !== 0 || event.ctrlKey || event.shiftKey || event.metaKey;
    grabbed = held(event.clientX, event.clientY);
  });
  canvas.addEventListener("pointermove", event => {
    const finger = fingers.get(event.pointerId), {clientX: x, clientY: y} = event;
    if (!finger) return point(x, y);
    if (fingers.size === 2) {
      const before = between();
      Object.assign(finger, {x, y});
      const after = between();
      zoom(before.far / Math.max(after.far, 1), after.x, after.y);
      turn((before.angle - after.angle) * 180 / Math.PI, (before.y - after.y) * 0.25);
      return;
    }
    if (pressed && Math.hypot(x - pressed.x, y - pressed.y) > 5) pressed = null;
    if (fingers.size === 1 && !pressed) {
      if (turning) turn((x - finger.x) * 0.3, (finger.y - y) * 0.3);
      else {
        const place = onPlane(x, y, grabbed[2]);
        if (place) {
          camera.target[0] += grabbed[0] - place[0];
          camera.target[1] += grabbed[1] - place[1];
          look();
          draw();
        }
      }
      Object.assign(finger, {x, y});
    }
  });
  function released(event) {
    fingers.delete(event.pointerId);
    if (fingers.size === 1) {
      const [rest] = fingers.values();
      grabbed = held(rest.x, rest.y);
    }
    if (pressed && event.type === "pointerup" && pressed.button === 0) {
      point(event.clientX, event.clientY);
      const at = profile.on && pick(event.clientX, event.clientY);
      if (at) addEnd(at);
    }
    pressed = null;
  }
  canvas.addEventListener("pointerup", released);
  canvas.addEventListener("pointercancel", released);
  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    const lines = event.deltaY * (event.deltaMode === 1 ? 30 : 1);
    zoom(Math.exp(Math.min(Math.max(lines, -300), 300) * 0.0015), event.clientX, event.clientY);
  }, {passive: false});
  let pointing = null;
  const hint = $("status").textContent;
  function point(x, y) {
    if (!pointing) {
      requestAnimationFrame(() => {
        const at = pick(...pointing);
        pointing = null;
        $("status").textContent = at ? describe(at) : hint;
      });
    }
    pointing = [x, y];
  }

  // Buttons and keys ------------------------------------------------------------------------------------------------

  function show(index) {
    view.layer = index;
    const drape = drapes[index];
    document.querySelectorAll("#layers input")[index].checked = true;
    view.shade = $("shade").checked = !drape.picture; // a photo has shadows of its own
    $("legend").hidden = !drape.ramp;
    if (drape.ramp) {
      $("ramp").style.background = `linear-gradient(to right,${drape.ramp.join()})`;
      const decimals = Math.min(span(drape), 2);
      [drape.low, (drape.low + drape.high) / 2, drape.high].forEach((value, i) => {
        $("limits").children[i].textContent = `${number(value, decimals)} m`;
      });
    }
    draw();
  }
  drapes.forEach((drape, index) => {
    const label = document.createElement("label"), choice = document.createElement("input");
    Object.assign(choice, {type: "radio", name: "layer"});
    choice.addEventListener("change", () => show(index));
    label.append(choice, ` ${drape.title}`);
    $("layers").append(label);
  });
  $("shade").addEventListener("change", event => { view.shade = event.target.checked; draw(); });
  for (const [name, text] of [["azimuth", v => `${v}°`], ["altitude", v => `${v}°`], ["exaggeration", v => `${v}×`]]) {
    const slide = () => {
      const before = view.exaggeration;
      view[name] = +$(name).value;
      $(`${name}-text`).textContent = text(view[name]);
      if (camera.target) camera.target[2] *= view.exaggeration / before;
      draw();
    };
    $(name).addEventListener("input", slide);
    if (name !== "exaggeration") slide();
    else $(`${name}-text`).textContent = text(1);
  }
  const fromAbove = () => { camera.tilt = 0.01; draw(); };
  $("reset").addEventListener("click", reset);
  $("above").addEventListener("click", fromAbove);
  $("profile").addEventListener("click", () => setProfile(!profile.on));
  $("close").addEventListener("click", () => setProfile(false));
  const keys = {
    ArrowLeft: s => s ? turn(-5, 0) : move(-1, 0), ArrowRight: s => s ? turn(5, 0) : move(1, 0),
    ArrowUp: s => s ? turn(0, 5) : move(0, 1), ArrowDown: s => s ? turn(0, -5) : move(0, -1),
    "+": () => zoom(0.85, canvas.clientWidth / 2, canvas.clientHeight / 2), "=": () => keys["+"](),
    "-": () => zoom(1 / 0.85, canvas.clientWidth / 2, canvas.clientHeight / 2),
    r: reset, t: fromAbove, n: () => turn(-camera.bearing, 0), p: () => setProfile(!profile.on), Escape: () => setProfile(false),
  };
  document.addEventListener("keydown", event => {
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key, index = +key - 1;
    const owner = event.target.tagName === "INPUT" && key.startsWith("Arrow"); // a slider, or the choice of what is shown
    if (event.ctrlKey || event.altKey || event.metaKey || owner) return;
    if (drapes[index]) show(index);
    else if (keys[key]) {
      event.preventDefault();
      keys[key](event.shiftKey);
    }
  });
  window.addEventListener("resize", () => { drawChart(); draw(); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  if (innerWidth <= 640) document.querySelector("aside details").open = false;

  say("");
  reset();
  show(0);
  const drawn = () => gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); // waits for the picture
  requestAnimationFrame(() => {
    drawn();
    document.documentElement.dataset.ready = Math.round(performance.now());
    requestAnimationFrame(begin => { // the first one has compiled the program, too
      paint();
      drawn();
      slow = performance.now() - begin > 80;
    });
  });
})();
