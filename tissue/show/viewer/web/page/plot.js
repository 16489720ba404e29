// Force over time: its size in black, its components after Okabe and Ito.
"use strict";

// The magnitude lies below its components and is wider, so that one that is all of it is seen on it.
const CURVES = [["magnitude", "#111111", 4], ["x", "#0072b2", 1], ["y", "#d55e00", 2], ["z", "#009e73", 3]];
const LEFT = 58, RIGHT = 12;
const FONT = "17px system-ui, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif";

// The step of 1, 2 or 5 times a power of ten that gives about `count` marks.
function roundStep(span, count) {
  const power = 10 ** Math.floor(Math.log10(span / count));
  return [1, 2, 5, 10].map((each) => each * power).find((each) => span / each <= count) || 10 * power;
}

class ForcePlot {
  // `least` is the smallest force that fills it [N].
  constructor(canvas, least) {
    this.canvas = canvas;
    this.least = least;
    this.rows = [];
    this.cursor = null;
    this.range = null;
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  // Rows of time, x, y, z and magnitude; `range` are the first and last time.
  show(rows, range, cursor = null) {
    [this.rows, this.range, this.cursor] = [rows, range, cursor];
    this.draw();
  }

  // The time at a pixel from the left, or null outside the plot.
  timeAt(pixel) {
    const [left, right] = [LEFT, this.canvas.clientWidth - RIGHT], [first, last] = this.range || [0, 0];
    if (pixel < left || pixel > right) return null;
    return first + ((last - first) * (pixel - left)) / (right - left);
  }

  draw() {
    const scale = window.devicePixelRatio || 1, wide = this.canvas.clientWidth, tall = this.canvas.clientHeight;
    if (wide < 80 || tall < 80) return;
    this.canvas.width = Math.round(wide * scale);
    this.canvas.height = Math.round(tall * scale);
    const pen = this.canvas.getContext("2d");
    pen.scale(scale, scale);
    pen.font = FONT;
    const left = LEFT, right = wide - RIGHT, top = 34, low = tall - 54;
    const [first, last] = this.range || [0, 8];
    let bottom = 0, above = this.least;
    for (const row of this.rows) {
      for (let c = 1; c <= 4; c += 1) { bottom = Math.min(bottom, row[c]); above = Math.max(above, row[c]); }
    }
    if (bottom > -0.03 * above) bottom = 0;
    const step = roundStep(above - bottom, Math.max(3, Math.floor((low - top) / 42)));
    bottom = step * Math.floor(bottom / step);
    above = step * Math.ceil(above / step);
    const x = (time) => left + ((right - left) * (time - first)) / Math.max(last - first, 1e-6);
    const y = (force) => low - ((low - top) * (force - bottom)) / (above - bottom);
    this.axes(pen, { x, y, left, right, top, low, first, last, bottom, above, step });
    pen.save();
    pen.beginPath();
    pen.rect(left, top - 2, right - left, low - top + 4);
    pen.clip();
    pen.lineJoin = "round";
    for (const [, colour, place] of CURVES) {
      pen.strokeStyle = colour;
      pen.lineWidth = place === 4 ? 5.2 : 2.2;
      pen.beginPath();
      for (const row of this.rows) pen.lineTo(x(row[0]), y(row[place]));
      pen.stroke();
    }
    pen.restore();
    if (this.cursor !== null) {
      pen.strokeStyle = "#555";
      pen.lineWidth = 2;
      pen.setLineDash([6, 5]);
      pen.beginPath();
      pen.moveTo(x(this.cursor), top);
      pen.lineTo(x(this.cursor), low);
      pen.stroke();
      pen.setLineDash([]);
    }
  }

  axes(pen, at) {
    const { x, y, left, right, top, low, first, last, bottom, above, step } = at;
    pen.textBaseline = "middle";
    pen.lineWidth = 1;
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    for (let mark = bottom; mark <= above + 0.5 * step; mark += step) {
      pen.strokeStyle = Math.abs(mark) < 0.5 * step ? "#8a9099" : "#e3e6ea";
      pen.beginPath();
      pen.moveTo(left, y(mark));
      pen.lineTo(right, y(mark));
      pen.stroke();
      pen.fillStyle = "#333";
      pen.textAlign = "right";
      pen.fillText(fixed(mark, digits).replace("-", "−"), left - 8, y(mark));
    }
    const stride = roundStep(Math.max(last - first, 1e-3), 5);
    const parts = Math.max(0, -Math.floor(Math.log10(stride) + 1e-9));
    pen.textAlign = "center";
    for (let mark = stride * Math.ceil(first / stride - 1e-9); mark <= last + 1e-9; mark += stride) {
      pen.strokeStyle = "#8a9099";
      pen.beginPath();
      pen.moveTo(x(mark), low);
      pen.lineTo(x(mark), low + 6);
      pen.stroke();
      if (x(mark) > right - 10) pen.textAlign = "right";
      pen.fillText(fixed(mark, parts), x(mark), low + 19);
      pen.textAlign = "center";
    }
    pen.fillText("time / s", 0.5 * (left + right), low + 42);
    pen.textAlign = "left";
    pen.fillText("force / N", 4, 12);
    let place = right;
    for (const [name, colour] of [...CURVES].reverse()) {
      pen.textAlign = "right";
      pen.fillStyle = "#333";
      pen.fillText(name, place, 12);
      place -= pen.measureText(name).width + 6;
      pen.fillStyle = colour;
      pen.fillRect(place - 20, 10, 20, 4);
      place -= 32;
    }
  }
}
