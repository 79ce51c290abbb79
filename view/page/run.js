// One run, live; or several side by side and over each other. Figures come when they change (server-sent events), curves by what is new.

import { app, command, every, follow, h, json, meanings, notice, pause, remember, remembered, replace } from "./dom.js";
import { Curves } from "./curves.js";
import { bytes, count, date, duration, figure, number, outcome, percent, reached, kitchenName, short, words } from "./format.js";
import { about, columnsOf, named, progress, reportOf, stateWord, suiteAddress, titled } from "./list.js";
import { Painter, paintEnd, pictureAddress } from "./stage.js";

/** From this share on the recordings are read: of a run at work there are always new ones. */
const READ = 0.999;
/** A view of what is seen now that is older than so many seconds says so. */
const OLD_S = 2;
/** For so long a page waits for its further parts, milliseconds. */
const SOON_MS = 1500;
/** More kitchens than this fill a column. */
const LONG = 9;

/** The curves of one run: columns that grow. */
export class Columns {
  constructor(run) { Object.assign(this, { run, name: run, edition: 0, frames: [], stage: [], elapsed_s: [], series: {}, stages: [], metrics: [], paper: {}, newest: {} }); }

  /** Asks for what is new; whether there was anything. */
  async grow(signal) {
    const told = await json(`/api/runs/${encodeURIComponent(this.run)}/curves?edition=${this.edition}&known=${this.frames.length}`, { signal });
    const fresh = told.edition !== this.edition;
    if (fresh || told.from === 0) Object.assign(this, { frames: [], stage: [], elapsed_s: [], series: {} });
    Object.assign(this, { edition: told.edition, stages: told.stages, metrics: told.metrics, paper: told.paper });
    if (!told.frames.length) return fresh;
    const before = this.frames.length;
    for (const column of ["frames", "stage", "elapsed_s"]) this[column].push(...told[column]);
    for (const [name, values] of Object.entries(told.series)) (this.series[name] ??= new Array(before).fill(null)).push(...values);
    for (const values of Object.values(this.series)) while (values.length < this.frames.length) values.push(null);
    return true;
  }

  of(metric, axis) {
    const x = axis === "time" ? this.elapsed_s.map((elapsed_s) => elapsed_s / 3600) : this.frames;
    const y = { "time/frames_per_second": this.series.frames_per_s, "time/elapsed_s": this.elapsed_s }[metric] ?? this.series[metric];
    return { x, y, stage: this.stage, frames: this.frames };
  }
}

/** An interval beneath its figure. */
const beneath = (interval) => interval && h("div", { class: "faint small whole" }, `${interval.low.replace("%", "")} – ${interval.high}`);

/** The head of a metric's column, which says what that is. */
const headOf = ({ label, doc }, kind = "number") => h("th", { scope: "col", class: kind, title: doc }, label);

function figures(live) {
  const { card } = live;
  const entry = (name, value, more, doc, interval) => [h("dt", { title: doc }, name), h("dd", {}, value, more ? h("small", {}, " ", more) : null, beneath(interval))];
  const within = ({ label }) => live.results?.intervals[live.results.heads.findIndex(([head]) => head.replace(/ \(m\)$/, "") === label)];
  const working = live.workers.filter((worker) => worker.cores !== null).reduce((sum, worker) => sum + worker.cores, 0);
  const items = [
    entry(card.evaluation ? "episodes" : "frames", count(card.done), `of ${count(card.budget)}`),
    card.left_s !== null ? entry("time left", duration(card.left_s)) : null,
    card.evaluation ? null : entry(card.state === "running" ? "frames/s now" : "frames/s, mean", count(live.frames_per_s)),
    card.metrics.filter(({ name }) => card.evaluation && name in card.figures).map((metric) => entry(metric.label, figure(metric, card.figures[metric.name]), null, metric.doc, within(metric))),
    live.cores ? entry("processor", number(working, 1), `of ${live.cores} cores`) : null,
    live.gpus.map((gpu) => entry(`GPU ${gpu.index}`, percent(gpu.busy, 0), bytes(gpu.used_mib * 2 ** 20))),
    card.evaluation || card.state === "running" || !live.frames_per_s ? null : entry("training time", duration(card.done / live.frames_per_s)),
    entry("wall time", duration(live.wall_s)),
  ];
  return h("dl", { class: "figures" }, items.filter(Boolean).flat(2).reduce((pairs, part) => {
    if (part.tagName === "DT") pairs.push(h("div", {}, part)); else pairs.at(-1).append(part);
    return pairs;
  }, []));
}

