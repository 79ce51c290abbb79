// Charts by uPlot (uPlot/README.md), in the colours of the page: curves with bands, and whatever else a caller paints in
// the same frame. Charts with one `sync` share a cursor and a zoom; the cursor moves by mouse or by keys.

import { css, hand, h, light } from "./dom.js";
import { percent, short, ticks } from "./format.js";

/** What one of several curves looks like: after seven colours they repeat with other dashes. */
export const look = (index) => ({ colour: `--run-${index % 7}`, dash: [[], [7, 3], [2, 3]][Math.floor(index / 7) % 3] });

/** Exponential mean that begins anew with each stage: a new reward makes values that are not comparable. `weight`: of
 * what was an eightieth of `total` frames ago, however many values there are on the way. */
export function smooth(values, stages, frames, total, weight) {
  const smoothed = new Array(values.length).fill(null);
  let sum = 0, mass = 0, stage, before = 0;
  for (let at = 0; at < values.length; at += 1) {
    if (stages[at] !== stage) [sum, mass, stage] = [0, 0, stages[at]];
    const value = values[at];
    if (value === null || value === undefined) { smoothed[at] = mass > 0 ? sum / mass : null; continue; }
    const kept = weight ** ((80 * (frames[at] - before)) / total);
    before = frames[at];
    sum = kept * sum + (1 - kept) * value;
    mass = kept * mass + (1 - kept);
    smoothed[at] = mass > 0 ? sum / mass : value;
  }
  return smoothed;
}

const see = (colour, opacity) => css(colour).replace("rgb(", "rgba(").replace(")", `, ${opacity})`);
const shareText = (value) => `${Number((100 * value).toPrecision(3))}%`;
const FONT = "system-ui, sans-serif";

export class Chart {
  /** `share`: values are 0 to 1; `zero`: their axis begins at 0; `origin`: that of x does; `format`: of a value; `log`: of x; `rows`: names in the
   * place of a y axis; `zoomed`: the part of the x axis that is seen at first; `signal`: when the chart is no longer needed. */
  constructor(title, { share = false, zero = share, origin = false, format = share ? percent : short, log = false, xLabel = "frames", xFormat = short, isCounted = false, rows = null, height = 190, sync, zoomed, signal } = {}) {
    Object.assign(this, { title, share, zero, origin, format, log, xLabel, xFormat, isCounted, rows, height, sync, zoomed, content: { series: [] }, lines: [], data: [[]] });
    this.readout = h("output", {});
    this.frame = h("div", { class: "chart", tabIndex: 0, role: "img", style: { height: `${height}px` }, onkeydown: (event) => this.key(event), onblur: () => this.plot?.setCursor({ left: -10, top: -10 }, true, true) });
    const button = (name, save) => h("button", { class: "save", "aria-label": `Save “${title}” as ${name}`, title: `Save “${title}” as ${name}`, onclick: save }, name);
    this.element = h("figure", { class: "card", "aria-label": title },
      h("figcaption", {}, h("span", {}, title), this.readout, h("span", { class: "saves" }, button("PNG", () => this.picture()), button("CSV", () => hand(new Blob([this.csv()], { type: "text/csv" }), `${this.file()}.csv`)))), this.frame);
    new ResizeObserver(() => this.fit()).observe(this.frame);
    addEventListener("recolour", () => this.plot?.redraw(), { signal });
    // Half or all of a sheet's width, in pixels as fine as ink.
    addEventListener("beforeprint", () => this.draw(this.element.matches(":last-child:nth-child(odd)") ? 780 : 370, 3), { signal });
    addEventListener("afterprint", () => this.draw(), { signal });
    signal?.addEventListener("abort", () => this.plot?.destroy());
  }

  file() { return this.title.toLowerCase().replace(/[^\p{L}\p{N}]+/gu, "-").replace(/^-|-$/g, ""); }

