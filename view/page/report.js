// A report: what runs came to, over seeds and beside the paper. `stillroom report` puts its data into the page.

import { app, css, h, hand, meanings, replace } from "./dom.js";
import { action, bare, count, percent, short, words } from "./format.js";
import { Chart, look } from "./chart.js";
import { Curves, legend } from "./curves.js";

/** `test-novel-best` in words. */
function fieldName(key) {
  const known = { novel: "novel objects", seen: "seen objects", drawn: "drawn episodes", seeds: "episodes of fixed seeds", best: "best checkpoint" };
  // Those of scenes and of procedural kitchens are always drawn.
  return key.replace(/^((?:scenes|procedural).*?)(-best)?$/, "$1-drawn$2").split("-").map((word) => known[word] ?? word).join(", ");
}

/** Fewer episodes than this say nothing of what a policy does when, nor of what it foretells. */
const FEW = 50;
/** More settings than these are folded away. */
const MANY = 8;
const SHARE = { kind: "share" };
const heading = ({ label, unit }) => (unit ? `${label} (${unit})` : label);
export const range = (one, { low, high }) => `${bare(one, low).replace("%", "")}\u00a0–\u00a0${bare(one, high)}`;
const over = (value, below) => [value, below ? h("small", {}, below) : null];
/** A figure with its interval beneath. */
const estimate = (one, { point, interval }) => over(bare(one, point), interval && range(one, interval));

/** A metric's mean in a result, and the way of its interval: of a share of one seed, or of seeds that all agree, Wilson's over
 * the episodes; of another figure of one seed that of its evaluation. */
export function meanOf({ metrics, rates, intervals = {} }, { name }) {
  const { mean } = metrics[name];
  const found = [[mean.interval, "of several seeds from a bootstrap"], [rates[name]?.interval, "of a share of one seed, or of seeds that agree, Wilson's over the episodes"], [intervals[name], "of a mean that is no share from a bootstrap over the episodes of one seed"]];
  const [interval, way] = found.find(([one]) => one) ?? [];
  return { ...mean, interval, way };
}

/** A table. `heads`: names; those that begin with # are of numbers. `rows`: cells, and perhaps a class. */
function table(heads, rows, spans = null) {
  const kind = (at) => (heads[at].startsWith("#") ? "number" : null);
  const spanned = (spans ?? []).flatMap(([columns, name]) => Array(columns).fill(name));
  const called = (at) => [spanned[at], heads[at].replace("#", "")].filter(Boolean).join(", ");
  const cells = (all) => all.reduce((made, cell) => {
    const { content = cell, columns = 1 } = cell?.columns ? cell : {};
    made.row.push(h("td", { class: kind(made.at), colSpan: columns, "data-head": columns === 1 ? called(made.at) : null }, content));
    made.at += columns;
    return made;
  }, { row: [], at: 0 }).row;
  return h("div", { class: "scroll" }, h("table", { class: "tight fold" },
    h("thead", {}, spans && h("tr", {}, spans.map(([columns, name]) => h("th", { colSpan: columns, class: "span" }, name))),
      h("tr", {}, heads.map((head, at) => h("th", { scope: "col", class: kind(at) }, head.replace("#", ""))))),
    h("tbody", {}, rows.map(({ kind: of = null, row }) => h("tr", { class: of }, cells(row))))));
}

const plain = (rows) => rows.map((row) => ({ row }));
const section = (id, title, ...content) => h("section", { id, class: "stack" }, h("h2", {}, title), content);
/** A part with its title in the place of all of it. */
function fold(part) {
  const [{ id }, title] = [part, part.querySelector("h2")];
  part.removeAttribute("id");
  title.hidden = true;
  return h("details", { id, class: "part" }, h("summary", {}, title.textContent), part);
}
const says = (...text) => h("p", { class: "small soft wide" }, text);