/** The stages of training and what each came to. */
function stages(live) {
  const { metrics } = live.card;
  const part = ({ frames, budget, name }) => progress(frames / budget, `stage ${name}: ${percent(frames / budget)}`);
  const taken = ({ frames, budget }) => (frames < budget ? `${short(frames)} of ${short(budget)}` : `${short(budget)}, complete`);
  return h("div", { class: "scroll" }, h("table", { class: "tight fold stages", "aria-label": "Stages" },
    h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "Stage"), h("th", { scope: "col", class: "optional" }, "Reward"), h("th", { scope: "col", class: "optional" }, "Frames"), metrics.map((metric) => headOf(metric)))),
    h("tbody", {}, live.stages.map((stage, index) => h("tr", { class: index === live.stage ? null : "soft" }, h("td", { "data-head": "Stage" }, stage.name), h("td", { class: "optional", "data-head": "Reward" }, words(stage.reward)),
      h("td", { class: "optional", "data-head": "Frames" }, h("div", { class: "meter" }, part(stage), h("span", { class: "small whole" }, taken(stage)))), metrics.map((metric) => h("td", { class: "number", "data-head": metric.label }, figure(metric, stage.figures[metric.name]))))))),
  h("p", { class: "small faint" }, "Means over the newest tenth of each stage, over all of it where no episode ended there."));
}

/** Where the time goes. */
function times(live) {
  const [simulate, infer, update] = live.shares;
  // Together they are all of it.
  const parts = [simulate, infer, update].map((share) => Math.round(100 * share));
  const shares = [...parts, Math.max(0, 100 - parts.reduce((sum, part) => sum + part, 0))];
  const colours = ["--run-0", "--run-2", "--run-1", "--faint"];
  const text = ["simulate", "infer", "update", "other"].map((name, at) => `${name} ${shares[at]}%`);
  return [
    h("div", { class: "bar", role: "img", "aria-label": text.join(", ") }, shares.map((share, at) => h("i", { style: { width: `${share}%`, background: `var(${colours[at]})` } }))),
    h("div", { class: "legend small soft" }, text.map((words, at) => h("span", {}, h("span", { class: "swatch", style: { background: `var(${colours[at]})` } }), words)))];
}

function kitchens(live, run) {
  const { metrics } = live.card;
  const most = ({ kind, name }) => (kind === "share" ? 1 : Math.max(0.01, ...live.kitchens.map((kitchen) => kitchen.figures[name] ?? 0)));
  const inks = ["--run-0", "--run-2", "--run-1", "--run-3", "--run-4", "--run-5"];
  const cell = (share, text, ink) => h("div", { class: "meter" }, h("div", { class: "bar" }, h("i", { style: { width: `${100 * share}%`, background: ink } })), h("span", {}, text));
  // A phone has room for three.
  const kind = (at) => (at > 2 ? "number optional" : "number");
  const reading = live.indexed < READ ? h("p", { class: "small soft" }, `Of the recordings ${reached(live.indexed)} are read so far.`) : null;
  // Of the oldest episodes, as yet.
  if (live.indexed < 0.9) return [reading];
  return [reading, h("div", { class: "scroll bars" }, h("table", { class: `tight meters${metrics.length > 2 ? " many" : ""}` },
    h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "Kitchen"), h("th", { scope: "col", class: "number" }, "Episodes"), metrics.map((metric, at) => headOf(metric, kind(at))))),
    h("tbody", {}, live.kitchens.map((kitchen) => h("tr", {},
      h("td", { "data-head": "Kitchen" }, h("a", { href: `#/run/${encodeURIComponent(run)}/episodes?kitchen=${kitchen.kitchen}` }, kitchenName(kitchen.kitchen, live.card.scenes).replace("kitchen ", ""))),
      h("td", { class: "number", "data-head": "Episodes" }, count(kitchen.episodes)),
      metrics.map((metric, at) => h("td", { class: kind(at), "data-head": metric.label }, cell((kitchen.figures[metric.name] ?? 0) / most(metric), figure(metric, kitchen.figures[metric.name]), `var(${inks[at % inks.length]})`))))))))].filter(Boolean);
}

