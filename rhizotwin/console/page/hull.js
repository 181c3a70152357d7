// Draws the cells of the coarse hull in the canister on a canvas, as a translucent cloud; dragging rotates the view.

const DENSEST = 0.9; // quantile of the number of cells one behind another that looks almost opaque
const SOFT = 2; // size of the blurred disc that is drawn for a cell, relative to its edge
const MARGIN = 1.15;

export class Hull {
  constructor(canvas) {
    this.canvas = canvas;
    this.points = new Float32Array();
    this.edge = 1;
    this.radius = 75;
    this.height = 150;
    this.turn = 0.5;
    this.tilt = 0.25;
    let from = null;
    canvas.addEventListener("pointerdown", (event) => {
      from = [event.clientX, event.clientY, this.turn, this.tilt];
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (from === null) return;
      this.turn = from[2] + (event.clientX - from[0]) * 0.01;
      this.tilt = Math.max(-1.5, Math.min(1.5, from[3] + (event.clientY - from[1]) * 0.01));
      this.draw();
    });
    canvas.addEventListener("pointerup", () => { from = null; });
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
      if (step === undefined) return;
      event.preventDefault();
      this.turn += step[0];
      this.tilt = Math.max(-1.5, Math.min(1.5, this.tilt + step[1]));
      this.draw();
    });
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  // Set the cells: edge of a cell, then x, y, z of each centre (mm).
  set(numbers, radius, height) {
    this.edge = numbers[0];
    this.points = numbers.subarray(1);
    this.radius = radius;
    this.height = height;
    this.draw();
  }

  // Return what fills the canvas: middle height, half width in every direction and half height (mm), of the cells or, without cells, of the canister.
  extent() {
    if (this.points.length === 0) return [-this.height / 2, this.radius, this.height / 2];
    let [reach, low, high] = [0, Infinity, -Infinity];
    for (let k = 0; k + 2 < this.points.length; k += 3) {
      reach = Math.max(reach, Math.hypot(this.points[k], this.points[k + 1]));
      low = Math.min(low, this.points[k + 2]);
      high = Math.max(high, this.points[k + 2]);
    }
    return [(low + high) / 2, reach + this.edge, (high - low) / 2 + this.edge];
  }

  draw() {
    const ratio = window.devicePixelRatio || 1;
    const width = Math.round(this.canvas.clientWidth * ratio);
    const height = Math.round(this.canvas.clientHeight * ratio);
    if (!width || !height) return;
    this.canvas.width = width;
    this.canvas.height = height;
    const context = this.canvas.getContext("2d");
    const style = getComputedStyle(document.documentElement);
    const [sin, cos, up, back] = [Math.sin(this.turn), Math.cos(this.turn), Math.sin(this.tilt), Math.cos(this.tilt)];
    const [middle, reach, half] = this.extent();
    const scale = Math.min(height / (half * Math.abs(back) + reach * Math.abs(up)), width / reach) / 2 / MARGIN;
    const project = (x, y, z) => {
      const across = x * sin + y * cos;
      const away = x * cos - y * sin;
      return [width / 2 + across * scale, height / 2 - ((z - middle) * back - away * up) * scale];
    };
    context.strokeStyle = style.getPropertyValue("--soft");
    context.lineWidth = ratio;
    for (const z of [0, -this.height]) {
      context.beginPath();
      for (let k = 0; k <= 64; k++) {
        const angle = (k / 64) * 2 * Math.PI;
        context.lineTo(...project(this.radius * Math.cos(angle), this.radius * Math.sin(angle), z));
      }
      context.stroke();
    }
    for (const side of [-1, 1]) {
      context.beginPath();
      const [x, y] = [side * this.radius * sin, side * this.radius * cos];
      context.moveTo(...project(x, y, 0));
      context.lineTo(...project(x, y, -this.height));
      context.stroke();
    }
    this.drawCells(context, project, Math.max(1, this.edge * scale), style);
  }

  // Draw each cell as a blurred disc. Discs add up to the thickness of the roots along the line of sight.
  drawCells(context, project, size, style) {
    const disc = Math.max(3, Math.round(SOFT * size));
    const sprite = new OffscreenCanvas(disc, disc);
    const brush = sprite.getContext("2d");
    const shade = brush.createRadialGradient(disc / 2, disc / 2, 0, disc / 2, disc / 2, disc / 2);
    const colour = style.getPropertyValue("--root").trim();
    shade.addColorStop(0, colour);
    shade.addColorStop(1, `${colour}00`);
    brush.fillStyle = shade;
    brush.fillRect(0, 0, disc, disc);
    const places = [];
    const behind = new Map();
    for (let k = 0; k + 2 < this.points.length; k += 3) {
      const [x, y] = project(this.points[k], this.points[k + 1], this.points[k + 2]);
      const at = `${Math.round(x / size)} ${Math.round(y / size)}`;
      behind.set(at, (behind.get(at) ?? 0) + 1);
      places.push([x - disc / 2, y - disc / 2]);
    }
    const counts = Array.from(behind.values()).sort((a, b) => a - b);
    const deepest = counts[Math.floor(DENSEST * (counts.length - 1))] ?? 1;
    context.globalAlpha = 1 - 0.1 ** (3 / (SOFT * SOFT * deepest)); // a disc has a third of the opacity of its centre on average
    for (const [x, y] of places) context.drawImage(sprite, x, y);
    context.globalAlpha = 1;
  }
}
