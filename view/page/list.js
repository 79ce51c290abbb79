// The list of runs with their state.

import { every, h, json, notice, replace } from "./dom.js";
import { count, date, duration, figure } from "./format.js";

export const stateWord = (state) => h("span", { class: `state ${state.replace(/ /g, "-")}` }, state || "?");

export function progress(share, label) {
  const width = `${(100 * Math.min(1, Math.max(0, share || 0))).toFixed(2)}%`;
  return h("div", { class: "bar", role: "img", "aria-label": label ?? width }, h("i", { style: { width } }));
}

export async function showList(root, signal) {
  const chosen = new Set();
  const together = h("button", { hidden: true, onclick: () => { location.hash = `#/run/${[...chosen].join("+")}`; } }, "Show together");
  const beside = h("button", { hidden: true, onclick: () => { location.hash = `#/compare/${[...chosen].join("/")}`; } }, "Side by side");
  const hint = h("span", { class: "soft small" }, "choose two to compare them");
  const body = h("tbody");
  const empty = h("p", { class: "soft" });
  const head = h("thead");
  // Of all tasks that runs here have.
  let metrics = [];
  const heads = () => ["", "Run", "Progress", ...metrics, "Begun"].map((name, at) => h("th", { scope: "col", class: at > 4 ? "optional" : null }, name || h("span", { class: "unseen" }, "Choose")));
  replace(root,
    h("div", { class: "row between" }, h("h1", {}, "Runs"), h("div", { class: "row" }, hint, together, beside)),
    h("div", { class: "card scroll" },
      h("table", {}, head, body), empty));

  const row = (card) => {
    const box = h("input", {
      type: "checkbox", checked: chosen.has(card.id), "aria-label": `Choose ${card.id}`,
      onchange: () => {
        if (box.checked) chosen.add(card.id); else chosen.delete(card.id);
        together.hidden = chosen.size < 2;
        hint.hidden = !together.hidden;
        beside.hidden = chosen.size !== 2;
      },
    });
    const link = h("a", { href: `#/run/${encodeURIComponent(card.id)}` }, card.id);
    if (card.problem) return h("tr", {}, h("td", {}), h("td", {}, card.id), h("td", { colSpan: 2 + metrics.length }, h("span", { class: "bad small" }, card.problem)));
    const left = card.state === "running" && card.left_s !== null ? `, ${duration(card.left_s)} left` : "";
    const done = `${count(card.done)} of ${count(card.budget)} ${card.evaluation ? "episodes" : "frames"}${left}`;
    return h("tr", {},
      h("td", {}, box),
      h("td", {}, link, h("div", { class: "faint small" }, `${card.evaluation ? "evaluation · " : ""}${card.preset} · seed ${card.seed}`)),
      h("td", {}, progress(card.done / card.budget, done), h("div", { class: "row small" }, stateWord(card.state), h("span", { class: "faint" }, done)),
        // On a narrow screen in the place of their columns.
        card.metrics.slice(2).map((metric) => h("div", { class: "narrow faint small" }, `${metric.label} ${figure(metric, card.figures[metric.name])}`))),
      metrics.map((label, at) => {
        const metric = card.metrics.find((each) => each.label === label);
        return h("td", { class: at > 1 ? "optional" : null }, metric ? figure(metric, card.figures[metric.name]) : "");
      }),
      h("td", { class: "optional soft small" }, date(card.created_unix_s)));
  };
  let shown = "";
  every(3000, signal, async () => {
    try {
      const cards = await json("/api/runs", { signal });
      const text = JSON.stringify(cards);
      if (text === shown) return;
      shown = text;
      const focused = document.activeElement?.getAttribute("aria-label") ?? document.activeElement?.getAttribute("href");
      metrics = [...new Set(cards.flatMap((card) => card.metrics.map(({ label }) => label)))];
      replace(head, h("tr", {}, heads()));
      replace(body, cards.map(row));
      // Rows are new elements: the keyboard stays where it was.
      if (focused) body.querySelector(`[aria-label="${CSS.escape(focused)}"], [href="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
      empty.textContent = cards.length ? "" : "No run yet. Start one with `orchestrator up`: it appears here.";
    } catch (error) {
      if (!signal.aborted) { shown = ""; replace(body, h("tr", {}, h("td", { colSpan: 4 + metrics.length }, notice(error.message, "error")))); }
    }
  });
}