/** What an evaluation came to, in the words of `eval`. */
function results({ results: { heads, rows, intervals, figures: further }, card }, run) {
  const called = ({ name, filter }) => {
    const [what, which] = filter?.split("=") ?? [];
    return filter ? h("a", { href: `#/run/${encodeURIComponent(run)}/episodes?${filter}` }, what === "kitchen" ? kitchenName(Number(which), card.scenes) : name) : name;
  };
  const cell = (text, head, interval) => h("td", { class: "number", "data-head": head }, text.replace(/^-/, "−"), beneath(interval));
  const isSame = (one, other) => one.episodes === other.episodes && one.cells.join() === other.cells.join();
  const all = rows.at(-1);
  // Of one set of objects that is all there is.
  const shown = rows.filter((row, at) => row.filter || rows.findIndex((first) => !first.filter && isSame(first, row)) === at);
  const ways = [...new Set(intervals.filter(Boolean).map(({ whose }) => whose))];
  const row = (one) => h("tr", {}, h("td", { class: "whole" }, called(one)), cell(count(one.episodes), "episodes"), one.cells.map((text, at) => cell(text, heads[at][0], !one.filter && isSame(one, all) && intervals[at])));
  return h("section", { class: "card" }, h("h2", {}, "Results"),
    h("div", { class: "scroll" }, h("table", { class: "tight fold parted", "aria-label": "Results" },
      h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "Episodes of"), h("th", { scope: "col", class: "number" }, "episodes"), heads.map(([head, doc]) => h("th", { scope: "col", class: "number", title: doc }, head)))),
      // Kitchens, objects, and what all together came to, are divided by lines.
      [...Map.groupBy(shown, ({ filter }) => filter?.split("=")[0] ?? "")].map(([of, some]) => h("tbody", { class: of ? null : "sum" }, some.map(row))))),
    ways.length ? h("p", { class: "small soft" }, `Beneath a figure: ${ways.join(" or ")} 95% interval over these episodes.`) : null,
    h("dl", { class: "figures further" }, further.map(([name, value, doc]) => h("div", { title: doc }, h("dt", {}, name), h("dd", {}, value)))));
}

let unfolded = false;

/** How many there are of each kind: "1 learner, 19 actors". */
function kinds(some) {
  const names = some.map(({ name }) => name.replace(/-\d+$/, ""));
  const many = (kind) => names.filter((name) => name === kind).length;
  return [...new Set(names)].map((kind) => `${many(kind)} ${kind}${many(kind) === 1 ? "" : "s"}`).join(", ");
}

function workers(live) {
  const alive = ({ pid, stopped }) => pid !== null || stopped;
  const ended = live.workers.filter((worker) => !alive(worker));
  // Of many actors those are seen of which there is something to say.
  const quiet = live.workers.filter(({ name, pid, stopped, incarnation, growth }) => name.startsWith("actor") && pid !== null && !stopped && incarnation < 2 && !growth);
  const folds = quiet.length > 3;
  const sum = (of) => quiet.reduce((all, worker) => all + (worker[of] ?? 0), 0);
  const shown = live.workers.filter((worker) => alive(worker) && !(folds && quiet.includes(worker)));
  return [
    shown.length ? processes(shown) : null,
    folds ? h("details", { open: unfolded, ontoggle: ({ target }) => { unfolded = target.open; } }, h("summary", { class: "small soft" }, `${quiet.length} actors run: ${number(sum("cores"), 1)} cores, ${bytes(sum("memory_bytes"))}`), processes(quiet)) : null,
    ended.length ? h("details", {}, h("summary", { class: "small soft" }, `${kinds(ended)} ${ended.length === 1 ? "has" : "have"} ended`), processes(ended)) : null,
  ].filter(Boolean);
}

