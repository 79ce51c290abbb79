// Learning curves of runs, or of groups of them, over each other.

import { h, remember, remembered, replace } from "./dom.js";
import { Chart, look, smooth } from "./chart.js";
import { count, figure, number, short } from "./format.js";

/** Figure, title, options, and the metric that it is the mean of: those of the task, and what every task has. */
const measures = (metrics) => [
  ...metrics.map((metric) => [`episode/${metric.name}`, metric.unit ? `${metric.label} (${metric.unit})` : metric.label, metric.kind === "share" ? { share: true } : { zero: true, format: (value) => figure(metric, value) }, metric]),
  ["episode/return", "Return", { format: (value) => number(value) }],
  ["time/frames_per_second", "Frames/s", { zero: true, format: (value) => count(value) }],
];
const MORE = [
  ["episode/length", "Length", { zero: true }],
  ["policy/entropy", "Entropy (nats)", {}],
  ["policy/approximate_kl", "Approximate KL", {}],
  ["policy/clip_fraction", "Clipped", { share: true }],
  ["loss/value", "Value loss", {}],
  ["loss/policy", "Policy loss", {}],
  ["loss/auxiliary", "Auxiliary loss", {}],
  ["optimizer/gradient_norm", "Gradient norm", {}],
  ["optimizer/learning_rate", "Learning rate", {}],
  ["lagrangian/multiplier", "PPO-Lagrangian's multiplier", {}],
  ["auxiliary/precision", "Precision of the predicted label", { share: true }],
  ["auxiliary/recall_disturb", "Recall of steps with the label", { share: true }],
  ["auxiliary/recall_no_disturb", "Recall of steps without it", { share: true }],
  ["auxiliary/label_rate", "Steps with the label", { share: true }],
  ["time/elapsed_s", "Time trained (hours)", { zero: true, per: 3600 }],
];

/** Whether two columns hold the same numbers. */
const isSame = (one, other) => one?.length > 0 && one.length === other?.length && one.every((value, at) => value === other[at]);

/** Names beside their colours; a click hides one, or shows it again. */
export function legend(names, hidden, changed) {
  const swatch = (index) => {
    const { colour, dash } = look(index);
    return h("span", { class: `swatch dash-${dash.length && dash[0]}`, style: { "border-color": `var(${colour})` } });
  };
  const toggle = (name) => { if (!hidden.delete(name)) hidden.add(name); changed(); };
  return names.map((name, index) => h("button", { class: "key", "aria-pressed": String(!hidden.has(name)), title: "hide or show", onclick: () => toggle(name) }, swatch(index), name));
}

export class Curves {
  /** `sources`: each a name, the task's metrics, stages (name and first frame), perhaps the paper's levels by metric, the
   * budget in frames, and the means over the newest tenth of the newest stage by metric, that of the return by its figure, and `of(figure, axis)`, which is
   * the columns x, y, stage, and perhaps frames, low and high. `smoothed`: what a value of a smoothed curve is called; `most`: where the axes of shares end. */
  constructor(sources, { title = "Learning curves", axes = ["frames", "time"], key = "curves", smoothed = "smoothed", most, hidden = new Set(), signal } = {}) {
    Object.assign(this, { sources, smoothed, most, hidden, signal, charts: new Map() });
    this.settings = { weight: 0.5, axis: "frames", raw: true, more: false, ...remembered(key, {}) };
    this.grid = h("div", { class: "grid" });
    const set = (change) => { Object.assign(this.settings, change); remember(key, this.settings); this.draw(); };
    const box = (name) => h("input", { type: "checkbox", checked: this.settings[name], onchange: (event) => set({ [name]: event.target.checked }) });
    const weight = h("input", { type: "range", min: "0", max: "0.99", step: "0.01", value: String(this.settings.weight), oninput: () => set({ weight: Number(weight.value) }) });
    const axis = h("select", { onchange: () => set({ axis: axis.value }) }, axes.map((word) => h("option", { value: word, selected: this.settings.axis === word }, word)));
    if (!axes.includes(this.settings.axis)) [this.settings.axis] = axes;
    this.keys = h("div", { class: "legend small" });
    this.element = h("section", { "aria-label": title },
      h("div", { class: "row between" }, h("h2", {}, title),
        h("div", { class: "row controls" }, h("label", {}, "smooth", weight), h("label", {}, box("raw"), "raw"), axes.length > 1 ? h("label", {}, "over", axis) : null, h("label", {}, box("more"), "more"))),
      this.keys, this.grid);
    this.draw();
  }