class Page {
  constructor(root, { made, name, program = app.program, drawn = true, labelled = true, report, episodes, undrawn = [], differences = [] }) {
    Object.assign(app, { program });
    Object.assign(this, { program, drawn, labelled, report, episodes, differences, hidden: new Set(), missing: [...undrawn] });
    // Where each group is one run it is called so, and nothing is said of means over seeds.
    this.seeds = report.groups.some(({ runs }) => runs.length > 1);
    this.group = this.seeds ? "group" : "run";
    this.several = Object.keys(report.tasks).length > 1;
    this.names = report.groups.map(({ label }) => label);
    this.results = report.groups.flatMap((group, index) => group.results.map((result) => ({ group, index, result })));
    this.averaged = this.results.some(({ result }) => result.seeds.length > 1);
    this.hasRates = this.results.some(({ result: { rates } }) => Object.keys(rates).length);
    this.fields = [...new Set(report.comparisons.map(({ field }) => field).concat(this.results.map(({ result }) => result.field)))];
    this.fields = this.fields.filter((field) => this.results.some(({ result }) => result.field === field));
    this.keys = h("div", { class: "legend small" });
    this.redraws = [];
    const several = this.names.length > 1;
    // On a narrow screen those of several groups are many screens long.
    const folds = several && innerWidth <= 500;
    const folded = (part) => (folds && part?.id ? fold(part) : part);
    const opening = [this.headline(), this.differing(), this.strips()].flat().map(folded);
    const parts = [this.evaluated(), this.comparisons(), this.stages(), this.curves(), this.validation(), this.limits(), this.sweeps(), this.prediction(), this.actions(), this.runs()].flat().filter(Boolean).map(folded);
    replace(root, h("div", { class: "stack report" },
      h("div", { class: "row between" }, h("h1", {}, name ?? (report.groups.length === 1 ? report.groups[0].label : "Report")), h("span", { class: "small soft" }, name || report.groups.length === 1 ? "report " : null, made)),
      folds ? null : h("nav", { class: "parts" }, [...opening, ...parts].filter((part) => part?.id).map((part) => h("a", { href: `#${part.id}` }, part.querySelector("h2").textContent))),
      several ? this.keys : null,
      opening,
      report.notes.length ? h("details", { class: "notice", open: true }, h("summary", {}, "Before you trust these figures"), h("ul", {}, report.notes.map((note) => h("li", {}, note)))) : null,
      parts,
      this.missing.length ? h("details", { id: "missing", open: !report.groups.some(({ results }) => results.length) }, h("summary", {}, "What is not here"), h("ul", {}, this.missing.map((why) => h("li", {}, why)))) : null));
    this.redraw();
  }

  /** Draws anew what shows groups, without those that are hidden. */
  redraw() {
    replace(this.keys, legend(this.names, this.hidden, () => this.redraw()));
    for (const redraw of this.redraws) redraw();
  }

  none(why) { this.missing.push(why); return null; }

  /** Charts of curves of groups: `of` gives a group's columns for a chart's key. */
  charts(keys, make, of) {
    const charts = keys.map((key) => {
      const chart = make(key);
      this.redraws.push(() => chart.show({ ...chart.content, most: chart.share ? 1 : undefined, series: this.report.groups.flatMap((group, index) => {
        const columns = this.hidden.has(group.label) ? null : of(group, key);
        return columns ? [{ name: group.label, look: look(index), ...columns }] : [];
      }) }));
      return chart.element;
    });
    return h("div", { class: "grid" }, charts);
  }

  /** What the first thing to know is: of each group in its first field. */
  headline() {
    const entry = (name, value, below, doc) => h("div", { title: doc }, h("dt", {}, name), h("dd", {}, over(value, below)));
    // How the intervals beneath figures were made.
    const ways = new Set();
    const cards = this.report.groups.slice(0, 6).map((group, index) => {
      const [result] = group.results;
      const frames = Math.max(...group.runs.map((run) => run.frames));
      // Of a run that was not evaluated what its newest training episodes came to.
      const { figures: trained } = group.stages.findLast((stage) => Object.keys(stage.figures).length) ?? { figures: {} };
      const of = (one) => {
        const { point, interval, way } = result?.metrics[one.name] ? meanOf(result, one) : { point: (result?.pooled ?? trained)[one.name] };
        if (interval) ways.add(way);
        return point === undefined ? null : entry(heading(one), bare(one, point), interval && range(one, interval), one.doc);
      };
      return h("section", { class: "card stack", style: { "border-top": `3px solid var(${look(index).colour})` } },
        h("div", { class: "row between" }, h("h2", {}, group.label), h("span", { class: "small soft" }, `${this.drawn && !this.several ? "" : `${words(group.task)} · `}${group.preset === group.label ? "" : `${group.preset} · `}${group.runs.length === 1 ? "seed" : "seeds"} ${group.runs.map((run) => run.seed).join(", ")} · ${result ? fieldName(result.field) : "newest tenth of training"}`)),
        h("dl", { class: "figures" }, this.report.tasks[group.task].shown.map(of), result ? entry("episodes", count(result.pooled.episodes)) : null, entry("frames", short(frames))),
        this.report.groups.length === 1 ? this.trained(group) : null,
        group.differences.length ? says(`${group.label.includes("*") ? "* " : ""}changed from the preset ${group.preset}: ${group.differences.join("; ")}`) : null);
    });
    return [h("div", { class: "grid" }, cards), ways.size ? says(`Beneath a figure: its 95% interval; ${[...ways].join("; ")}.`) : null,
      meanings([...new Map(Object.values(this.report.tasks).flatMap(({ shown }) => shown).map((one) => [one.label, one])).values()])];
  }

  /** What the stages of a group came to in training, where it has several. */
  trained({ task, stages }) {
    const begun = stages.filter(({ figures }) => Object.keys(figures).length);
    const { shown: metrics } = this.report.tasks[task];
    const row = ({ name, reward, figures }) => [name, words(reward), ...metrics.map((one) => bare(one, figures[one.name]))];
    return begun.length > 1 ? [table(["training, stage", "reward", ...metrics.map((one) => `#${heading(one)}`)], plain(begun.map(row))), this.tenths()] : null;
  }

