"use strict";
// Draws the shape of each result in its own canvas (WebGL, no library), and makes the files that can be saved.
(() => {
  const ORDERS = [[0.35, 0.35, 0.35], [0.12, 0.47, 0.71], [0.84, 0.15, 0.16], [0.17, 0.63, 0.17], [0.58, 0.4, 0.74], [1, 0.5, 0.05]];
  const VIRIDIS = [[0.27, 0.0, 0.33], [0.23, 0.32, 0.55], [0.13, 0.57, 0.55], [0.37, 0.79, 0.38], [0.99, 0.91, 0.14]];
  const AROUND = 6, LEAST_KNOWN = 0.25; // as the viewer has them
  const scaled = (share) => {
    const at = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1), k = Math.min(Math.floor(at), VIRIDIS.length - 2), f = at - k;
    return VIRIDIS[k].map((low, i) => low + f * (VIRIDIS[k + 1][i] - low));
  };
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
  const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const unit = (a) => { const size = Math.hypot(...a) || 1; return [a[0] / size, a[1] / size, a[2] / size]; };

  function unpack(packed) {
    const steps = new Uint16Array(bytes(packed.points)), points = [];
    for (let k = 0; k < steps.length; k += 3) points.push([0, 1, 2].map((i) => packed.origin[i] + packed.scale * steps[k + i]));
    const solid = { kind: packed.kind, points };
    if (packed.kind === "surface") { solid.faces = new Uint32Array(bytes(packed.faces)); return solid; }
    const diameters = new Uint16Array(bytes(packed.diameters)), halves = packed.halves ? new Uint16Array(bytes(packed.halves)) : null;
    let first = 0;
    solid.roots = packed.counts.map((count, k) => {
      const root = { points: points.slice(first, first + count), diameters: Array.from(diameters.slice(first, first + count), (d) => d / 1000), halves: halves ? Array.from(halves.slice(first, first + count), (d) => d / 1000) : null, order: packed.orders[k], parent: packed.parents[k] };
      first += count;
      return root;
    });
    return solid;
  }

  function meshed(solid) {
    // vertices, normals and triangles; of each vertex its order, diameter, height and how uncertain its diameter is, for the colours
    const position = [], normal = [], faces = [], tag = [];
    if (solid.kind === "surface") {
      const sums = solid.points.map(() => [0, 0, 0]);
      for (let k = 0; k < solid.faces.length; k += 3) {
        const [a, b, c] = [0, 1, 2].map((i) => solid.faces[k + i]);
        const area = cross(sub(solid.points[b], solid.points[a]), sub(solid.points[c], solid.points[a]));
        for (const v of [a, b, c]) for (let i = 0; i < 3; i++) sums[v][i] += area[i];
        faces.push(a, b, c);
      }
      solid.points.forEach((p, k) => { position.push(...p); normal.push(...unit(sums[k])); tag.push([0, 0, p[2]]); });
      return { position, normal, faces, tag };
    }
    for (const root of solid.roots) {
      const points = root.points, begin = position.length / 3;
      let side = null;
      points.forEach((p, k) => {
        const along = unit(sub(points[Math.min(k + 1, points.length - 1)], points[Math.max(k - 1, 0)]));
        if (side === null) side = Math.abs(along[2]) < 0.9 ? cross(along, [0, 0, 1]) : cross(along, [1, 0, 0]);
        const off = dot(side, along);
        side = unit([side[0] - off * along[0], side[1] - off * along[1], side[2] - off * along[2]]);
        const up = cross(along, side), radius = root.diameters[k] / 2;
        for (let i = 0; i < AROUND; i++) {
          const angle = (2 * Math.PI * i) / AROUND, c = Math.cos(angle), s = Math.sin(angle);
          const n = [0, 1, 2].map((j) => c * side[j] + s * up[j]);
          position.push(p[0] + radius * n[0], p[1] + radius * n[1], p[2] + radius * n[2]);
          normal.push(...n);
          tag.push([root.order, root.diameters[k], p[2], root.halves ? root.halves[k] / Math.max(root.diameters[k], 1e-6) : 0]);
          if (k > 0) {
            const a = begin + (k - 1) * AROUND, b = a + AROUND, next = (i + 1) % AROUND;
            faces.push(a + i, a + next, b + next, a + i, b + next, b + i);
          }
        }
      });
      const last = begin + (points.length - 1) * AROUND;
      for (let i = 1; i + 1 < AROUND; i++) faces.push(begin, begin + i + 1, begin + i, last, last + i, last + i + 1);
    }
    return { position, normal, faces, tag };
  }

  function colours(mesh, by) {
    const sorted = mesh.tag.map((t) => t[1]).sort((a, b) => a - b), most = sorted[Math.floor(0.98 * (sorted.length - 1))] || 1;
    let low = Infinity, high = -Infinity;
    for (const t of mesh.tag) { low = Math.min(low, t[2]); high = Math.max(high, t[2]); }
    const colour = (t) => (by === "order" ? ORDERS[Math.min(t[0], ORDERS.length - 1)] : by === "diameter" ? scaled(t[1] / most) : by === "depth" ? scaled((high - t[2]) / (high - low || 1)) : by === "uncertainty" ? scaled(t[3] / LEAST_KNOWN) : [0.87, 0.63, 0.36]);
    const legend = {
      order: "grey: main root; blue: laterals; red, green, ...: laterals of laterals",
      diameter: `violet: 0 mm; yellow: ${most.toPrecision(2)} mm or more`,
      depth: `violet: ${(-high).toFixed(0)} mm below the rim; yellow: ${(-low).toFixed(0)} mm`,
      uncertainty: `violet: the diameter is certain; yellow: it may be ${(100 * LEAST_KNOWN).toFixed(0)} % off or more (90 % interval)`,
    }[by] || "";
    return { shades: new Float32Array(mesh.tag.flatMap(colour)), legend };
  }

  const VERTEX = "attribute vec3 p, n, c; uniform mat4 m; uniform mat3 r; varying vec3 shade; void main() { gl_Position = m * vec4(p, 1.0);"
    + "float l = 0.45 + 0.55 * abs(dot(normalize(r * n), normalize(vec3(-0.4, 0.6, 0.8)))); shade = c * l; }";
  const FRAGMENT = "precision mediump float; varying vec3 shade; void main() { gl_FragColor = vec4(shade, 1.0); }";

  function show(box, mesh, kind) {
    const canvas = box.querySelector("canvas"), choice = box.querySelector("select");
    const gl = canvas.getContext("webgl", { antialias: true, alpha: true, preserveDrawingBuffer: true });
    if (!gl || !gl.getExtension("OES_element_index_uint")) { box.querySelector("p").textContent = "This browser draws no 3D; see the pictures below."; return; }
    const program = gl.createProgram();
    for (const [type, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(program, shader);
    }
    gl.linkProgram(program); gl.useProgram(program); gl.enable(gl.DEPTH_TEST);
    const middle = [0, 1, 2].map((i) => { let low = Infinity, high = -Infinity; for (let k = i; k < mesh.position.length; k += 3) { low = Math.min(low, mesh.position[k]); high = Math.max(high, mesh.position[k]); } return [(low + high) / 2, (high - low) / 2]; });
    const size = Math.hypot(...middle.map((m) => m[1])) || 1, centre = middle.map((m) => m[0]);
    const fill = (name, values) => {
      const buffer = gl.createBuffer(), place = gl.getAttribLocation(program, name);
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer); gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(place); gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 0, 0);
      return buffer;
    };
    const at = new Float32Array(mesh.position.length);
    for (let k = 0; k < at.length; k++) at[k] = (mesh.position[k] - centre[k % 3]) / size;
    fill("p", at); fill("n", new Float32Array(mesh.normal));
    const told = box.querySelector(".legend"), first = colours(mesh, choice.value), shades = fill("c", first.shades);
    told.textContent = first.legend;
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(mesh.faces), gl.STATIC_DRAW);
    let turn = 0.6, tilt = 0.25, near = 0, shift = [0, 0], wanted = false;
    const fitting = (rows, width, height) => { // how near all of it just fits, with a margin
      let across = 1e-6, up = 1e-6;
      for (let k = 0; k < at.length; k += 3) {
        across = Math.max(across, Math.abs(rows[0][0] * at[k] + rows[0][1] * at[k + 1] + rows[0][2] * at[k + 2]));
        up = Math.max(up, Math.abs(rows[1][0] * at[k] + rows[1][1] * at[k + 1] + rows[1][2] * at[k + 2]));
      }
      return 0.92 * Math.min(1 / (across * Math.min(1, height / width)), 1 / (up * Math.min(1, width / height)));
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
      gl.uniformMatrix4fv(gl.getUniformLocation(program, "m"), false, m);
      gl.uniformMatrix3fv(gl.getUniformLocation(program, "r"), false, [0, 1, 2].flatMap((column) => r.map((row) => row[column])));
      gl.drawElements(gl.TRIANGLES, mesh.faces.length, gl.UNSIGNED_INT, 0);
      canvas.dataset.drawn = String(Number(canvas.dataset.drawn || 0) + 1);
    }
    const redraw = () => { if (!wanted) { wanted = true; requestAnimationFrame(draw); } };
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
    choice.addEventListener("change", () => {
      const now = colours(mesh, choice.value);
      gl.bindBuffer(gl.ARRAY_BUFFER, shades); gl.bufferData(gl.ARRAY_BUFFER, now.shades, gl.STATIC_DRAW);
      told.textContent = now.legend;
      redraw();
    });
    new ResizeObserver(redraw).observe(canvas);
    window.addEventListener("beforeprint", draw);
    redraw();
  }

  function stl(mesh) {
    const count = mesh.faces.length / 3, data = new DataView(new ArrayBuffer(84 + 50 * count));
    data.setUint32(80, count, true);
    for (let k = 0; k < count; k++) {
      const corners = [0, 1, 2].map((i) => { const v = 3 * mesh.faces[3 * k + i]; return mesh.position.slice(v, v + 3); });
      const n = unit(cross(sub(corners[1], corners[0]), sub(corners[2], corners[0])));
      [n, ...corners].flat().forEach((value, i) => data.setFloat32(84 + 50 * k + 4 * i, value, true));
    }
    return new Blob([data.buffer], { type: "model/stl" });
  }

  function rsml(solid, name) {
    const plain = (text) => text.replace(/[<>&"]/g, "");
    const below = solid.roots.map(() => []);
    solid.roots.forEach((root, k) => { if (root.parent >= 0) below[root.parent].push(k); });
    const write = (k) => {
      const root = solid.roots[k];
      return `<root id="1.${k + 1}" label=""><geometry><polyline>${root.points.map((p) => `<point x="${p[0].toFixed(4)}" y="${p[1].toFixed(4)}" z="${p[2].toFixed(4)}"/>`).join("")}</polyline></geometry>`
        + `<functions><function name="diameter" domain="polyline">${root.diameters.map((d) => `<sample>${d}</sample>`).join("")}</function></functions>${below[k].map(write).join("")}</root>`;
    };
    const whole = solid.roots.map((root, k) => (root.parent < 0 ? write(k) : "")).join("");
    return new Blob([`<?xml version="1.0" encoding="UTF-8"?><rsml><metadata><version>1</version><unit>mm</unit><resolution>1</resolution><last-modified>${new Date().toISOString()}</last-modified>`
      + `<software>rhizotwin</software><user></user><file-key>${plain(name)}</file-key></metadata><scene><plant id="1" label="">${whole}</plant></scene></rsml>`], { type: "application/xml" });
  }

  for (const box of document.querySelectorAll("[data-result]")) {
    const data = JSON.parse(box.querySelector("script[type='application/json']").textContent);
    const solid = unpack(data.solid), mesh = meshed(solid);
    show(box.querySelector(".solid"), mesh, solid.kind);
    const files = { csv: () => new Blob([data.csv], { type: "text/csv" }), stl: () => stl(mesh), rsml: () => rsml(solid, data.name) };
    for (const button of box.querySelectorAll("button[data-file]")) {
      button.addEventListener("click", () => {
        const link = document.createElement("a");
        link.href = URL.createObjectURL(files[button.dataset.file]());
        link.download = `${data.file}.${button.dataset.file}`;
        link.click();
        setTimeout(() => URL.revokeObjectURL(link.href), 10000);
      });
    }
  }
})();