  draw() {
    const { weight, axis, raw, more } = this.settings;
    const elements = [];
    const metrics = [...new Map(this.sources.flatMap((source) => source.metrics ?? []).map((metric) => [metric.name, metric])).values()];
    let { most } = this;
    for (const [name, title, options, metric] of [...measures(metrics), ...(more ? MORE : [])]) {
      const scaled = (columns) => (options.per && columns.y ? { ...columns, ...Object.fromEntries(["y", "low", "high"].map((key) => [key, columns[key]?.map((value) => value / options.per)])) } : columns);
      // The task's own figure is the return where it has no other.
      if (name === "episode/return" && metrics.some((other) => this.sources.every((source) => !source.of(name, axis)?.y || isSame(source.of(`episode/${other.name}`, axis)?.y, source.of(name, axis)?.y)))) continue;
      const all = this.sources.map((source, index) => ({ source, index, ...scaled(source.of(name, axis)) })).filter(({ y, source }) => y?.length && !this.hidden.has(source.name));
      if (!all.length) continue;
      let chart = this.charts.get(name);
      if (!chart) {
        const zoomed = [...this.charts.values()].map((other) => other.zoom()).find(Boolean);
        chart = new Chart(title, { ...options, origin: true, sync: "curves", zoomed, signal: this.signal });
        chart.element.dataset.figure = name;
        this.charts.set(name, chart);
      }
      Object.assign(chart, axis === "time" ? { xLabel: "hours", xFormat: (hours) => `${short(hours)} h` } : { xLabel: "frames", xFormat: short });
      const series = all.map(({ source, index, x, y, stage, frames = x, low, high }) => ({
        name: source.name, look: look(index), x, raw: raw && weight ? y : null,
        ...Object.fromEntries(Object.entries({ y, low, high }).filter(([, values]) => values).map(([key, values]) => [key, smooth(values, stage, frames, source.budget ?? frames.at(-1), weight)])),
      }));
      // One axis for all shares: others are mostly parts of the first.
      if (metric?.kind === "share") most ??= Math.max(...series.flatMap(({ y }) => y));
      // Where stages begin; of runs that differ in it in their colours.
      const begins = new Map(all.map(({ source: { stages }, index }) => [JSON.stringify(stages), { stages, index }]));
      const marks = [...begins.values()].flatMap(({ stages, index }) => stages.slice(1).map(([label, x]) => ({ label: `stage ${label}`, x, colour: begins.size > 1 ? look(index).colour : undefined })));
      const first = this.sources[all[0].index];
      chart.show({
        series, smoothed: weight > 0 && this.smoothed, newest: all.length === 1 ? first.newest?.[metric?.name ?? name] : undefined, most: metric?.kind === "share" ? most : undefined,
        marks: axis === "frames" ? marks : [],
        levels: metric && metric.name in (first.paper ?? {}) ? [{ y: first.paper[metric.name], label: "the paper's level" }] : [],
      });
      chart.element.dataset.points = String(all[0].x.length);
      elements.push(chart.element);
    }
    if (elements.some((element, at) => this.grid.children[at] !== element) || this.grid.children.length !== elements.length) replace(this.grid, elements);
    this.element.hidden = !elements.length && !this.hidden.size;
    replace(this.keys, this.sources.length > 1 ? legend(this.sources.map(({ name }) => name), this.hidden, () => this.draw()) : []);
  }
}