  /** `series`: name, look, x, y, and perhaps raw, low and high; `marks`: x and label; `levels`: y and label; `most`: the y
   * axis reaches there; `newest`: what one curve came to, and of what that is; and `smoothed` what its values are called; `placed`: whether the last value is told with its place; `domain`: of x; `paint`: draws more; `read`: what the cursor is at; `table`: the data of that. */
  show(content) {
    const { lines, bands, xLabel, plot, ends = [0, 0] } = this;
    this.content = content;
    this.lines = [];
    this.bands = [];
    const tables = content.series.map((one) => {
      const { colour, dash } = one.look;
      const table = [one.x];
      const add = (values, line) => { table.push(values); return this.lines.push({ spanGaps: true, points: { show: false }, ...line }); };
      if (one.low) {
        const [top, bottom] = [add(one.high, { width: 0 }), add(one.low, { width: 0 })];
        this.bands.push({ series: [top, bottom], colour });
      }
      if (one.raw) add(one.raw, { colour, opacity: 0.3, width: 1 });
      add(one.y, { name: one.name, colour, dash, opacity: 1, width: one.look.width ?? 1.9, points: undefined });
      return table;
    });
    this.data = tables.length ? uPlot.join(tables) : [content.domain ?? []];
    const shape = (all) => JSON.stringify(all);
    if (!plot || this.rows || xLabel !== this.drawn || shape([lines, bands]) !== shape([this.lines, this.bands])) this.draw();
    else {
      const zoomed = this.zoom(ends);
      plot.setData(this.data, !zoomed);
      if (zoomed) plot.redraw();
    }
    // Columns grow in their place.
    this.ends = [this.data[0][0], this.data[0].at(-1)];
    this.tell();
  }

  /** The part of the x axis that is seen, where that is not all of it. */
  zoom([first, last] = this.ends ?? []) {
    const { min, max } = this.plot?.scales.x ?? {};
    return min > first || max < last ? { min, max } : null;
  }

  draw(width = this.frame.clientWidth, scale = 1) {
    this.plot?.destroy();
    this.plot = null;
    this.drawn = this.xLabel;
    this.frame.style.setProperty("height", `${this.height}px`);
    if (!width) return;
    this.plot = new uPlot(this.options(width * scale, this.height * scale, scale), this.data, this.frame);
    if (this.zoomed) this.plot.setScale("x", this.zoomed);
    this.zoomed = null;
  }

  fit() {
    if (!this.plot) this.draw();
    else if (this.frame.clientWidth && this.frame.clientWidth !== this.plot.width) this.plot.setSize({ width: this.frame.clientWidth, height: this.height });
  }

  options(width, height, scale = 1, done = () => {}) {
    const font = `${11 * scale}px ${FONT}`;
    const axis = { font, labelFont: font, stroke: () => css("--soft"), gap: 5 * scale, ticks: { show: false }, grid: { stroke: () => css("--line"), width: scale } };
    const pen = Object.assign(h("canvas", {}).getContext("2d"), { font });
    const room = (plot, values) => Math.max(0, ...(values ?? []).map((text) => pen.measureText(text ?? "").width)) + 14 * scale;
    // Of a long name its end tells most.
    const cut = (name) => { let text = name; while (text.length > 4 && pen.measureText(text).width > 0.35 * width) text = `…${text.slice(2)}`; return text; };
    const line = ({ name, colour, dash = [], opacity, width: thick, points, spanGaps }) => ({
      label: name, spanGaps, width: thick * scale, dash: dash.map((each) => each * scale), stroke: opacity ? () => see(colour, opacity) : undefined,
      points: points ?? { size: 5 * scale, width: 0, fill: () => css(colour) },
    });
    return {
      width, height, legend: { show: false }, padding: [8 * scale, 16 * scale, 0, 0],
      cursor: { y: false, sync: this.sync && { key: this.sync, setSeries: false }, drag: { x: !this.rows, y: false }, points: { show: (plot, at) => (this.lines[at - 1].name === undefined ? false : h("div", { class: "u-cursor-pt here", style: { background: css(this.lines[at - 1].colour) } })) } },
      scales: {
        x: { time: false, distr: this.log ? 3 : 1, range: (plot, low, high) => this.content.domain ?? (low === null ? [0, 1] : [this.origin && low === this.data[0][0] ? 0 : low, high > low ? high : low + (Math.abs(low) || 1)]) },
        y: this.rows ? { dir: -1, range: () => [-0.5, this.rows.length - 0.5] } : { range: (plot, low, high) => this.reach(low, high) },
      },
      axes: [
        { ...axis, size: 20 * scale, space: 65 * scale, label: this.xLabel, labelSize: 15 * scale, labelGap: 0, ...(this.isCounted ? { incrs: [1, 2, 5, 10, 20, 50, 100] } : {}), values: (plot, splits) => (this.xFormat === short ? ticks(splits) : splits.map((value) => (value === null ? null : this.xFormat(value)))) },
        this.rows
          ? { ...axis, size: room, grid: { show: false }, splits: () => this.rows.map((name, at) => at), values: () => this.rows.map(cut) }
          : { ...axis, size: room, space: 32 * scale, values: (plot, splits) => (this.share ? splits.map(shareText) : ticks(splits)) },
      ],
      series: [{}, ...this.lines.map(line)],
      bands: this.bands.map(({ series, colour }) => ({ series, fill: () => see(colour, 0.16) })),
      hooks: { draw: [(plot) => { this.over(plot, scale); done(plot); }], setCursor: [() => this.tell()] },
    };
  }