function processes(some) {
  const heads = [["Process", ""], ["", ""], ["Incarnation", "number"], ["Restarts", "number"], ["Starts in all", "number optional"], ["Core", "number"], ["Memory", "number optional"]];
  const cells = (worker) => [
    worker.name,
    worker.stopped ? h("span", { class: "bad" }, "stopped") : worker.pid ? h("span", { class: "good" }, "runs") : h("span", { class: "faint" }, "ended"),
    String(worker.incarnation),
    worker.incarnation > 1 ? h("span", { class: "warn" }, String(worker.incarnation - 1)) : "0",
    String(worker.starts),
    worker.cores === null ? "–" : percent(worker.cores, 0),
    [bytes(worker.memory_bytes), worker.growth ? h("div", { class: "small warn" }, worker.growth) : null]];
  const row = (worker) => h("tr", {}, cells(worker).map((cell, at) => h("td", { class: heads[at][1], "data-head": at > 1 ? heads[at][0] : null }, cell)));
  return h("div", { class: "scroll" }, h("table", { class: "tight fold" }, h("thead", {}, h("tr", {}, heads.map(([head, kind]) => h("th", { scope: "col", class: kind }, head || h("span", { class: "unseen" }, "State"))))), h("tbody", {}, some.map(row))));
}

const lines = (log) => h("ol", { class: "log" }, log.map(({ at, level, text }) => h("li", {}, at ? h("time", {}, at.slice(11, 19)) : null, h("span", { class: level }, text))));

function starts(live) {
  return h("ol", { class: "log" }, live.starts.slice(-6).map((start) => h("li", {}, h("time", {}, date(start.at_unix_s)), `start ${start.number}, ${start.place}${start.how ? `: ${start.how}` : ""}${start.reason ? `, ${start.reason}` : ""}`)));
}

/** What chosen environments saw last: their newest episode, simulated again up to its last recorded step. */
class Depths {
  constructor(run, signal) {
    Object.assign(this, { run, signal, chosen: remembered(`depths ${run}`, null), tiles: new Map(), live: null, due: 0 });
    this.grid = h("div", { class: "tiles" });
    this.picker = h("select", { "aria-label": "Add an environment", onchange: () => { this.choose([...this.chosen, this.picker.value]); this.picker.value = ""; } });
    this.element = h("section", { class: "card" }, h("div", { class: "row between" }, h("h2", {}, "What they see now"), this.picker), this.grid);
    every(1000, signal, () => (this.live?.card.state === "running" && performance.now() > this.due ? this.refresh() : null));
    every(1000, signal, () => { for (const { age, at } of this.tiles.values()) { const seconds = Math.floor((performance.now() - at) / 1000); age.textContent = seconds > OLD_S ? ` · ${seconds} s ago` : ""; } });
  }

  choose(names) {
    this.chosen = [...new Set(names)].slice(-8);
    remember(`depths ${this.run}`, this.chosen);
    this.refresh();
  }

  know(live) {
    this.live = live;
    const all = live.kitchens.flatMap(({ kitchen, environments }) => environments.map((environment) => `${kitchen}/${environment}`));
    if (this.picker.options.length !== all.length + 1) replace(this.picker, h("option", { value: "" }, "add an environment"), all.map((name) => h("option", { value: name }, this.called(name))));
    if (live.card.state !== "running") return;
    if (this.chosen === null && all.length) {
      this.chosen = (live.kitchens.length < 3 ? all : live.kitchens.map(({ kitchen, environments }) => `${kitchen}/${environments[0]}`)).slice(0, 3);
      this.refresh();
    }
  }

  /** An environment by its kitchen. */
  called(name) {
    const [kitchen, environment] = name.split("/");
    return `${kitchenName(kitchen, this.live.card.scenes)}, environment ${environment}`;
  }

  async refresh() {
    if (this.busy || !this.chosen || this.signal.aborted) return;
    this.busy = true;
    const began = performance.now();
    for (const name of [...this.tiles.keys()]) if (!this.chosen.includes(name)) { this.tiles.get(name).element.remove(); this.tiles.delete(name); }
    const fresh = this.chosen.filter((name) => !this.tiles.has(name));
    for (const name of fresh) this.tiles.set(name, this.tile(name));
    for (const [name, tile] of [...this.tiles]) {
      try { await this.draw(name, tile); } catch (error) { if (this.signal.aborted) return; tile.caption.textContent = error.message; }
      tile.link.classList.remove("draws");
    }
    this.busy = false;
    // Nobody asked for these just now: on a machine that trains they take a tenth of one priority's share at most.
    this.due = performance.now() + Math.max(4000, 9 * (performance.now() - began));
  }