  /** The settings that are not the same in all groups. */
  differing() {
    const text = (one) => (one === null ? "–" : typeof one === "string" ? one : Number.isInteger(one) ? count(one) : typeof one === "object" ? Object.entries(one).map(([key, part]) => (Array.isArray(one) ? text(part) : `${key} ${text(part)}`)).join(", ") : String(one));
    const value = (one) => (text(one).length > 40 ? `${text(one).slice(0, 39)}…` : text(one));
    // Runs of several tasks differ in nearly all.
    const tables = this.byTask(this.report.groups.map((group, at) => ({ group, at }))).map(([task, some]) => {
      const names = some.map(({ group }) => group.label);
      // More columns than three do not fit.
      const [heads, cells] = names.length > 3 ? [["values"], (values) => [values.map((one, at) => `${names[at]}: ${value(one)}`).join("; ")]] : [names, (values) => values.map(value)];
      const rows = this.differences.map(({ name, values }) => [name, some.map(({ at }) => values[at])]).filter(([, values]) => !this.several || new Set(values.map((one) => JSON.stringify(one))).size > 1);
      if (!rows.length) return [];
      const settings = table(["setting", ...heads], plain(rows.map(([name, values]) => [h("code", {}, name), ...cells(values)])));
      // Results do not stand behind pages of settings.
      const folded = rows.length > MANY ? h("details", {}, h("summary", {}, `${rows.length} settings`), settings) : settings;
      return [this.several ? h("h3", {}, words(task)) : null, folded];
    }).flat();
    return tables.length ? section("differences", "What differs", tables) : null;
  }

  /** The metrics of a task that are printed and that a result has, in the order of the declaration. */
  printed(task, result) { return this.report.tasks[task].described.filter(({ name, label }) => label && result?.metrics[name]); }

  /** These results by task: each with its name. */
  byTask(found) { return [...new Set(this.report.groups.map(({ task }) => task))].map((task) => [task, found.filter(({ group }) => group.task === task)]).filter(([, some]) => some.length); }

  /** What a mean of a field is over: episodes of fixed seeds are in no kitchen. */
  samples(field) {
    const fixed = /-seeds(-best)?$/.test(field);
    return this.averaged ? `seeds${fixed ? "" : " and kitchens"}` : fixed ? "episodes" : "kitchens";
  }

  /** Every group in every field. */
  evaluated() {
    if (!this.results.length) return this.none(`Results: none of these runs has been evaluated yet (\`${this.program} eval RUN\`).`);
    const metrics = ([task, found]) => {
      const { ranking } = this.report.tasks[task];
      const printed = this.printed(task, found[0].result);
      const both = (one) => ranking.includes(one.name) && found.some(({ result }) => result.seeds.length > 1);
      const heads = printed.flatMap((one) => (both(one) ? [`#${heading(one)}, mean`, `#${heading(one)}, IQM`] : [`#${heading(one)}`]));
      const row = ({ group, result }) => [group.label, ...(this.seeds ? [count(result.seeds.length)] : []), count(result.pooled.episodes),
        ...printed.flatMap((one) => [estimate(one, meanOf(result, one)), ...(both(one) ? [result.seeds.length > 1 ? estimate(one, result.metrics[one.name].iqm) : "–"] : [])])];
      return table([this.group, ...(this.seeds ? ["#seeds"] : []), "#episodes", ...heads], plain(found.map(row)));
    };
    const fields = this.fields.map((field) => {
      const found = this.results.filter(({ result }) => result.field === field);
      return [h("h3", {}, fieldName(field)), this.byTask(found).map(metrics), this.byTask(found).map(([task, some]) => this.intervals(task, field, some))];
    });
    const further = ([task, found]) => {
      const columns = this.report.tasks[task].described.filter(({ name, label }) => label && !found[0].result.metrics[name]);
      const row = ({ group, result: { field, pooled } }) => [group.label, fieldName(field), ...columns.map((one) => bare(one, pooled[one.name]))];
      return table([this.group, "episodes of", ...columns.map((one) => `#${heading(one)}`)], plain(found.map(row)));
    };
    return section("results", "Results", fields, this.report.episodes.map((sentence) => says(sentence)),
      says(this.averaged ? `Means and interquartile means (IQM) over ${this.samples(this.fields[0])} with 95% intervals. Of one seed alone: no IQM. There, and where seeds agree, the 95% interval of a share is Wilson's over its episodes, and says nothing of other seeds.`
        : `Means over ${this.samples(this.fields[0])}, of one seed${this.results.length > 1 ? " each" : ""}.${this.hasRates ? " The 95% interval of a share is Wilson's over the episodes of this seed alone." : ""}${this.results.some(({ result: { intervals } }) => intervals) ? " The 95% interval of another mean is from a bootstrap over them." : ""}`),
      h("h3", {}, `Over all episodes${this.seeds ? " of all seeds" : ""} together`), this.byTask(this.results).map(further),
      this.byTask(this.results).map(([task]) => this.docs(task)));
  }

