"use strict";
// Draws the shape of each result in its own canvas (WebGL, no library) and creates the files for download.
(() => {
  const VIRIDIS = ["#440154", "#3b528b", "#21918c", "#5ec962", "#fde725"];
  const LINE_SHADE = matchMedia("(prefers-color-scheme: dark)").matches ? 1.0 : 0.5; // centre lines have the colour of the surface, darker on white
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const unzip = (text, type) => new Response(new Blob([bytes(text)]).stream().pipeThrough(new DecompressionStream("gzip")), { headers: { "Content-Type": type } }).blob();
  const positions = (packed) => {
    const steps = new Uint16Array(bytes(packed.points).buffer), found = new Float32Array(steps.length);
    for (let k = 0; k < steps.length; k++) found[k] = packed.origin[k % 3] + packed.scale * steps[k];
    return found;
  };

  function unpack(packed) {
    const shape = { keys: packed.keys, plain: packed.plain, position: positions(packed), faces: new Uint32Array(bytes(packed.faces).buffer), colours: {} };
    shape.normal = normals(shape.position, shape.faces);
    shape.nearest = packed.nearest === undefined ? null : new Uint32Array(bytes(packed.nearest).buffer);
    for (const name of Object.keys(packed.colours)) shape.colours[name] = bytes(packed.colours[name]);
    shape.lines = packed.roots ? positions(packed.roots) : new Float32Array(0);
    shape.counts = packed.roots ? packed.roots.counts : [];
    return shape;
  }

  function normals(position, faces) {
    const sums = new Float32Array(position.length);
    for (let k = 0; k < faces.length; k += 3) {
      const n = facet(position, faces, k);
      for (let i = 0; i < 3; i++) for (let j = 0; j < 3; j++) sums[3 * faces[k + i] + j] += n[j];
    }
    for (let k = 0; k < sums.length; k += 3) {
      const size = Math.hypot(sums[k], sums[k + 1], sums[k + 2]) || 1;
      for (let j = 0; j < 3; j++) sums[k + j] /= size;
    }
    return sums;
  }

  function facet(p, faces, k) { // area vector of the triangle whose corners begin at index k
    const [a, b, c] = [3 * faces[k], 3 * faces[k + 1], 3 * faces[k + 2]];
    const u = [p[b] - p[a], p[b + 1] - p[a + 1], p[b + 2] - p[a + 2]], v = [p[c] - p[a], p[c + 1] - p[a + 1], p[c + 2] - p[a + 2]];
    return [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
  }

  function vertexColours(shape, by) { // 0 to 255, three for each vertex
    const count = shape.position.length / 3, found = new Uint8Array(3 * count), table = shape.colours[by];
    for (let k = 0; k < count; k++) {
      const from = table ? 3 * (shape.nearest ? shape.nearest[k] : k) : 0;
      for (let j = 0; j < 3; j++) found[3 * k + j] = table ? table[from + j] : shape.plain[j];
    }
    return found;
  }

  function showKey(place, key) {
    place.replaceChildren();
    const add = (className, text, background) => {
      const part = document.createElement("span");
      part.className = className;
      part.textContent = text;
      if (background) part.style.background = background;
      place.append(part);
    };
    if (key && key.ends) {
      add("", key.ends[0]); add("scale", "", `linear-gradient(90deg, ${VIRIDIS.join(", ")})`); add("", key.ends[1]);
    }
    for (const one of (key && key.swatches) || []) { add("swatch", "", `rgb(${one.rgb.join(", ")})`); add("label", one.label); }
  }

  const VERTEX = "attribute vec3 p, n, c; uniform mat4 m; uniform mat3 r; uniform float lit; varying vec3 shade; void main() { gl_Position = m * vec4(p, 1.0);"
    + "float l = 0.45 + 0.55 * abs(dot(normalize(r * n), normalize(vec3(-0.4, 0.6, 0.8)))); shade = c * mix(1.0, l, lit); }";
  const FRAGMENT = "precision mediump float; varying vec3 shade; void main() { gl_FragColor = vec4(shade, 1.0); }";

  function show(box, shape) {
    const canvas = box.querySelector("canvas"), choice = box.querySelector("select"), overlay = box.querySelector("input");
    const gl = canvas.getContext("webgl", { antialias: true, alpha: true, preserveDrawingBuffer: true });
    if (!gl || !gl.getExtension("OES_element_index_uint")) { box.querySelector(".below p").textContent = "This browser cannot draw 3D graphics (WebGL); see the figures below."; return; }
    const program = gl.createProgram();
    for (const [type, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(program, shader);
    }
    gl.linkProgram(program); gl.useProgram(program);
    const all = shape.position.length ? shape.position : shape.lines, low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (let k = 0; k < all.length; k++) { low[k % 3] = Math.min(low[k % 3], all[k]); high[k % 3] = Math.max(high[k % 3], all[k]); }
    const centre = low.map((v, i) => (v + high[i]) / 2), size = Math.hypot(...low.map((v, i) => (high[i] - v) / 2)) || 1;
    const scaled = (points) => points.map((v, k) => (v - centre[k % 3]) / size);
    const place = Object.fromEntries(["p", "n", "c"].map((name) => [name, gl.getAttribLocation(program, name)]));
    const at = scaled(all), uniform = Object.fromEntries(["m", "r", "lit"].map((name) => [name, gl.getUniformLocation(program, name)]));
    const buffer = (values) => { const made = gl.createBuffer(); gl.bindBuffer(gl.ARRAY_BUFFER, made); gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW); return made; };
    const attach = (name, from, type, normalised) => { gl.bindBuffer(gl.ARRAY_BUFFER, from); gl.enableVertexAttribArray(place[name]); gl.vertexAttribPointer(place[name], 3, type, normalised, 0, 0); };
    const surface = { p: buffer(scaled(shape.position)), n: buffer(shape.normal), c: gl.createBuffer(), faces: gl.createBuffer() };
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, surface.faces); gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, shape.faces, gl.STATIC_DRAW);
    const segments = []; // pairs of consecutive points of the same root
    let first = 0;
    for (const count of shape.counts) { for (let k = first; k + 1 < first + count; k++) segments.push(k, k + 1); first += count; }
    const lines = { p: buffer(scaled(shape.lines)), c: gl.createBuffer(), segments: gl.createBuffer() };
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, lines.segments); gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(segments), gl.STATIC_DRAW);
    function paint() {
      gl.bindBuffer(gl.ARRAY_BUFFER, surface.c); gl.bufferData(gl.ARRAY_BUFFER, vertexColours(shape, choice.value), gl.STATIC_DRAW);
      const table = shape.nearest && shape.colours[choice.value], dark = Uint8Array.from(shape.lines, (_, k) => LINE_SHADE * (table ? table[k] : shape.plain[k % 3]));
      gl.bindBuffer(gl.ARRAY_BUFFER, lines.c); gl.bufferData(gl.ARRAY_BUFFER, dark, gl.STATIC_DRAW);
      showKey(box.querySelector(".key"), shape.keys[choice.value]);
      redraw();
    }
    let turn, tilt, near, shift, wanted = false;
    const reset = () => { turn = 0.0; tilt = 0.12; near = 0; shift = [0, 0]; redraw(); };
    const fitting = (rows, width, height) => { // magnification at which the whole shape is visible, with a margin
      let across = 1e-6, up = 1e-6;
      for (let k = 0; k < at.length; k += 3) {
        across = Math.max(across, Math.abs(rows[0][0] * at[k] + rows[0][1] * at[k + 1] + rows[0][2] * at[k + 2]));
        up = Math.max(up, Math.abs(rows[1][0] * at[k] + rows[1][1] * at[k + 1] + rows[1][2] * at[k + 2]));
      }
      return 0.84 * Math.min(1 / (across * Math.min(1, height / width)), 1 / (up * Math.min(1, width / height)));
    };
    function draw() {
      wanted = false;
      const ratio = Math.min(window.devicePixelRatio || 1, 2), width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
      if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
      gl.viewport(0, 0, width, height); gl.clearColor(0, 0, 0, 0); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      const [ct, st, cp, sp] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
      const r = [[-st, ct, 0], [-sp * ct, -sp * st, cp], [cp * ct, cp * st, sp]]; // rows: right, up, towards the eye
      near = near || fitting(r, width, height);
      const across = near * Math.min(1, height / width), up = near * Math.min(1, width / height);
      const m = [], rows = [r[0].map((v) => v * across), r[1].map((v) => v * up), r[2].map((v) => -0.2 * v)];
      for (let column = 0; column < 3; column++) m.push(rows[0][column], rows[1][column], rows[2][column], 0);
      m.push(shift[0], shift[1], 0, 1);
      gl.uniformMatrix4fv(uniform.m, false, m);
      gl.uniformMatrix3fv(uniform.r, false, [0, 1, 2].flatMap((column) => r.map((row) => row[column])));
      gl.enable(gl.DEPTH_TEST); gl.uniform1f(uniform.lit, 1);
      attach("p", surface.p, gl.FLOAT, false); attach("n", surface.n, gl.FLOAT, false); attach("c", surface.c, gl.UNSIGNED_BYTE, true);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, surface.faces); gl.drawElements(gl.TRIANGLES, shape.faces.length, gl.UNSIGNED_INT, 0);
      if (overlay && overlay.checked) { // centre lines, drawn over the surface
        gl.disable(gl.DEPTH_TEST); gl.uniform1f(uniform.lit, 0);
        attach("p", lines.p, gl.FLOAT, false); attach("c", lines.c, gl.UNSIGNED_BYTE, true);
        gl.disableVertexAttribArray(place.n); gl.vertexAttrib3f(place.n, 0, 0, 1);
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, lines.segments); gl.drawElements(gl.LINES, segments.length, gl.UNSIGNED_INT, 0);
      }
      bar(box.querySelector(".bar"), (0.5 * canvas.clientWidth * across) / size);
      canvas.dataset.drawn = String(Number(canvas.dataset.drawn || 0) + 1);
    }
    function redraw() { if (!wanted) { wanted = true; requestAnimationFrame(draw); } }
    const held = new Map();
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); held.set(event.pointerId, [event.clientX, event.clientY]); });
    canvas.addEventListener("pointermove", (event) => {
      const before = held.get(event.pointerId);
      if (!before) return;
      const dx = event.clientX - before[0], dy = event.clientY - before[1];
      if (held.size === 2) {
        const other = [...held].find(([id]) => id !== event.pointerId)[1];
        near *= Math.hypot(event.clientX - other[0], event.clientY - other[1]) / Math.max(Math.hypot(before[0] - other[0], before[1] - other[1]), 1);
      } else if (event.shiftKey || event.buttons === 2) shift = [shift[0] + (2 * dx) / canvas.clientWidth, shift[1] - (2 * dy) / canvas.clientHeight];
      else { turn -= dx / 150; tilt = Math.min(1.57, Math.max(-1.57, tilt + dy / 150)); }
      held.set(event.pointerId, [event.clientX, event.clientY]);
      redraw();
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => held.delete(event.pointerId));
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); near *= Math.exp(-event.deltaY / 600); redraw(); }, { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    choice.addEventListener("change", paint);
    if (overlay) overlay.addEventListener("change", redraw);
    box.querySelector("button").addEventListener("click", reset);
    new ResizeObserver(redraw).observe(canvas);
    window.addEventListener("beforeprint", draw);
    reset(); paint();
  }

  function bar(place, pixelsPerMm) { // the longest scale bar of 1, 2 or 5 times a power of ten that is at most 120 pixels wide
    const most = 120 / pixelsPerMm, power = 10 ** Math.floor(Math.log10(most)), length = [5, 2, 1].map((k) => k * power).find((v) => v <= most);
    place.style.width = `${length * pixelsPerMm}px`;
    place.textContent = `${Number(length.toPrecision(1))} mm`;
  }

  function stl(shape) {
    const count = shape.faces.length / 3, data = new DataView(new ArrayBuffer(84 + 50 * count));
    data.setUint32(80, count, true);
    for (let k = 0; k < count; k++) {
      const n = facet(shape.position, shape.faces, 3 * k), long = Math.hypot(...n) || 1;
      n.forEach((value, i) => data.setFloat32(84 + 50 * k + 4 * i, value / long, true));
      for (let i = 0; i < 3; i++) for (let j = 0; j < 3; j++) data.setFloat32(96 + 50 * k + 12 * i + 4 * j, shape.position[3 * shape.faces[3 * k + i] + j], true);
    }
    return new Blob([data.buffer], { type: "model/stl" });
  }

  function glb(shape, by) { // binary glTF 2.0: metres, y up, colours of vertices linear
    const count = shape.position.length / 3, position = new Float32Array(3 * count), normal = new Float32Array(3 * count), colour = new Uint8Array(4 * count);
    const shown = vertexColours(shape, by), low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (let k = 0; k < count; k++) {
      for (const [to, from, factor] of [[position, shape.position, 1e-3], [normal, shape.normal, 1]]) {
        to[3 * k] = factor * from[3 * k]; to[3 * k + 1] = factor * from[3 * k + 2]; to[3 * k + 2] = -factor * from[3 * k + 1];
      }
      for (let j = 0; j < 3; j++) {
        const value = shown[3 * k + j] / 255; // sRGB to linear
        colour[4 * k + j] = Math.round(255 * (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4));
        low[j] = Math.min(low[j], position[3 * k + j]); high[j] = Math.max(high[j], position[3 * k + j]);
      }
      colour[4 * k + 3] = 255;
    }
    const parts = [position, normal, colour, shape.faces], bufferViews = [];
    let size = 0;
    for (const part of parts) { bufferViews.push({ buffer: 0, byteOffset: size, byteLength: part.byteLength, target: part === shape.faces ? 34963 : 34962 }); size += part.byteLength; }
    const accessors = [
      { bufferView: 0, componentType: 5126, count, type: "VEC3", min: low, max: high }, { bufferView: 1, componentType: 5126, count, type: "VEC3" },
      { bufferView: 2, componentType: 5121, normalized: true, count, type: "VEC4" }, { bufferView: 3, componentType: 5125, count: shape.faces.length, type: "SCALAR" },
    ];
    const primitive = { attributes: { POSITION: 0, NORMAL: 1, COLOR_0: 2 }, indices: 3, material: 0 };
    let text = JSON.stringify({
      asset: { version: "2.0", generator: "rhizotwin" }, scene: 0, scenes: [{ nodes: [0] }], nodes: [{ mesh: 0 }], meshes: [{ primitives: [primitive] }],
      materials: [{ pbrMetallicRoughness: { metallicFactor: 0, roughnessFactor: 1 } }], buffers: [{ byteLength: size }], bufferViews, accessors,
    });
    text += " ".repeat((4 - (text.length % 4)) % 4);
    const words = (...values) => new Uint32Array(values);
    return new Blob([words(0x46546c67, 2, 28 + text.length + size, text.length, 0x4e4f534a), text, words(size, 0x004e4942), ...parts], { type: "model/gltf-binary" });
  }

  for (const box of document.querySelectorAll("[data-result]")) {
    const data = JSON.parse(box.querySelector("script[type='application/json']").textContent);
    const shape = unpack(data.shape), choice = box.querySelector(".solid select");
    show(box.querySelector(".solid"), shape);
    const files = { csv: () => new Blob([data.csv], { type: "text/csv" }), stl: () => stl(shape), glb: () => glb(shape, choice.value), rsml: () => unzip(data.rsml, "application/xml") };
    for (const button of box.querySelectorAll("button[data-file]")) {
      button.addEventListener("click", async () => {
        const link = document.createElement("a");
        link.href = URL.createObjectURL(await files[button.dataset.file]());
        link.download = `${data.file}.${button.dataset.file}`;
        link.click();
        setTimeout(() => URL.revokeObjectURL(link.href), 10000);
      });
    }
  }
})();