  tile(name) {
    const canvas = h("canvas", { width: 224, height: 224, role: "img", "aria-label": `Depth, environment ${name}` });
    const [caption, age] = [h("span", {}, this.called(name)), h("span", { class: "faint" })];
    const remove = h("button", { class: "small", "aria-label": `Remove environment ${name}`, onclick: () => this.choose(this.chosen.filter((each) => each !== name)) }, "×");
    const link = h("a", { class: "draws", "aria-label": `Newest episode of environment ${name}` }, canvas);
    const element = h("figure", {}, link, h("figcaption", {}, h("span", {}, caption, age), remove));
    this.grid.append(element);
    return { element, canvas, caption, age, at: NaN, link, painter: new Painter(canvas), shown: "" };
  }

  async draw(name, tile) {
    const run = encodeURIComponent(this.run);
    const asked = performance.now();
    const key = await json(`/api/runs/${run}/newest/${name}`, { signal: this.signal });
    if (key === null) { tile.caption.textContent = `${this.called(name)} · no step yet`; return; }
    tile.link.href = `#/run/${run}/episode/${key}`;
    const episode = await json(`/api/runs/${run}/episodes/${key}`, { signal: this.signal });
    const step = episode.moments.length - 1;
    await tile.painter.paint(pictureAddress(this.run, key, { view: "depth", step, width: 224, of: step }), this.signal);
    Object.assign(tile, { shown: key, at: asked });
    tile.canvas.dataset.step = String(step);
    tile.caption.textContent = [this.called(name), episode.target, `step ${step}`].filter(Boolean).join(" · ");
  }
}

/** The last moments of the newest episodes, a few of each outcome: what a run at rest has come to. */
class Thumbnails {
  constructor(run, signal) {
    Object.assign(this, { run, signal, shown: "" });
    this.grid = h("div", { class: "tiles" });
    // As many as come at most: what is below stays where it is when they do.
    this.wait = h("span", { class: "soft small", role: "status" }, "are drawn when the recordings are read");
    replace(this.grid, Array.from({ length: 6 }, () => h("figure", {}, h("canvas", { class: "room", "aria-hidden": "true" }), h("figcaption", { class: "lines" }, h("span", {}, "\u00a0"), h("span", {}, "\u00a0")))));
    this.title = h("h2", {}, "Newest episodes");
    this.element = h("section", { class: "card" }, h("div", { class: "row between" }, h("div", { class: "row" }, this.title, this.wait), h("a", { href: `#/run/${encodeURIComponent(run)}/episodes` }, "all")), this.grid);
  }

  async know(live) {
    const version = `${live.rollouts} ${live.card.done}`;
    // An evaluation's list is fixed: none of them is newer.
    if (live.card.evaluation) this.title.textContent = "Some episodes";
    // Only kitchens are drawn here.
    if (live.card.elsewhere) this.element.hidden = true;
    if (live.card.elsewhere || live.card.state === "running" || live.indexed < READ || version === this.shown) return;
    this.shown = version;
    // A machine that is busy with other work may need several tries.
    for (let left = 5; this.shown === version && !this.signal.aborted; left -= 1) {
      try { return await this.load(); } catch (error) {
        if (!left && !this.signal.aborted) { this.wait.remove(); replace(this.grid, notice(error.message, "error")); }
        if (!left) return;
      }
      await pause(5000, this.signal);
    }
  }

  async load() {
    const { signal } = this;
    const run = encodeURIComponent(this.run);
    const ask = (ended) => json(`/api/runs/${run}/episodes?recorded=true&limit=2&outcome=${ended}`, { signal });
    const { successes } = await ask("");
    const pages = await Promise.all([...successes, "any-failure"].map(ask));
    const rows = pages.flatMap((page) => page.rows);
    this.element.hidden = !rows.length;
    const kind = (word) => (successes.indexOf(word) === 0 ? "good" : successes.includes(word) ? "warn" : "bad");
    const tiles = rows.map(({ key, target, outcome: word, kitchen, episode }) => {
      const ended = outcome(word, successes);
      const canvas = h("canvas", { class: "room", width: 320, height: 240, "aria-hidden": "true" });
      const name = `${[target, `kitchen ${kitchen}`, `episode ${episode}`].filter(Boolean).join(", ")}: ${ended}`;
      const link = h("a", { class: "draws", href: `#/run/${run}/episode/${key}`, "aria-label": name }, canvas);
      return { key, canvas, link, element: h("figure", {}, link, h("figcaption", { class: "lines" }, h("span", {}, target ?? `kitchen ${kitchen}`), h("span", { class: kind(word) }, ended))) };
    });
    this.wait.remove();
    replace(this.grid, tiles.map(({ element }) => element));
    for (const { key, canvas, link } of tiles) {
      await paintEnd(canvas, this.run, key, signal);
      link.classList.remove("draws");
    }
  }
}