  /** What the task says of its figures. */
  docs(task) {
    return meanings(this.report.tasks[task].described, `What the columns mean${this.several ? `, ${words(task)}` : ""}`);
  }

  /** The paper's row that a group stands beside. */
  published(group, field) {
    const rows = this.report.comparisons.flatMap(({ rows: all }) => all);
    return rows.find(({ ours }) => ours.some((one) => one.group === group.label && one.field === field))?.paper;
  }

  /** Means with their intervals, and what the paper has; nothing where one figure alone would be drawn. */
  intervals(task, field, found) {
    const { described, ranking } = this.report.tasks[task];
    if (found.length === 1 && !this.seeds && !this.published(found[0].group, field)) return null;
    const chart = (one) => {
      const { name: figure, label: title } = one;
      const visible = () => found.filter(({ group }) => !this.hidden.has(group.label)).map(({ group, index, result }) => ({ name: group.label, colour: look(index).colour, ...meanOf(result, one), paper: this.published(group, field)?.[figure] }));
      const made = new Chart(`${title}, ${fieldName(field)}`, { share: one.kind === "share", rows: [], xLabel: `mean and its 95% interval${found.some(({ group }) => this.published(group, field)) ? "; ◇ the paper" : ""}`, xFormat: one.kind === "share" ? (value) => percent(value, 0) : short });
      made.element.id = `${figure}-${field}`;
      this.redraws.push(() => {
        const all = visible();
        const most = Math.max(0.05, ...all.flatMap(({ point, interval, paper }) => [point, interval?.high ?? 0, paper ?? 0]));
        Object.assign(made, { rows: all.map(({ name }) => name), height: 62 + 24 * all.length });
        made.show({
          series: [], domain: [0, one.kind === "share" ? 1 : most * 1.05],
          table: [["group", "mean", "low", "high", "paper"], ...all.map(({ name, point, interval, paper }) => [name, point, interval?.low, interval?.high, paper])],
          read: (plot) => { const at = all[rowAt(plot)]; return at ? [`${at.name}: ${bare(one, at.point)}${at.interval ? ` (${range(one, at.interval)})` : ""}`] : []; },
          paint: (plot, pen, unit) => all.forEach(({ colour, point, interval, paper }, row) => {
            const y = plot.valToPos(row, "y", true), x = (value) => plot.valToPos(value, "x", true);
            pen.fillStyle = css(colour);
            if (interval) {
              pen.globalAlpha = 0.32;
              pen.fillRect(x(interval.low), y - 6 * unit, x(interval.high) - x(interval.low), 12 * unit);
              pen.globalAlpha = 1;
            }
            pen.fillRect(x(point) - 1.5 * unit, y - 8 * unit, 3 * unit, 16 * unit);
            if (paper === undefined) return;
            pen.strokeStyle = css("--ink");
            pen.lineWidth = 1.4 * unit;
            pen.beginPath();
            for (const [right, down] of [[0, -5], [5, 0], [0, 5], [-5, 0]]) pen.lineTo(x(paper) + right * unit, y + down * unit);
            pen.closePath();
            pen.stroke();
          }),
        });
      });
      return made.element;
    };
    return h("div", { class: "grid" }, described.filter(({ name }) => ranking.includes(name) && found.every(({ result }) => result.metrics[name])).map(chart));
  }

  /** Whether a run is of the paper's task. */
  isPapers() { return this.report.groups.some(({ metrics }) => metrics.some(({ name }) => name === "success_without_disturbance")); }

