// The list of runs with their state.

import { app, every, h, json, meanings, notice, orders, replace, showOrder, sorters, withToken } from "./dom.js";
import { count, date, duration, figure } from "./format.js";

export const stateWord = (state) => h("span", { class: `state ${state.replace(/ /g, "-")}` }, state || "?");

/** A run's name, after that of its suite, if that is not said beside it; that of an evaluation in a run's folder after both. */
export function named({ suite, id, folder }, isBeside = false) {
  const [, run, evaluation] = folder?.match(/([^/]+)(?:\/evaluations\/([^/]+))?$/) ?? [];
  return [isBeside ? null : suite, suite || evaluation ? run : id, evaluation].filter(Boolean).join(" / ");
}

/** Where the page of a run's suite is. */
export const suiteAddress = ({ suite, suite_standing: standing }) => `#/suite/${encodeURIComponent(suite)}${standing ? `?folder=${encodeURIComponent(standing.folder)}` : ""}`;

/** A link to the report of a run, or of its suite; `page`: where that lies. */
export const reportOf = (id, page, text = "Report") => page && h("a", { href: withToken(`/api/runs/${encodeURIComponent(id)}/report`), target: "_blank", title: page }, text);

/** What it trains, or the episodes that it evaluates. */
export const about = ({ task, preset, seed, asked }) => asked ?? [task, preset, `seed ${seed}`].filter(Boolean).join(" · ");

/** A link to a run or an evaluation, and beneath what it is; of an evaluation that stands below its run (`isOfRun`) its episodes, and
 * beneath its name. */
export function titled(card, isBeside = false, isOfRun = false) {
  const [first, second] = isOfRun && card.asked ? [card.asked, card.folder.split("/").at(-1)] : [named(card, isBeside), about(card)];
  return [h("a", { href: `#/run/${encodeURIComponent(card.id)}` }, first), h("div", { class: "faint small" }, card.evaluation ? "evaluation · " : null, second)];
}

export function progress(share, label) {
  const width = `${(100 * Math.min(1, Math.max(0, share || 0))).toFixed(2)}%`;
  return h("div", { class: "bar", role: "img", "aria-label": label ?? width }, h("i", { style: { width } }));
}

/** The run in whose folder an evaluation lies, if it is one of these. */
export const runOf = ({ evaluation, folder }, cards) => (evaluation ? cards.find((run) => !run.evaluation && folder.startsWith(`${run.folder}/`)) : undefined);

/** Each suite and each run with what is of it, evaluations after their run; in the order of the suites' first rows and of the runs. */
function groups(cards) {
  const suiteOf = (card) => card.suite_standing?.folder;
  const owner = new Map(cards.map((card) => [card, runOf(card, cards)]));
  const heads = cards.filter((card) => suiteOf(card) || !owner.get(card));
  const whole = (head) => [head, ...cards.filter((card) => owner.get(card) === head)];
  const all = new Map();
  for (const card of heads) all.set(suiteOf(card) ?? card.id, [...all.get(suiteOf(card) ?? card.id) ?? [], card]);
  return [...all.values()].map((group) => [...new Set([...group.filter((card) => !owner.get(card)).flatMap(whole), ...group])]);
}

/** Means over the seeds of each kind of a suite's runs: of its evaluations, in words `asked`, or of training where it has none. */
export function means(group) {
  const ended = group.filter((card) => card.evaluation && card.state === "complete");
  const kinds = new Map();
  const cards = ended.length ? ended : group.filter((card) => !card.evaluation && !card.problem);
  for (const card of cards.sort((one, other) => one.created_unix_s - other.created_unix_s)) {
    const [run, evaluation] = named(card, true).split(" / ");
    const what = run.endsWith(`-${card.seed}`) ? run.slice(0, -`-${card.seed}`.length) : run;
    const key = JSON.stringify([what, evaluation]);
    kinds.set(key, [...kinds.get(key) ?? [], card]);
  }
  return [...kinds].map(([key, seeds]) => {
    const [what, evaluation] = JSON.parse(key);
    const [{ metrics, asked }] = seeds;
    const mean = (of) => { const known = seeds.map(of).filter((value) => value !== undefined && value !== null); return known.length ? known.reduce((sum, value) => sum + value, 0) / known.length : undefined; };
    const over = (name) => mean(({ figures }) => figures[name]);
    const all = Object.fromEntries(Object.keys(seeds[0].figures).map((name) => [name, over(name)]));
    const shown = Object.fromEntries(metrics.map(({ name, quotient }) => [name, quotient ? over(quotient[0]) / over(quotient[1]) : over(name)]));
    return { what, evaluation, asked, seeds, of: `mean of ${seeds.length} ${seeds.length === 1 ? "seed" : "seeds"}: ${asked ?? "training"}`, metrics, figures: { ...all, ...shown }, frames_per_s: mean((one) => one.frames_per_s) };
  });
}