  /** Ends of the y axis for values between these. */
  reach(low, high) {
    const wanted = [low, high, this.content.most, ...(this.content.levels ?? []).map(({ y }) => y)].filter((value) => value !== null && value !== undefined);
    if (!wanted.length) return [0, 1];
    let [least, most] = [Math.min(...wanted), Math.max(...wanted)];
    if (this.zero) [least, most] = [Math.min(least, 0), Math.max(most, this.share ? 0.05 : 0)];
    if (most - least < 1e-9) most = least + (Math.abs(least) || 1) * 0.1;
    const more = (most - least) * 0.06;
    // Names of marks stand above the curves, a line each.
    const names = ((most - least) * 19 * (this.content.marks?.length ?? 0)) / this.height;
    return [this.zero && least === 0 ? 0 : least - more, (this.share ? Math.min(most + more, 1.02) : most + more) + names];
  }

  /** What is drawn over the curves. */
  over(plot, scale) {
    const { ctx: pen, bbox: { left, top, width, height } } = plot;
    const unit = uPlot.pxRatio * scale;
    pen.save();
    pen.font = `${11 * unit}px ${FONT}`;
    pen.lineWidth = unit;
    const stroke = (colour, dash, x0, y0, x1, y1) => {
      pen.strokeStyle = css(colour);
      pen.setLineDash(dash.map((each) => each * unit));
      pen.beginPath();
      pen.moveTo(x0, y0);
      pen.lineTo(x1, y1);
      pen.stroke();
    };
    pen.textBaseline = "alphabetic";
    for (const [row, { x, label, colour = "--soft" }] of (this.content.marks ?? []).entries()) {
      const at = plot.valToPos(x, "x", true);
      if (at <= left || at >= left + width) continue;
      stroke(colour === "--soft" ? "--faint" : colour, [2, 3], at, top, at, top + height);
      pen.fillStyle = css(colour);
      const over = at + pen.measureText(label).width + 4 * unit > left + width;
      pen.textAlign = over ? "right" : "left";
      pen.fillText(label, at + (over ? -4 : 4) * unit, top + (10 + 12 * row) * unit);
    }
    Object.assign(pen, { fillStyle: css("--soft"), textAlign: "right" });
    for (const { y, label } of this.content.levels ?? []) {
      const at = plot.valToPos(y, "y", true);
      stroke("--soft", [7, 4], left, at, left + width, at);
      pen.fillText(label, left + width - 2 * unit, at - 4 * unit);
    }
    pen.setLineDash([]);
    this.content.paint?.(plot, pen, unit);
    pen.restore();
  }