  /** The paper's tables with ours in them; rows of the paper that no group is are folded away. */
  comparisons() {
    const { comparisons, paper, statistics } = this.report;
    if (!comparisons.some(({ rows }) => rows.some((row) => row.ours.length))) return this.isPapers() ? this.none("Beside the paper: no group here is a row of its tables and evaluated on its episodes.") : null;
    const heads = (columns) => [...columns, "#seeds", ...["#mean", "#IQM", "#IQM of seeds"], ...["#mean", "#IQM", "#IQM of seeds"], "#mean"];
    const published = ({ what, paper: row }, kind, seeds) => ({ kind, row: [...what, seeds, percent(row.success), "", percent(row.success_iqm), percent(row.success_without_disturbance), "", percent(row.success_without_disturbance_iqm), ""] });
    const ours = (columns) => (one) => {
      const [low, high] = one.frames;
      const what = `ours: ${one.group}, ${one.field.endsWith("-best") ? "best checkpoint " : ""}after ${low === high ? count(low) : `${count(low)} to ${count(high)}`} frames`;
      const { success, success_without_disturbance: undisturbed, success_without_disturbance_per_axis: perAxis } = one.metrics;
      const both = [success, undisturbed].flatMap((all) => [estimate(SHARE, all.mean), ...(all.seeds > 1 ? [estimate(SHARE, all.iqm), percent(all.iqm_of_seeds)] : ["", ""])]);
      return { kind: "ours", row: [{ columns, content: over(what, one.differences.join("; ")) }, count(success.seeds), ...both, estimate(SHARE, perAxis.mean)] };
    };
    const tables = comparisons.map(({ name, title, columns, rows }) => {
      const spans = [[columns.length + 1, ""], [3, "SR"], [3, "SRwoD"], [1, "SRwoD (per axis)"]];
      const [here, not] = [rows.filter((row) => row.ours.length), rows.filter((row) => !row.ours.length)];
      const rest = not.length ? h("details", {}, h("summary", {}, here.length ? `The paper's other rows: ${not.length} of ${rows.length}` : `${title}: no group here is a row of this table and evaluated on its episodes`), table(heads(columns), not.map((row) => published(row, "absent", "not run")), spans)) : null;
      return h("div", { id: `table-${name}`, class: "stack" }, here.length ? [h("h3", {}, title), table(heads(columns), here.flatMap((row) => [published(row, null, "paper"), ...row.ours.map(ours(columns.length))]), spans)] : null, rest);
    });
    return section("paper", "Beside the paper",
      says(`Each row of the paper's tables (${paper}), and below it, shaded, our runs of its method, with the settings that are not its own. SRwoD is the paper's: successful with a total displacement of all other objects below 0.01 m; SRwoD (per axis): with no other object moved more than 0.01 m on any axis, as the program published with the paper measures it. Intervals: 95%, percentile bootstrap of ${count(statistics.resamples)} resamples, stratified by kitchen, as rliable defines it. The paper's IQM is the mean of the middle three of five seeds: ours by that definition is “IQM of seeds”.`),
      tables);
  }

  /** What each stage of training came to. */
  stages() {
    const { tasks, groups } = this.report;
    const begun = groups.map((group) => ({ group, stages: group.stages.filter(({ figures }) => Object.keys(figures).length) })).filter(({ stages }) => stages.length);
    // Those of one run stand above.
    if (!begun.length || groups.length === 1 && begun[0].stages.length > 1) return null;
    const tables = this.byTask(begun).map(([task, some]) => {
      const { shown: metrics } = tasks[task];
      return [this.several ? h("h3", {}, words(task)) : null, table([this.group, "stage", "reward", ...metrics.map((one) => `#${heading(one)}`)], plain(some.flatMap(({ group, stages }) => stages.map(({ name, reward, figures }) => [group.label, name, words(reward), ...metrics.map((one) => bare(one, figures[one.name]))]))))];
    });
    return section("stages", "Stages of training", tables, this.tenths());
  }

  /** What the figures of a stage are of. */
  tenths() { return says(`Training episodes of the newest tenth of each stage, all of them where none ended there${this.seeds ? ": means over the seeds of a group" : ""}.`); }

  /** Those of each task have axes of their own. */
  curves() {
    const { groups, tasks } = this.report;
    const trained = groups.some(({ training }) => training.length);
    if (!trained) return this.none("Learning curves: none of these runs has trained a rollout, or only their evaluations were given (name the runs' own folders, too).");
    const source = ({ label, runs, stages, metrics, training }) => {
      const of = new Map(training.map(({ metric, points }) => [metric, columns(points, stages)]));
      const newest = Object.fromEntries(Object.entries(stages.findLast(({ figures }) => Object.keys(figures).length)?.figures ?? {}).map(([metric, value]) => [metric, [value, "newest tenth"]]));
      const rates = runs.map((run) => run.frames_per_s).filter(Boolean);
      if (rates.length) newest["time/frames_per_second"] = [rates.reduce((sum, rate) => sum + rate, 0) / rates.length, "mean"];
      return { name: label, metrics, newest, budget: Math.max(...runs.map(({ budget }) => budget)), stages: stages.map(({ name, begins_at: at }) => [name, at]), of: (metric) => of.get(metric) ?? {} };
    };
    const made = Object.keys(tasks).map((task) => {
      // All groups, which have their colours by their places.
      const sources = groups.map((group) => (group.task === task ? source(group) : { name: group.label, metrics: [], stages: [], of: () => ({}) }));
      const title = `Learning curves${this.several ? `, ${words(task)}` : ""}`;
      const curves = new Curves(sources, { title, axes: ["frames"], key: "report", smoothed: "smoothed bins", most: 1, hidden: this.hidden });
      curves.keys.hidden = true;
      this.redraws.push(() => curves.draw());
      curves.element.id = this.several ? `training-${task}` : "training";
      return curves;
    }).filter(({ charts }) => charts.size).map(({ element }) => element);
    made.at(-1).append(says(`Training episodes in bins of an eightieth of the run${this.spread()}; faint, without smoothing, which begins anew with each stage. The return is under the reward of the stage, so it jumps where the reward changes. While a run stands still no time passes.`));
    return made;
  }

  /** What curves over training show of several seeds. */
  spread() { return this.seeds ? ": of several seeds their mean; shaded, from the lowest seed to the highest" : ""; }