/** Evaluations of a run: they lie in its folder. Of a complete run without any the command that makes one. */
function evaluations(cards, { folder, evaluation, state }) {
  const own = cards.filter((card) => card.evaluation && !card.problem && card.folder.startsWith(`${folder}/`));
  if (!own.length) return state === "complete" && !evaluation ? h("p", { class: "small soft" }, "not evaluated yet: ", command(`${app.program} eval ${folder}`)) : null;
  const { metrics } = own[0];
  const row = (card) => h("tr", {}, h("td", { "data-head": "Evaluation" }, titled(card, true, true)),
    h("td", { class: "number", "data-head": "Episodes" }, count(card.done)), metrics.map((metric, at) => h("td", { class: at > 1 ? "number optional" : "number", "data-head": metric.label }, figure(metric, card.figures[metric.name]))));
  return h("section", { class: "card" }, h("h2", {}, "Evaluations"), h("div", { class: "scroll" }, h("table", { class: "tight fold" },
    h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "Evaluation"), h("th", { scope: "col", class: "number" }, "Episodes"), metrics.map((metric, at) => headOf(metric, at > 1 ? "number optional" : "number")))),
    h("tbody", {}, own.map(row)))));
}

/** What runs have come to, a line each; of one of a suite that has not begun its name and `standing`. `isBeside`: the suite is said. */
export function overview(cards, isBeside = false) {
  const labels = columnsOf(cards.filter(({ metrics }) => metrics.length));
  const state = ({ state: own, standing, why, done, budget, evaluation, left_s: left }) =>
    [stateWord(standing ?? own), why && h("div", { class: "bad small" }, why), budget && h("div", { class: "faint small whole" }, `${count(done)} of ${count(budget)} ${evaluation ? "episodes" : "frames"}${own === "running" && left !== null ? `, ${duration(left)} left` : ""}`)];
  const row = (card) => h("tr", {},
    h("td", card.evaluation ? { style: { "padding-left": "1.5rem" } } : {}, card.preset ? titled(card, isBeside, isBeside) : card.id),
    h("td", { "data-head": "Progress" }, state(card)),
    labels.map((label) => { const metric = card.metrics.find((each) => each.label === label); return h("td", { class: "number", "data-head": label }, metric && figure(metric, card.figures[metric.name])); }));
  return h("div", { class: "scroll" }, h("table", { class: "tight fold", "aria-label": "The runs" },
    h("thead", {}, h("tr", {}, ["Run", "Progress", ...labels].map((head, at) => h("th", { scope: "col", class: at > 1 ? "number" : null }, head)))),
    h("tbody", {}, cards.map(row))));
}

/** Several runs: what they have come to, a line each, and their curves over each other. */
export async function showTogether(root, runs, signal) {
  // An evaluation has no curve.
  const trained = (await json("/api/runs", { signal })).filter(({ evaluation }) => !evaluation).map(({ id }) => id);
  const columns = runs.filter((run) => trained.includes(run)).map((run) => new Columns(run));
  const curves = new Curves(columns, { signal });
  const table = h("section", { class: "card" });
  const notes = h("div", {});
  replace(root, h("h1", {}, runs.join(", ")), notes, table, curves.element);
  every(5000, signal, async () => {
    try {
      const cards = await json("/api/runs", { signal });
      const own = runs.map((run) => cards.find(({ id }) => id === run)).filter((card) => card && !card.problem);
      replace(table, overview(own));
      for (const one of columns) {
        const figures = own.find(({ id }) => id === one.run)?.figures ?? {};
        one.newest = Object.fromEntries(Object.entries(figures).map(([name, value]) => [name, [value, "newest tenth"]]));
      }
      if ((await Promise.all(columns.map((one) => one.grow(signal)))).some(Boolean)) curves.draw();
      replace(notes);
    } catch (error) {
      if (!signal.aborted) replace(notes, notice(error.message, "error"));
    }
  });
}