  /** What the cursor is at, or the newest values. */
  tell() {
    const at = this.plot?.cursor.idx ?? null;
    const values = this.lines.flatMap((line, index) => (line.name === undefined ? [] : [[line.name, near(this.data[index + 1], at)]])).filter(([, value]) => value !== null);
    const several = values.length > 1;
    const words = this.content.read?.(this.plot) ?? values.map(([name, value]) => (several ? `${name} ${this.format(value)}` : this.format(value)));
    const { newest, smoothed } = this.content;
    if (at === null && !several && values.length && newest) words.splice(0, 1, this.format(newest[0]), newest[1]);
    else if (values.length && smoothed) words.push(smoothed);
    if ((at !== null || this.content.placed) && values.length) words.push(`at ${this.xFormat(this.data[0][at ?? this.data[0].length - 1])}`);
    const text = words.join(several ? "\n" : " · ") || (this.rows ? "" : "nothing yet");
    this.element.classList.toggle("several", several);
    // Of several the newest values would hide the curves.
    const shown = several && at === null ? "" : text;
    if (this.readout.textContent !== shown) this.readout.textContent = shown;
    this.frame.setAttribute("aria-label", `${this.title}: ${text}.${this.rows ? "" : " Arrow keys read along the curve."}`);
  }

  key(event) {
    const steps = { ArrowLeft: -1, ArrowRight: 1, PageUp: -20, PageDown: 20, Home: -1e9, End: 1e9, Escape: 0 };
    if (!(event.key in steps) || this.rows || !this.plot || !this.data[0].length) return;
    event.preventDefault();
    const last = this.data[0].length - 1;
    const next = Math.max(0, Math.min(last, (this.plot.cursor.idx ?? last) + steps[event.key]));
    const left = event.key === "Escape" ? -10 : this.plot.valToPos(this.data[0][next], "x");
    this.plot.setCursor({ left, top: left < 0 ? -10 : 1 }, true, true);
  }

  csv() {
    const quoted = (cell) => (/[",\n]/.test(String(cell ?? "")) ? `"${String(cell).replaceAll('"', '""')}"` : String(cell ?? ""));
    const curves = () => [["curve", this.xLabel, "value", "low", "high", "raw"], ...this.content.series.flatMap(({ name, x, y, low, high, raw }) => x.map((at, index) => [name, at, y[index], low?.[index], high?.[index], raw?.[index]]))];
    return (this.content.table ?? curves()).map((row) => `${row.map(quoted).join(",")}\n`).join("");
  }

  /** The chart on white, as papers are, with its title and its legend. */
  async picture() {
    const scale = 2, width = 720 * scale, height = Math.max(this.height, 300) * scale;
    const picture = h("canvas", {});
    await light(async () => {
      let plot;
      const drawn = await new Promise((done) => { plot = new uPlot(this.options(width, height, scale, done), this.data, h("div", {})); });
      const unit = uPlot.pxRatio * scale, line = 20 * unit;
      const names = this.lines.filter(({ name }) => name !== undefined && this.content.series.length > 1);
      Object.assign(picture, { width: drawn.ctx.canvas.width, height: drawn.ctx.canvas.height + line * (names.length + 1.3) });
      const pen = picture.getContext("2d");
      pen.fillStyle = "#ffffff";
      pen.fillRect(0, 0, picture.width, picture.height);
      pen.fillStyle = css("--ink");
      pen.font = `600 ${13 * unit}px ${FONT}`;
      pen.fillText(this.title, 10 * unit, line * 0.95);
      pen.font = `${11 * unit}px ${FONT}`;
      names.forEach(({ name, colour, dash }, at) => {
        const y = line * (at + 1.9);
        Object.assign(pen, { fillStyle: css("--ink"), strokeStyle: css(colour), lineWidth: 2 * unit });
        pen.setLineDash(dash.map((each) => each * unit));
        pen.beginPath();
        pen.moveTo(10 * unit, y - 4 * unit);
        pen.lineTo(38 * unit, y - 4 * unit);
        pen.stroke();
        pen.fillText(name, 46 * unit, y);
      });
      pen.drawImage(drawn.ctx.canvas, 0, line * (names.length + 1.3));
      plot.destroy();
    });
    picture.toBlob((blob) => hand(blob, `${this.file()}.png`));
  }
}

/** The value at a place or the nearest before it that there is; of no place the last. */
function near(values, at) {
  for (let index = at ?? values.length - 1; index >= 0; index -= 1) if (values[index] !== null && values[index] !== undefined) return values[index];
  return null;
}