  validation() {
    const of = ({ validation, stages }, key) => { const curve = validation.find(({ metric }) => metric === key); return curve && columns(curve.points, stages); };
    if (!this.report.groups.some(({ validation }) => validation.length)) return this.none("Validation during training: no run has any (the table [validation] of its configuration).");
    const ranked = Object.values(this.report.tasks).flatMap(({ described, ranking }) => described.filter(({ name }) => ranking.includes(name)));
    const titles = new Map(ranked.map(({ name, label, kind }) => [name, [`${label} in validation`, { share: kind === "share", sync: "curves" }]]));
    return section("validation", "Validation during training",
      this.charts([...titles.keys()], (key) => new Chart(...titles.get(key)), of),
      says(`Episodes of the validation kitchens${this.seeds ? ", where every seed was evaluated" : ""}${this.spread()}.`));
  }

  /** What a curve over thresholds has along its axis, in the words of its label: "threshold: total displacement below (m)". */
  limitOf(task, name) {
    const { label } = this.report.tasks[task].curves.find((one) => one.name === name);
    return `threshold: ${label.replace(/^.*? with (a )?/i, "")}`;
  }

  /** The curves over thresholds that a task declares. */
  limits() {
    const parts = this.byTask(this.results).flatMap(([task, found]) => this.report.tasks[task].curves.map(({ name, label, doc, marks }) => {
      const curve = (group, field) => (group.task === task && group.results.find((result) => result.field === field)?.curves[name]) || [];
      // Where no curve changes any more the chart ends.
      const end = (field) => Math.max(...Object.values(marks), ...found.map(({ group }) => {
        const points = curve(group, field);
        const last = points.findLastIndex(({ mean }) => Math.abs(mean - points.at(-1).mean) > 1e-9);
        return points[Math.min(last + 3, points.length - 1)]?.at ?? -Infinity;
      }));
      const of = (group, field) => {
        const points = curve(group, field).filter(({ at }) => at <= end(field));
        if (!points.length) return null;
        const all = (pick) => points.map(({ mean, interval }) => (interval ? pick(interval) : mean));
        return { x: points.map(({ at }) => at), y: points.map(({ mean }) => mean), ...(points.some(({ interval }) => interval) ? { low: all(({ low }) => low), high: all(({ high }) => high) } : {}) };
      };
      const log = found.every(({ result }) => result.curves[name].every(({ at }) => at > 0));
      const isCounted = found.every(({ result }) => result.curves[name].every(({ at }) => Number.isInteger(at)));
      const make = (field) => { const made = new Chart(`${label}, ${fieldName(field)}`, { share: true, log, isCounted, xLabel: this.limitOf(task, name) }); Object.assign(made.content, { placed: true, marks: Object.entries(marks).map(([word, x]) => ({ x, label: word })) }); return made; };
      return [this.charts(this.fields.filter((field) => found.some(({ result }) => result.field === field)), make, of), says(doc)];
    }));
    if (!parts.length) return null;
    return section("limits", "Success by threshold", parts, says(`Mean over ${this.samples(this.fields[0])}${this.averaged ? " with 95% stratified-bootstrap intervals" : ""}.`));
  }

  /** One episode of each run, as two policies play it where both were recorded. */
  strips() {
    // Only kitchens are drawn here.
    if (!this.drawn) return null;
    const staged = this.report.groups.some(({ stages }) => stages.length > 1) ? ` Before and after stage II: evaluate the checkpoint at stage I's end, too (\`${this.program} eval RUN/checkpoints/rollout-NUMBER.json --record all\`).` : "";
    if (!this.episodes.length) return this.none(`One episode in pictures: no run has a recorded evaluation (\`${this.program} eval RUN --record all\`).${staged}`);
    const pictures = ({ run, task, caption, strips }, index) => {
      const whose = this.names.length > 1 ? `${run}${this.several ? `, ${words(task)}` : ""}: ` : "";
      const made = h("figure", { id: `episode-${index + 1}`, class: "card stack" }, strips.map(({ title, frames }) => h("div", {}, h("h3", {}, whose, title),
        h("div", { class: "strip-frames" }, frames.map(({ png, words }) => h("div", {}, h("img", { src: png, alt: words.join(", ") }), h("small", { class: "soft" }, words.map((each, at) => [at ? ", " : "", h("span", { style: { "white-space": "nowrap" } }, each)]))))))),
      h("p", { class: "small soft" }, caption, " ", h("button", { class: "save", "aria-label": `Save the pictures of episode ${index + 1} as PNG`, onclick: () => savePictures(made, `episode-${index + 1}.png`) }, "PNG")));
      return made;
    };
    return section("episode", "One episode", this.episodes.map(pictures));
  }

