// The table of episodes: filtered and sorted by the server, a page at a time.

import { app, every, h, json, notice, orders, replace, showOrder, sorters } from "./dom.js";
import { count, headed, number, outcome, reached, kitchenName } from "./format.js";
import { paintEnd } from "./stage.js";

// What every task's episodes have.
const COLUMNS = [["Episode", "episode", ""], ["Target", "target", ""], ["Outcome", "outcome", ""], ["Length", "length", "number optional"]];
const PAGE = 50;

/** The episodes of a run as the table last showed them. */
let listed = { keys: [] };

/** The episodes before and after one in the table as it was last shown, else among the newest of its kitchen. */
export async function neighbours(run, key, signal) {
  if (listed.run !== run || !listed.keys.includes(key)) {
    const { rows } = await json(`/api/runs/${encodeURIComponent(run)}/episodes?recorded=true&kitchen=${key.split("-")[0]}&limit=500`, { signal });
    listed = { run, keys: rows.map((row) => row.key) };
  }
  const at = listed.keys.indexOf(key);
  return [listed.keys[at - 1], at < 0 ? undefined : listed.keys[at + 1]];
}

export async function showEpisodes(root, run, query, signal) {
  const asked = { source: "", kitchen: "", target: "", outcome: "", recorded: "", range: "length", least: "", most: "", sort: "", descending: "", offset: "0" };
  for (const name of Object.keys(asked)) if (query.has(name)) asked[name] = query.get(name);
  const encoded = encodeURIComponent(run);
  const selects = {};
  const change = (name, value) => { asked[name] = value; if (name !== "offset") asked.offset = "0"; load(); };
  const select = (name, label) => {
    selects[name] = h("select", { onchange: (event) => change(name, event.target.value) });
    return h("label", {}, label, selects[name]);
  };
  const options = (name, entries) => {
    const text = JSON.stringify(entries);
    if (selects[name].dataset.entries !== text) {
      selects[name].dataset.entries = text;
      replace(selects[name], entries.map(([value, label]) => h("option", { value }, label)));
    }
    selects[name].value = asked[name];
  };
  const limit = (name, label) => h("input", { type: "number", step: "any", class: "limit", value: asked[name], "aria-label": label, oninput: (event) => change(name, event.target.value) });
  const status = h("p", { class: "soft small", role: "status" });
  const notes = h("div", {});
  const whole = h("input", { type: "checkbox", onchange: () => load() });
  // Only kitchens are drawn. Of a run at work rows are soon others, and pictures would take from its speed.
  const pictured = ({ elsewhere }) => !elsewhere && card.state !== "running";
  const canvases = new Map(), waiting = new Set();
  let paints = false;
  async function paint() {
    if (paints) return;
    paints = true;
    for (const canvas of waiting) {
      waiting.delete(canvas);
      if (canvas.isConnected) await paintEnd(canvas, run, canvas.dataset.key, signal).catch(() => {});
    }
    paints = false;
  }
  const sight = new IntersectionObserver((seen) => {
    for (const { target, isIntersecting } of seen) if (!isIntersecting) waiting.delete(target); else if (!target.dataset.step) waiting.add(target);
    paint();
  });
  signal.addEventListener("abort", () => sight.disconnect());
  const picture = (key, address) => {
    if (!canvases.has(key)) {
      canvases.set(key, h("canvas", { class: "room", width: 320, height: 240, "data-key": key, "aria-hidden": "true" }));
      sight.observe(canvases.get(key));
    }
    return h("a", { href: address, tabIndex: -1, "aria-hidden": "true" }, canvases.get(key));
  };
  const head = h("tr", {});
  const by = orders(asked, () => change("offset", "0"));
  let heads = [];
  const body = h("tbody");
  const back = h("button", { onclick: () => change("offset", String(Math.max(0, Number(asked.offset) - PAGE))) }, "Previous");
  const on = h("button", { onclick: () => change("offset", String(Number(asked.offset) + PAGE)) }, "Next");
  replace(root,
    h("div", { class: "row between" }, h("h1", {}, "Episodes"), status),
    notes,
    h("div", { class: "row filters", role: "group", "aria-label": "Filters" },
      select("source", "of"), select("kitchen", "kitchen"), select("target", "target"), select("outcome", "outcome"), select("recorded", "recording"),
      h("span", { class: "row range" }, select("range", "with"), h("label", {}, "from", limit("least", "at least")), h("label", {}, "to", limit("most", "at most"))),
      h("label", {}, whole, "all columns")),
    h("div", { class: "card scroll" }, by, h("table", { class: "fold sorted episodes" }, h("thead", {}, head), body)),
    h("div", { class: "row" }, back, on));
  options("recorded", [["", "any"], ["true", "can be simulated"], ["false", "not recorded"]]);

  const kind = (word, successes) => (successes.indexOf(word) === 0 ? "good" : successes.includes(word) ? "warn" : word === "failure" ? "bad" : "soft");
  /** A figure: of a share whether it is so. */
  const figure = (value, { is_share: share, name }) => (value === undefined ? "–" : share ? (value ? "yes" : "no") : number(value, name.endsWith("_m") ? 3 : Number.isInteger(value) ? 0 : 2));
  const row = (each, page, columns) => {
    const { successes, elsewhere, targets } = page;
    const address = each.key && `#/run/${encoded}/episode/${each.key}`;
    const places = [elsewhere ? null : kitchenName(each.kitchen, card.scenes).replace("kitchen ", ""), each.environment];
    const where = places.filter((place) => place !== null).join(" / ");
    const ended = outcome(each.outcome, successes);
    const place = where && `${elsewhere ? "environment" : "kitchen"} ${where}`;
    const called = `${[`episode ${count(each.episode)}`, each.target, place].filter(Boolean).join(", ")}: ${ended}`;
    return h("tr", { class: address ? "link" : null, onclick: (event) => { if (address && !event.target.closest("a")) location.hash = address; } },
      pictured(page) ? h("td", { class: "end" }, each.key ? picture(each.key, address) : null) : null,
      columns.isPlaced ? h("td", { class: "optional" }, where) : null,
      h("td", { "data-head": "Episode" }, address ? h("a", { href: address, "aria-label": called }, count(each.episode)) : h("span", { title: each.key ? null : "its actions were not recorded" }, count(each.episode))),
      targets.length ? h("td", { "data-head": "Target" }, each.target ?? "") : null,
      h("td", { class: `ended ${kind(each.outcome, successes)}` }, ended,
        // On a narrow screen in the place of their columns.
        h("div", { class: "narrow faint small" }, [place, `${each.length} ${each.length === 1 ? "step" : "steps"}`].filter(Boolean).join(", "))),
      h("td", { class: "number optional" }, String(each.length)),
      columns.map((column) => h("td", { class: "number", "data-head": column.label || headed(column.name) }, figure(each.figures[column.name], column))));
  };
  let shown = "", latest = 0, card = null, headings = "";
  async function load() {
    latest += 1;
    const mine = latest;
    const search = new URLSearchParams({ limit: String(PAGE) });
    for (const [name, value] of Object.entries(asked)) if (value !== "" && (name !== "range" || asked.least || asked.most)) search.set(name, value);
    const kept = new URLSearchParams([...search].filter(([name, value]) => name !== "limit" && !(name === "offset" && value === "0")));
    history.replaceState(null, "", `#/run/${encoded}/episodes${kept.size ? `?${kept}` : ""}`);
    try {
      card ??= (await json(`/api/runs/${encoded}`, { signal })).card;
      const page = await json(`/api/runs/${encoded}/episodes?${search}`, { signal });
      if (mine !== latest || signal.aborted) return;
      listed = { run, keys: page.rows.map((each) => each.key).filter(Boolean) };
      const offset = Number(asked.offset);
      back.disabled = offset === 0;
      on.disabled = offset + PAGE >= page.matching;
      const reading = page.indexed < 0.999 ? ` so far · recordings read: ${reached(page.indexed)}` : "";
      status.textContent = `${count(page.matching)} of ${count(page.total)} episodes${reading}`;
      options("source", page.sources.length ? page.sources.map((name) => [name === "training" ? "" : name, name === "training" ? "training" : name.replace("rollout-", "validation ").replace(/ 0+(?=\d)/, " ")]) : [["", "the evaluation"]]);
      selects.kitchen.parentElement.hidden = page.elsewhere;
      selects.target.parentElement.hidden = !page.targets.length;
      options("kitchen", [["", "all"], ...page.kitchens.map((kitchen) => [String(kitchen), String(kitchen)])]);
      options("target", [["", "all"], ...page.targets.map((target) => [target, target])]);
      const { successes } = page;
      const outcomes = [...successes, successes.length ? "failure" : "ended", "time-limit"].map((word) => [word, outcome(word, successes)]);
      const any = successes.length ? [["any-success", "any success"], ["any-failure", "any failure"]] : [];
      options("outcome", [["", "any"], ...any, ...outcomes]);
      // What the run's other tables have; the outcome says which successes there are.
      const main = ({ name, is_share: share }) => card.metrics.some((metric) => metric.name === name) && !(share && successes.length);
      const columns = page.columns.filter((column) => whole.checked || main(column) || column.name === asked.sort);
      const figures = columns.map(({ name, label, doc }) => [label || headed(name), name, "number", doc]);
      options("range", [["length", "length"], ...page.columns.map(({ name, label }) => [name, label || headed(name)])]);
      const numbered = page.rows.some(({ environment }) => environment !== null);
      const placed = page.elsewhere ? "Environment" : numbered ? "Kitchen / environment" : "Kitchen";
      columns.isPlaced = !page.elsewhere || numbered;
      const first = [[placed, "kitchen", "optional"], ...COLUMNS].filter(([, name]) => ({ target: page.targets.length, kitchen: columns.isPlaced })[name] ?? true);
      const names = [...first, ...figures].map(([label, name]) => `${label} ${name}`).join();
      if (headings !== names) {
        headings = names;
        heads = sorters([...first, ...figures], asked, () => change("offset", "0"));
        figures.forEach(([, , , doc], at) => { heads[first.length + at].title = doc; });
        replace(head, pictured(page) ? h("th", {}, h("span", { class: "unseen" }, "Its end")) : null, heads);
      }
      showOrder(heads, asked, by);
      const text = JSON.stringify([page.rows, names]);
      if (text === shown) return;
      shown = text;
      for (const key of canvases.keys()) if (!page.rows.some((each) => each.key === key)) canvases.delete(key);
      const subject = card.folder.match(/(.+)\/evaluations\/[^/]+$/)?.[1] ?? "RUN";
      const isBare = card.evaluation && page.elsewhere && page.rows.length && !page.rows.some(({ key }) => key);
      replace(notes, page.notes.map((note) => notice(note)), isBare ? notice(`not recorded: \`${app.program} eval ${subject} --record all\` records them`) : null);
      const focused = body.contains(document.activeElement) ? document.activeElement.getAttribute("href") : null;
      replace(body, page.rows.length ? page.rows.map((each) => row(each, page, columns)) : h("tr", {}, h("td", { colSpan: heads.length + 1, class: "soft" }, page.total ? "No episode passes the filters." : "No episode has ended yet.")));
      if (focused) body.querySelector(`a:not([tabindex])[href="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
    } catch (error) {
      if (!signal.aborted) { shown = ""; replace(notes, notice(error.message, "error")); }
    }
  }
  every(5000, signal, load);
}