/** The run whose weights an evaluation plays: it lies in its folder, or says so. */
const subjectOf = (card, cards) => (card.evaluation ? cards.find((one) => !one.evaluation && !one.problem && (card.folder.startsWith(`${one.folder}/`) || card.conditions?.startsWith(`${one.id}/`)))?.id : null) ?? null;

/** One run, by its events. `crumbs`: told the run and the evaluation's name where it is one of a run that is here. */
export async function showRun(root, run, signal, crumbs) {
  const encoded = encodeURIComponent(run);
  const head = h("div", { class: "row between ends" });
  const notes = h("div", {});
  const parts = Object.fromEntries(["told", "meanings", "results", "kitchens", "workers", "warnings", "log", "validation", "evaluations", "times"].map((name) => [name, h("div", {})]));
  const columns = new Columns(run);
  const curves = new Curves([columns], { signal });
  const summary = h("section", { class: "card stack", "aria-label": "Progress" }, parts.told, parts.meanings);
  parts.told.className = "stack";
  // One after the other: each asks for what comes after the one before.
  let growth = Promise.resolve();
  const grow = () => { growth = growth.catch(() => {}).then(async () => { if (await columns.grow(signal)) curves.draw(); }); return growth; };
  const [depths, thumbnails] = [new Depths(run, signal), new Thumbnails(run, signal)];
  const card = (title, part) => h("section", { class: "card" }, h("h2", {}, title), part);
  const kitchensCard = card("By kitchen, newest 50 episodes at most", parts.kitchens);
  const [workersCard, warningsCard, timesCard] = [card("Processes", parts.workers), card("Warnings", parts.warnings), card("Where the time goes", parts.times)];
  const log = h("div", { class: "stack" }, warningsCard, card("Log", parts.log));
  // Of a run at work what it does now; of one at rest what it has come to. Two columns are about as long as each other.
  const arrange = (running, isLong, isBare) => {
    const [first, second] = [[kitchensCard], running ? [parts.evaluations, parts.validation] : [parts.validation]];
    (isLong || !running ? second : first).push(timesCard, workersCard);
    // Nothing but kitchens is listed beside it.
    if (!running) (isBare ? first : second).push(log);
    const columns = h("div", { class: "grid halves" }, [first, second].map((column) => h("div", { class: "stack" }, column)));
    replace(root, head, notes, summary, parts.results, running ? [depths.element, curves.element, columns, log] : [parts.evaluations, thumbnails.element, curves.element, columns]);
  };

  let rollouts = -1, subject = null, newest = null;
  const shown = {};
  const update = (name, element, value, make) => {
    const text = JSON.stringify(value);
    if (shown[name] === text) return;
    shown[name] = text;
    replace(element, make());
  };
  const take = (live) => {
    newest = live;
    update("head", head, [live.card.state, live.card.report, subject], () => [
      h("div", { class: "row" }, h("h1", {}, live.card.suite && [h("a", { href: suiteAddress(live.card) }, live.card.suite), " / "], named(live.card, true)), stateWord(live.card.state), h("span", { class: "soft small" }, live.card.evaluation ? ["evaluation", subject && [" of ", h("a", { href: `#/run/${encodeURIComponent(subject)}` }, subject)], " · "] : null, about(live.card))),
      h("div", { class: "row" }, h("a", { href: `#/run/${encoded}/episodes` }, "Episodes"), reportOf(run, live.card.report))]);
    update("notes", notes, [live.notes, live.go_on], () => [live.notes.map((note) => notice(note)), live.go_on && h("p", { class: "small soft" }, "go on with: ", h("code", {}, live.go_on))]);
    update("meanings", parts.meanings, live.card.metrics, () => meanings(live.card.metrics));
    update("told", parts.told, [live.card, live.results?.intervals, live.stages, live.frames_per_s, live.workers.map((worker) => worker.cores), live.gpus, Math.round(live.wall_s)], () => [figures(live), live.card.evaluation ? live.card.conditions && h("p", { class: "small soft" }, live.card.conditions) : stages(live)]);
    const running = live.card.state === "running";
    const isLong = live.kitchens.length > LONG;
    const isBare = live.card.elsewhere || live.results !== undefined;
    if (shown.running !== running || shown.isLong !== isLong || shown.isBare !== isBare) {
      Object.assign(shown, { running, isLong, isBare });
      arrange(running, isLong, isBare);
    }
    update("results", parts.results, live.results, () => live.results && results(live, run));
    update("kitchens", parts.kitchens, [live.kitchens, live.indexed], () => kitchens(live, run));
    update("times", parts.times, live.shares, () => times(live));
    update("workers", parts.workers, live.workers, () => workers(live));
    update("warnings", parts.warnings, live.warnings, () => lines(live.warnings.slice(-8)));
    timesCard.hidden = live.frames_per_s === null || live.card.evaluation;
    for (const [one, many] of [[kitchensCard, live.results ? [] : live.kitchens], [workersCard, live.workers], [warningsCard, live.warnings]]) one.hidden = !many.length;
    update("log", parts.log, [live.log, live.starts], () => [lines(live.log), h("details", {}, h("summary", { class: "small soft" }, `${live.starts.length} ${live.starts.length === 1 ? "start" : "starts"}`), starts(live)), live.recordings ? h("p", { class: "small faint" }, live.recordings) : null]);
    update("validation", parts.validation, live.validation, () => (live.validation.length ? card("Validation", h("div", { class: "scroll" }, h("table", { class: "fold" },
      h("thead", {}, h("tr", {}, ["Frames", ...live.card.metrics.map(({ label }) => label)].map((name) => h("th", { scope: "col", class: "number" }, name)))),
      h("tbody", {}, live.validation.slice(-8).map((one) => h("tr", {}, h("td", { class: "number", "data-head": "Frames" }, count(one.frames)), live.card.metrics.map((metric) => h("td", { class: "number", "data-head": metric.label }, figure(metric, one.figures[metric.name]))))))))) : null));
    depths.know(live);
    thumbnails.know(live);
    know(live);
    if (live.rollouts !== rollouts) {
      rollouts = live.rollouts;
      grow().catch((error) => { if (!signal.aborted) replace(notes, notice(error.message, "error")); });
    }
  };
  /** What the curves are told beside their points. */
  const know = (live) => {
    const tenth = Object.entries(live.stages.findLast(({ figures: known }) => Object.keys(known).length)?.figures ?? {}).map(([name, value]) => [name, [value, "newest tenth"]]);
    const rate = live.frames_per_s === null ? [] : [["time/frames_per_second", [live.frames_per_s, live.card.state === "running" ? "now" : "mean"]]];
    Object.assign(columns, { budget: live.card.budget, newest: Object.fromEntries([...tenth, ...rate]) });
  };
  const look = async () => {
    const cards = await json("/api/runs", { signal }).catch(() => []);
    // The run that an evaluation is of; its newest event says it.
    subject = subjectOf(newest.card, cards) ?? subject;
    if (subject) crumbs(subject, newest.card.folder.split("/").at(-1));
    update("evaluations", parts.evaluations, [cards, newest.card.state], () => evaluations(cards, newest.card));
  };
  const first = await json(`/api/runs/${encoded}`, { signal, waits: (reason) => replace(root, notice(reason)) });
  newest = first;
  know(first);
  // What is there soon has its place from the start.
  await Promise.race([Promise.all([look(), grow().catch(() => {})]), pause(SOON_MS, signal)]);
  take(first);
  pause(10_000, signal).then(() => every(10_000, signal, look));
  const events = follow(`/api/runs/${encoded}/live`);
  signal.addEventListener("abort", () => events.close());
  events.onmessage = ({ data }) => {
    const live = JSON.parse(data);
    if (!live.error) { take(live); return; }
    // A busy machine reads late: that matters only where something is missing.
    if (live.waits && newest.indexed >= READ && newest.card.state !== "running") return;
    shown.notes = null;
    replace(notes, live.waits ? h("p", { class: "small soft" }, live.error) : notice(live.error, "error"));
  };
  // An event of an error says nothing of it; an ordinary request does.
  events.onerror = () => json("/api/opening", { signal }).catch((error) => {
    if (!signal.aborted) { shown.notes = null; replace(notes, notice(error.message, "error")); }
  });
}