  sweeps() {
    const { sweeps } = this.report;
    if (!sweeps.length) return this.isPapers() ? this.none("Weights of rewards: no two of these groups differ in one weight alone and are evaluated on the same episodes (the presets lambda-0, lambda-1, lambda-5, ..., lambda-25 are the paper's sweep of lambda_disturb).") : null;
    const chart = ({ weight, field, points }) => {
      const made = new Chart(`${weight}, ${fieldName(field)}`, { share: true, xLabel: weight });
      const { described } = this.report.tasks[this.report.groups.find(({ label }) => label === points[0].group).task];
      const ranked = described.filter(({ name }) => points.every(({ metrics }) => metrics[name]));
      const series = ranked.map(({ name, label }, index) => {
        const all = (pick) => points.map(({ metrics }) => pick(metrics[name]));
        const measured = points.some(({ metrics }) => metrics[name].interval);
        return { name: label, look: { colour: "--ink", dash: index ? [7, 3] : [] }, x: points.map(({ value }) => value), y: all(({ point }) => point),
          ...(measured ? { low: all(({ interval, point }) => interval?.low ?? point), high: all(({ interval, point }) => interval?.high ?? point) } : {}) };
      });
      made.show({ series, most: 1 });
      return made.element;
    };
    return section("sweep", "Weights of rewards", h("div", { class: "grid" }, sweeps.map(chart)), says(`Runs that differ in one weight of their rewards only: mean over ${this.samples(this.fields[0])}${this.averaged ? " with 95% stratified-bootstrap intervals" : ""}. Dashed: the second of the metrics.`));
  }

  prediction() {
    const predicting = this.results.filter(({ result: { pooled: { prediction: all } } }) => all && all.hits + all.misses + all.false_alarms + all.quiet);
    const known = predicting.filter(({ result: { pooled: { episodes, prediction: { hits, misses, false_alarms: alarms } } } }) => episodes >= FEW && hits + alarms && hits + misses);
    const rows = known.map(({ group, result }) => {
      const { precision, recall, recall_of_quiet: quiet, hits, misses, false_alarms: alarms, quiet: right } = result.pooled.prediction;
      return [group.label, fieldName(result.field), percent(precision), percent(recall), percent(quiet), count(hits + misses + alarms + right)];
    });
    if (!rows.length) return this.labelled ? this.none(`Prediction of the label: ${predicting.length ? `no evaluation has ${FEW} episodes, steps with the label, and steps foretold to have it` : "no evaluated policy has the auxiliary task that predicts it"}.`) : null;
    return section("prediction", "Prediction of the label", table([this.group, "episodes of", "#precision", "#recall", "#recall of quiet steps", "#steps"], plain(rows)),
      says("The label is a yes or no of each step, such as whether it disturbs. Of the steps foretold to have it, those that did (precision); of the steps that did, those foretold (recall)."));
  }

  /** What a policy does when. */
  actions() {
    const recorded = this.report.groups.filter(({ results }) => results[0]?.actions.actions.length);
    const found = recorded.filter(({ results: [{ pooled }] }) => pooled.episodes >= FEW);
    const few = recorded.filter((group) => !found.includes(group));
    if (few.length) this.none(`Actions by step of ${few.map(({ label }) => label).join(", ")}: fewer than ${FEW} episodes.`);
    if (!found.length) return null;
    const chart = ({ label, results: [{ field, actions: { actions, counts_by_step: all } }] }) => {
      const sums = all.map((one) => one.reduce((sum, each) => sum + each, 0));
      // To the last step of the longest episode.
      const [totals, counts] = [sums, all].map((some) => some.slice(0, sums.findLastIndex(Boolean) + 1));
      const share = (step, of) => (totals[step] ? counts[step][of] / totals[step] : null);
      const made = new Chart(`Actions, ${label}`, { rows: actions.map(action), xLabel: "step of the episode", height: 62 + 14 * actions.length });
      made.show({
        series: [], domain: [0, counts.length],
        table: [["action", "step", "share of running episodes"], ...actions.flatMap((name, of) => counts.map((_, step) => [name, step, share(step, of)]))],
        read: (plot) => { const [step, row] = [stepAt(plot), rowAt(plot)]; const value = row in actions && step >= 0 && step < counts.length ? share(step, row) : null; return value === null ? [fieldName(field)] : [`${action(actions[row])}, step ${step}: ${percent(value)}`]; },
        paint: (plot, pen) => {
          const [wide, tall] = [plot.valToPos(1, "x", true) - plot.valToPos(0, "x", true), plot.valToPos(1, "y", true) - plot.valToPos(0, "y", true)];
          actions.forEach((_, of) => counts.forEach((__, step) => {
            const value = share(step, of);
            if (value === null) return;
            pen.fillStyle = heat(value);
            pen.fillRect(plot.valToPos(step, "x", true), plot.valToPos(of - 0.5, "y", true), wide + 0.6, tall + 0.6);
          }));
        },
      });
      return made.element;
    };
    return section("actions", "Actions by step", h("div", { class: "grid broad" }, found.map(chart)),
      says("Share of the episodes still running at a step in which each action was taken. Colours are logarithmic and the same on every map: ",
        [0.001, 0.01, 0.1, 1].map((value) => h("span", { class: "whole" }, h("span", { class: "heat", style: { background: heat(value) } }), value === 0.001 ? "0.1% or less" : `${100 * value}%`)).flatMap((one) => [one, " "])));
  }

