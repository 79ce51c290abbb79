// Curves on a canvas: several runs over each other, raw and smoothed, with stages and levels. A cursor is shared by all
// charts of a page, and moves by mouse or by keys.

import { css, h } from "./dom.js";
import { short } from "./format.js";

export const colour = (index) => css(`--run-${index % 7}`);

/** Exponential mean that begins anew with each stage: a new reward makes values that are not comparable. */
export function smooth(values, stages, weight) {
  const smoothed = new Array(values.length).fill(null);
  let sum = 0, mass = 0, stage;
  for (let at = 0; at < values.length; at += 1) {
    if (stages[at] !== stage) [sum, mass, stage] = [0, 0, stages[at]];
    const value = values[at];
    if (value === null || value === undefined) { smoothed[at] = mass > 0 ? sum / mass : null; continue; }
    sum = weight * sum + (1 - weight) * value;
    mass = weight * mass + (1 - weight);
    smoothed[at] = mass > 0 ? sum / mass : value;
  }
  return smoothed;
}

/** Round numbers between two ends, about as many as asked. */
export function ticks(low, high, wanted) {
  const span = high - low;
  if (!(span > 0)) return [low];
  const rough = span / wanted;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 2.5, 5, 10].map((factor) => factor * power).find((each) => each >= rough);
  const found = [];
  for (let at = Math.ceil(low / step) * step; at <= high + step * 1e-6; at += step) found.push(Math.abs(at) < step * 1e-9 ? 0 : at);
  return found;
}

/** Where all charts of a page are looked at. */
export class Cursor {
  constructor() { this.x = null; this.charts = new Set(); }
  move(x) { this.x = x; for (const chart of this.charts) chart.draw(); }
}

const LEFT = 46, RIGHT = 10, TOP = 8, BOTTOM = 22;

export class LineChart {
  /** `format`: of values; `share`: values are 0 to 1. */
  constructor(title, { format = short, share = false, cursor = new Cursor(), xFormat = short, zero = false } = {}) {
    Object.assign(this, { title, format, share, cursor, xFormat, zero, series: [], marks: [], levels: [] });
    this.readout = h("output", {});
    this.canvas = h("canvas", {
      class: "chart", tabIndex: 0, role: "img",
      onpointermove: (event) => this.cursor.move(this.xAt(event.offsetX)),
      onpointerleave: () => this.cursor.move(null),
      onblur: () => this.cursor.move(null),
      onkeydown: (event) => this.key(event),
    });
    this.element = h("figure", { class: "card" }, h("figcaption", {}, h("span", {}, title), this.readout), this.canvas);
    cursor.charts.add(this);
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(this.canvas);
  }

  /** `series`: name, colour, x, raw, smoothed; `marks`: x and label; `levels`: y and label. */
  show({ series, marks = [], levels = [] }) {
    Object.assign(this, { series, marks, levels });
    this.draw();
  }

  bounds() {
    let [left, right, low, high] = [Infinity, -Infinity, Infinity, -Infinity];
    for (const { x, raw, smoothed } of this.series) {
      for (let at = 0; at < x.length; at += 1) {
        if (x[at] < left) left = x[at];
        if (x[at] > right) right = x[at];
        for (const value of [smoothed[at], raw?.[at]]) {
          if (value === null || value === undefined) continue;
          if (value < low) low = value;
          if (value > high) high = value;
        }
      }
    }
    for (const { y } of this.levels) [low, high] = [Math.min(low, y), Math.max(high, y)];
    if (!Number.isFinite(left)) [left, right] = [0, 1];
    if (!Number.isFinite(low)) [low, high] = [0, 1];
    if (this.zero || this.share) low = Math.min(0, low);
    if (this.share) high = Math.min(1, Math.max(high, 0.05));
    if (high - low < 1e-9) high = low + (Math.abs(low) || 1) * 0.1;
    return { left: Math.min(left, 0), right: right > 0 ? right : 1, low, high: high + (this.share && high >= 0.97 ? 0.02 : (high - low) * 0.06) };
  }

  xAt(pixel) {
    const { left, right } = this.box ?? { left: 0, right: 1 };
    const width = this.canvas.clientWidth - LEFT - RIGHT;
    return left + ((pixel - LEFT) / width) * (right - left);
  }

  key(event) {
    const steps = { ArrowLeft: -1, ArrowRight: 1, PageUp: -20, PageDown: 20, Home: -1e9, End: 1e9 };
    if (event.key === "Escape") return this.cursor.move(null);
    if (!(event.key in steps) || !this.series.length) return undefined;
    event.preventDefault();
    const { x } = this.series[0];
    const here = this.cursor.x === null ? x.length - 1 : nearest(x, this.cursor.x);
    const next = Math.max(0, Math.min(x.length - 1, here + steps[event.key]));
    return this.cursor.move(x[next]);
  }

