// A suite: what its groups have come to over their seeds, their curves, and all of its runs.

import { ask, every, h, json, notice, replace } from "./dom.js";
import { Curves } from "./curves.js";
import { count, figure } from "./format.js";
import { columnsOf, means, reportOf, runOf } from "./list.js";
import { meanOf, range } from "./report.js";
import { Columns, overview } from "./run.js";

/** The seeds of a group as one curve: their mean, and from the lowest to the highest. */
class Group {
  /** `newest`: by metric what it came to, and of what that is. */
  constructor(name, columns, newest) { Object.assign(this, { name, columns, newest }); }
  get metrics() { return this.columns.find(({ metrics }) => metrics.length)?.metrics ?? []; }
  get stages() { return this.columns[0].stages; }
  get paper() { return this.columns[0].paper; }
  get budget() { return this.columns[0].budget; }

  of(metric, axis) {
    const all = this.columns.map((one) => one.of(metric, axis)).filter(({ y }) => y?.length).sort((one, other) => other.x.length - one.x.length);
    if (all.length < 2) return all[0] ?? {};
    const over = (join) => all[0].x.map((_, at) => { const there = all.map(({ y }) => y[at] ?? null).filter((value) => value !== null); return there.length ? join(there) : null; });
    const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
    return { ...all[0], y: over(mean), low: over((values) => Math.min(...values)), high: over((values) => Math.max(...values)) };
  }
}

/** A line for each group: its mean, and beneath that, where the report is of these very seeds, its interval; and what is said of
 * them. */
function lines(own, report, place) {
  const ways = new Set();
  const labels = columnsOf(own);
  const head = ["Group", "Evaluation", "Seeds", ...labels].map((name, at) => h("th", { scope: "col", class: at > 1 ? "number" : null }, name));
  const line = ({ what, evaluation, asked, seeds, metrics, figures }) => {
    const found = report?.groups.find(({ label }) => label === what)?.results.find((result) => result.seeds.length === seeds.length && result.seeds.every((seed) => seed.evaluation === evaluation));
    const cell = (label) => {
      const metric = metrics.find((each) => each.label === label);
      const { point, interval, way } = found?.metrics[metric?.name] ? meanOf(found, metric) : { point: figures[metric?.name] };
      if (interval) ways.add(way);
      return h("td", { class: "number", "data-head": label }, metric && figure(metric, point), interval && h("div", { class: "faint small whole" }, range(metric, interval)));
    };
    return h("tr", {}, h("td", {}, what), h("td", { "data-head": "Evaluation" }, asked ?? "none yet: training, newest tenth"), h("td", { class: "number", "data-head": "Seeds" }, count(seeds.length)), labels.map(cell));
  };
  const rows = means(own).sort((one, other) => place(one) - place(other)).map(line);
  return [h("div", { class: "scroll" }, h("table", { class: "tight fold", "aria-label": "Groups" }, h("thead", {}, h("tr", {}, head)), h("tbody", {}, rows))),
    h("p", { class: "small faint" }, ways.size ? `Beneath a mean: its 95% interval, as in the report; ${[...ways].join("; ")}.` : report ? "Intervals need evaluations: `[[evaluations]]` in the suite's file." : "Intervals come with the report, when all runs have ended.", " Curves: of several seeds their mean; shaded, from the lowest seed to the highest.")];
}

/** The data of a report's page. */
async function dataOf(id, signal) {
  const page = await (await ask(`/api/runs/${encodeURIComponent(id)}/report`, { signal })).text();
  return JSON.parse(/ id="report">(.*?)<\/script>/s.exec(page)[1]).report;
}

export async function showSuite(root, name, query, signal) {
  const [head, notes, table, all] = [1, 2, 3, 4].map(() => h("div", {}));
  const kinds = new Map();
  const curves = new Curves([], { axes: ["frames"], key: "suite", signal });
  let [report, reported] = [null, ""];
  replace(root, head, notes, h("section", { class: "card" }, h("h2", {}, "Means over seeds"), table), curves.element, h("section", { class: "card" }, h("h2", {}, "Runs"), all));
  every(5000, signal, async () => {
    try {
      const cards = (await json("/api/runs", { signal })).filter(({ suite, suite_standing: standing }) => standing && suite === name);
      const folder = query.get("folder") ?? cards[0]?.suite_standing.folder;
      const own = cards.filter(({ suite_standing: standing }) => standing.folder === folder);
      if (!own.length) { replace(notes, notice(`No suite is called ${name}.`, "error")); return; }
      const [{ id, suite_standing: { counts, report: page } }] = own;
      if (page && reported !== counts) [report, reported] = [await dataOf(id, signal).catch(() => null), counts];
      const runs = await json(`/api/runs/${encodeURIComponent(id)}/suite`, { signal });
      replace(head, h("div", { class: "row between" }, h("div", { class: "row" }, h("h1", {}, `suite ${name}`), h("span", { class: "soft" }, counts)), reportOf(id, page)));
      // In the order of the suite's file.
      const place = ({ what }) => runs.findIndex(({ name: run }) => run === what || run.startsWith(`${what}-`));
      replace(table, lines(own, report, place));
      const trained = own.filter(({ evaluation, problem }) => !evaluation && !problem);
      const listed = runs.map((run) => ({ ...run, card: trained.find((card) => card.folder.endsWith(`/runs/${run.name}`)) }));
      replace(all, overview(listed.flatMap(({ name: run, state, reason, card }) => (card ? [{ ...card, standing: state, why: reason }, ...own.filter((one) => runOf(one, own) === card)] : [{ id: run, standing: state, why: reason, metrics: [] }])), true));
      const newest = new Map();
      for (const { what, seeds, figures, frames_per_s: rate } of means(trained).sort((one, other) => place(one) - place(other))) for (const card of seeds) {
        const tenth = Object.entries(figures).filter(([, value]) => value !== undefined).map(([metric, value]) => [metric, [value, "newest tenth"]]);
        newest.set(what, { ...Object.fromEntries(tenth), ...(rate && { "time/frames_per_second": [rate, "mean"] }) });
        kinds.set(what, kinds.get(what) ?? new Map());
        if (!kinds.get(what).has(card.id)) kinds.get(what).set(card.id, Object.assign(new Columns(card.id), { budget: card.budget }));
      }
      const columns = [...kinds.values()].flatMap((seeds) => [...seeds.values()]);
      curves.sources = [...kinds].map(([what, seeds]) => new Group(what, [...seeds.values()], newest.get(what)));
      if ((await Promise.all(columns.map((one) => one.grow(signal)))).some(Boolean)) curves.draw();
      replace(notes);
    } catch (error) {
      if (!signal.aborted) replace(notes, notice(error.message, "error"));
    }
  });
}