  /** Which runs there are, and which of their evaluations count. */
  runs() {
    const runs = this.report.groups.flatMap(({ label, runs: all }) => all.map((run) => [run.name, ...(this.seeds ? [label] : []), String(run.seed), run.state, count(run.frames), count(run.budget), count(run.frames_per_s), run.evaluations.join(", ") || "none yet"]));
    const counting = ([task, found]) => {
      const shares = this.printed(task, found[0].result).filter(({ kind }) => kind === "share");
      const rate = (one, { share, interval }) => over(percent(share), range(one, interval));
      const rows = found.flatMap(({ group, result }) => result.seeds.map((seed) => [fieldName(result.field), group.label, String(seed.seed), seed.evaluation, count(seed.frames), count(seed.episodes), ...shares.map((one) => rate(one, seed.rates[one.name])), h("small", { style: { "white-space": "nowrap" } }, seed.weights.slice(0, 12))]));
      return table(["episodes of", this.group, "#seed", "evaluation", "#frames", "#episodes", ...shares.map((one) => `#${one.label}`), "weights"], plain(rows));
    };
    return section("runs", "Runs and evaluations", table(["run", ...(this.seeds ? ["group"] : []), "#seed", "state", "#frames", "#of", "#frames/s, mean", "evaluations"], plain(runs)),
      this.results.length ? [h("h3", {}, "The evaluations that count"),
        says("Of several evaluations of a run on the same kind of episodes that of the newest checkpoint counts, then the one with sampled actions, then the one with the most episodes, then the newest; of several seeds one on the same episodes as the others, where there is one.", this.hasRates ? " Beneath a rate: Wilson's 95% interval over this policy's episodes, which says nothing about other seeds." : null),
        this.byTask(this.results).map(counting)] : null);
  }
}

/** Points over training as columns; a band where there are several seeds. */
function columns(points, stages) {
  const all = (name) => points.map((point) => point[name]);
  const stage = all("frames").map((frames) => stages.findLastIndex(({ begins_at: at }) => at < frames));
  return { x: all("frames"), y: all("mean"), stage, ...(points.some(({ seeds }) => seeds > 1) ? { low: all("low"), high: all("high") } : {}) };
}

const rowAt = (plot) => (plot && plot.cursor.top >= 0 ? Math.round(plot.posToVal(plot.cursor.top, "y")) : -1);
const stepAt = (plot) => (plot && plot.cursor.left >= 0 ? Math.floor(plot.posToVal(plot.cursor.left, "x")) : -1);

// Cividis (Nuñez, Anderton and Renslow 2018) at eighths of its range: the same to colour-blind readers.
const CIVIDIS = [[0, 34, 78], [26, 56, 111], [67, 78, 108], [97, 101, 111], [125, 124, 120], [155, 148, 118], [188, 174, 108], [222, 201, 88], [254, 232, 56]];

/** The colour of a share, logarithmic from a thousandth. */
function heat(share) {
  const place = 8 * Math.max(0, 1 + Math.log10(Math.max(share, 0.001)) / 3);
  const at = Math.min(7, Math.floor(place));
  return `rgb(${CIVIDIS[at].map((from, part) => Math.round(from + (place - at) * (CIVIDIS[at + 1][part] - from))).join(", ")})`;
}

/** Strips of pictures as one picture. */
function savePictures(figure, name) {
  const strips = [...figure.querySelectorAll(".strip-frames")].map((strip) => [...strip.querySelectorAll("img")]);
  const { naturalWidth: width, naturalHeight: height } = strips[0][0];
  const canvas = h("canvas", { width: width * Math.max(...strips.map((strip) => strip.length)), height: (height + 24) * strips.length });
  const pen = canvas.getContext("2d");
  pen.fillStyle = "#ffffff";
  pen.fillRect(0, 0, canvas.width, canvas.height);
  Object.assign(pen, { fillStyle: "#22262c", font: "14px system-ui, sans-serif" });
  strips.forEach((strip, row) => {
    pen.fillText(figure.querySelectorAll("h3")[row].textContent, 4, (height + 24) * row + 17);
    strip.forEach((image, at) => pen.drawImage(image, at * width, (height + 24) * row + 24));
  });
  canvas.toBlob((blob) => hand(blob, name));
}

const place = document.getElementById("report");
if (place) {
  document.title = "Stillroom report";
  new Page(document.getElementById("content"), JSON.parse(place.textContent));
  document.getElementById(location.hash.slice(1))?.scrollIntoView();
  // Nobody unfolds a sheet of paper.
  let folded = [];
  addEventListener("beforeprint", () => { folded = [...document.querySelectorAll("details:not([open])")]; for (const one of folded) one.open = true; });
  addEventListener("afterprint", () => { for (const one of folded) one.open = false; });
}