  draw() {
    const { canvas } = this;
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!width) return;
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    this.box = this.bounds();
    const { left, right, low, high } = this.box;
    const px = (x) => LEFT + ((x - left) / (right - left)) * (width - LEFT - RIGHT);
    const py = (y) => height - BOTTOM - ((y - low) / (high - low)) * (height - TOP - BOTTOM);
    this.axes(pen, px, py, width, height);
    for (const each of this.series) this.line(pen, px, py, each);
    this.look(pen, px, py, height);
  }

  axes(pen, px, py, width, height) {
    const { left, right, low, high } = this.box;
    pen.font = "11px system-ui, sans-serif";
    pen.lineWidth = 1;
    pen.strokeStyle = css("--line");
    pen.fillStyle = css("--faint");
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const y of ticks(low, high, 4)) {
      stroke(pen, LEFT, py(y), width - RIGHT, py(y));
      pen.fillText(this.share ? `${Math.round(100 * y)}%` : short(y), LEFT - 7, py(y));
    }
    pen.textAlign = "center";
    pen.textBaseline = "alphabetic";
    for (const x of ticks(left, right, Math.max(2, Math.floor(width / 75)))) pen.fillText(this.xFormat(x), px(x), height - 6);
    pen.textAlign = "left";
    for (const { x, label } of this.marks) {
      if (x <= left || x >= right) continue;
      pen.strokeStyle = css("--faint");
      pen.setLineDash([2, 3]);
      stroke(pen, px(x), TOP, px(x), height - BOTTOM);
      pen.setLineDash([]);
      pen.fillText(label, px(x) + 4, TOP + 9);
    }
    for (const { y, label } of this.levels) {
      pen.strokeStyle = css("--soft");
      pen.setLineDash([7, 4]);
      stroke(pen, LEFT, py(y), width - RIGHT, py(y));
      pen.setLineDash([]);
      pen.fillStyle = css("--soft");
      pen.textAlign = "right";
      pen.fillText(label, width - RIGHT - 2, py(y) - 4);
      pen.textAlign = "left";
    }
  }

  line(pen, px, py, { x, raw, smoothed, colour: ink }) {
    pen.strokeStyle = ink;
    pen.lineJoin = "round";
    if (raw) {
      pen.globalAlpha = 0.28;
      pen.lineWidth = 1;
      path(pen, x, raw, px, py);
    }
    pen.globalAlpha = 1;
    pen.lineWidth = 1.9;
    path(pen, x, smoothed, px, py);
  }

  /** What the cursor is at, or the newest values. */
  look(pen, px, py, height) {
    const at = this.cursor.x;
    const words = [];
    for (const { name, x, smoothed, colour: ink } of this.series) {
      if (!x.length) continue;
      const index = at === null ? last(smoothed) : nearest(x, at);
      const value = smoothed[index];
      if (value === null || value === undefined) continue;
      const text = this.share ? `${(100 * value).toFixed(1)}%` : this.format(value);
      words.push(this.series.length > 1 ? `${name} ${text}` : text);
      if (at === null) continue;
      pen.fillStyle = ink;
      pen.beginPath();
      pen.arc(px(x[index]), py(value), 3.2, 0, 7);
      pen.fill();
    }
    if (at !== null && at >= this.box.left && at <= this.box.right) {
      pen.strokeStyle = css("--faint");
      pen.lineWidth = 1;
      stroke(pen, px(at), TOP, px(at), height - BOTTOM);
      words.push(`at ${this.xFormat(at)}`);
    }
    const text = words.join(" · ") || "nothing yet";
    if (this.readout.textContent !== text) this.readout.textContent = text;
    this.canvas.setAttribute("aria-label", `${this.title}: ${text}. Arrow keys read along the curve.`);
  }
}

function stroke(pen, x0, y0, x1, y1) {
  pen.beginPath();
  pen.moveTo(x0, y0);
  pen.lineTo(x1, y1);
  pen.stroke();
}

function path(pen, x, values, px, py) {
  pen.beginPath();
  let down = false;
  for (let at = 0; at < x.length; at += 1) {
    const value = values[at];
    if (value === null || value === undefined) continue;
    if (down) pen.lineTo(px(x[at]), py(value));
    else pen.moveTo(px(x[at]), py(value));
    down = true;
  }
  pen.stroke();
}

function last(values) {
  for (let at = values.length - 1; at >= 0; at -= 1) if (values[at] !== null && values[at] !== undefined) return at;
  return 0;
}

function nearest(sorted, value) {
  let [low, high] = [0, sorted.length - 1];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (sorted[middle] < value) low = middle + 1; else high = middle;
  }
  return low > 0 && value - sorted[low - 1] < sorted[low] - value ? low - 1 : low;
}