/** The metrics of these, those of more runs first; then in the order of the oldest run: a new run moves few. One that is called
 * by another's name and more comes after that one. */
export function columnsOf(cards) {
  const all = [...cards].sort((one, other) => one.created_unix_s - other.created_unix_s).flatMap((card) => card.metrics.map(({ label }) => label));
  const many = (label) => all.filter((each) => each === label).length;
  const labels = [...new Set(all)].sort((one, other) => many(other) - many(one));
  const place = (label) => labels.findIndex((first) => label.startsWith(first));
  return labels.sort((one, other) => place(one) - place(other));
}

/** What a card is sorted by; in a column that it has not it comes last. */
function place(card, column) {
  const own = { run: card.id, progress: card.done / card.budget, begun: card.created_unix_s };
  return column in own ? own[column] : card.figures?.[card.metrics.find(({ label }) => label === column)?.name];
}

export async function showList(root, query, signal) {
  const asked = { sort: query.get("sort") ?? "", descending: query.get("descending") ?? "", filter: query.get("filter") ?? "" };
  const chosen = new Set();
  const together = h("button", { hidden: true, onclick: () => { location.hash = `#/run/${[...chosen].join("+")}`; } }, "Show together");
  const beside = h("button", { hidden: true, onclick: () => { location.hash = `#/compare/${[...chosen].join("/")}`; } }, "Side by side");
  const hint = h("span", { class: "soft small" }, "choose two to compare them");
  /** Why two have no episode in common, if so. */
  const apart = ([one, other]) => (one?.elsewhere || other?.elsewhere ? "only episodes in kitchens are drawn"
    : Boolean(one?.evaluation) !== Boolean(other?.evaluation) ? "a run and an evaluation have no episode in common"
    : JSON.stringify(one?.metrics) !== JSON.stringify(other?.metrics) ? "their tasks differ: they have no episode in common" : "");
  const filter = h("input", { type: "text", placeholder: "filter", "aria-label": "Only runs with this text", value: asked.filter, oninput: () => { asked.filter = filter.value; sort(); } });
  const matches = (card) => [named(card), card.folder, about(card), card.state].join(" ").toLowerCase().includes(asked.filter.toLowerCase());
  const legend = h("div", {});
  const body = h("tbody");
  const empty = h("p", { class: "soft" });
  const head = h("thead");
  const by = orders(asked, () => sort());
  const frame = h("div", { class: "card" }, by, h("table", { class: "fold sorted runs" }, head, body), empty);
  // Of all tasks that runs here have.
  let metrics = [];
  let cards = [];
  // A frame that scrolls would keep the heads from staying in view.
  const fit = () => { frame.classList.remove("scroll"); frame.classList.toggle("scroll", frame.scrollWidth > frame.clientWidth); };
  addEventListener("resize", fit, { signal });
  /** The newest first, unless a column's head was clicked. */
  const order = () => {
    showOrder([...head.querySelectorAll("[data-column]")], asked, by);
    const sign = asked.descending ? -1 : 1;
    const value = (card) => (asked.sort ? place(card, asked.sort) ?? null : 0);
    const compare = (one, other) => (one === null) - (other === null) || sign * ((one > other) - (one < other));
    const sorted = cards.filter(matches).sort((a, b) => compare(value(a), value(b)));
    replace(body, groups(sorted).flatMap((group) => [group[0].suite_standing && [heading(group[0]), means(group).filter(({ seeds }) => seeds.length > 1).map(mean)], ...group.map(row)]));
    fit();
  };
  const sort = () => {
    for (const [name, value] of Object.entries(asked)) if (value) query.set(name, value); else query.delete(name);
    history.replaceState(null, "", `#/${query.size ? `?${query}` : ""}`);
    order();
  };
  replace(root,
    h("div", { class: "row between chooser" }, h("h1", {}, "Runs"), h("div", { class: "row" }, hint, together, beside, filter)),
    legend, frame);

  const cells = (card) => metrics.map((label, at) => {
    const metric = card.metrics.find((each) => each.label === label);
    const lacks = !Number.isFinite(card.figures[metric?.name] ?? NaN);
    return h("td", { "data-head": label, class: `number${at > 1 ? " optional" : ""}${lacks ? " lacking" : ""}` }, metric && figure(metric, card.figures[metric.name]));
  });
  const mean = (one) => h("tr", { class: "mean", style: { "--indent": "1.5rem" } }, h("td", {}), h("td", {}, one.what, h("div", { class: "faint small" }, one.of)), h("td", {}), cells(one), h("td", { class: "optional" }));
  const heading = ({ id, suite, suite_standing: { folder, counts, report } }) => h("tr", {}, h("td", {}), h("td", { class: "suite", colSpan: 3 + metrics.length },
    h("a", { href: suiteAddress({ suite, suite_standing: { folder } }) }, `suite ${suite}`), `: ${counts}`, report && [" · ", reportOf(id, report, "report")]));
  const row = (card) => {
    const box = h("input", {
      type: "checkbox", checked: chosen.has(card.id), "aria-label": `Choose ${card.id}`,
      onchange: () => {
        if (box.checked) chosen.add(card.id); else chosen.delete(card.id);
        together.hidden = chosen.size < 2;
        hint.hidden = !together.hidden;
        beside.hidden = chosen.size !== 2;
        beside.title = apart([...chosen].map((id) => cards.find((one) => one.id === id)));
        beside.disabled = beside.title !== "";
      },
    });
    const isNested = runOf(card, cards) !== undefined;
    const indent = (card.suite_standing ? 1.5 : 0) + (isNested ? 1.5 : 0);
    if (card.problem) return h("tr", {}, h("td", {}), h("td", {}, card.id), h("td", { colSpan: 2 + metrics.length }, h("span", { class: "bad small" }, card.problem)));
    const left = card.state === "running" && card.left_s !== null ? `, ${duration(card.left_s)} left` : "";
    const isWhole = card.state === "complete" && card.done >= card.budget;
    const done = `${count(card.done)}${isWhole ? "" : ` of ${count(card.budget)}`} ${card.evaluation ? "episode" : "frame"}${card.budget === 1 ? "" : "s"}${left}`;
    return h("tr", { style: { "--indent": `${indent}rem` } },
      h("td", {}, box),
      h("td", {}, titled(card, Boolean(card.suite_standing), isNested), card.report && h("div", { class: "small" }, reportOf(card.id, card.report))),
      h("td", {}, card.state === "running"
        ? [progress(card.done / card.budget, done), h("div", { class: "small" }, stateWord(card.state), h("div", { class: "faint whole" }, done))]
        : h("div", { class: "small whole" }, stateWord(card.state), h("span", { class: "faint" }, `, ${done}`))),
      cells(card),
      h("td", { "data-head": "Begun", class: "optional entire soft small whole" }, date(card.created_unix_s)));
  };
  let shown = "";
  every(3000, signal, async () => {
    try {
      cards = await json("/api/runs", { signal });
      const text = JSON.stringify(cards);
      if (text === shown) return;
      shown = text;
      const focused = document.activeElement?.getAttribute("aria-label") ?? document.activeElement?.getAttribute("href");
      metrics = columnsOf(cards);
      const columns = [["Run", "run"], ["Progress", "progress"], ...metrics.map((label, at) => [label, label, at > 1 ? "number optional" : "number"]), ["Begun", "begun", "optional"]];
      const described = [...new Map(cards.flatMap((card) => card.metrics).map((one) => [one.label, one])).values()];
      if (head.dataset.columns !== metrics.join()) {
        replace(head, h("tr", {}, h("th", {}, h("span", { class: "unseen" }, "Choose")), sorters(columns, asked, sort)));
        for (const one of head.querySelectorAll("[data-column]")) one.title = described.find(({ label }) => label === one.dataset.column)?.doc ?? "";
        replace(legend, metrics.length ? [h("p", { class: "small soft" }, "Of a run: means over the newest tenth of its newest stage; of an evaluation: over all its episodes."), meanings(described)] : []);
      }
      head.dataset.columns = metrics.join();
      order();
      hint.hidden = !together.hidden || cards.length < 2;
      // Rows are new elements: the keyboard stays where it was.
      if (focused) body.querySelector(`[aria-label="${CSS.escape(focused)}"], [href="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
      replace(empty, cards.length ? null : `No run yet. Start one with \`${app.program} up\`: it appears here.`);
    } catch (error) {
      if (!signal.aborted) { shown = ""; replace(body, h("tr", {}, h("td", { colSpan: 4 + metrics.length }, notice(error.message, "error")))); }
    }
  });
}
