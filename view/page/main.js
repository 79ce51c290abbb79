// Which page is shown: the part of the address after #.

import { app, h, json, notice, replace, say, takeToken } from "./dom.js";
import { showList } from "./list.js";
import { showRun, showTogether } from "./run.js";
import { showEpisodes } from "./episodes.js";
import { showEpisode, showCompare } from "./episode.js";
import { showPlay } from "./play.js";
import { showSuite } from "./suite.js";

const content = document.getElementById("content");
const crumbs = document.getElementById("crumbs");
let leaving = new AbortController();
let opening = null;

/** The parts of the address: `#/run/a+b/episodes?kitchen=3` is ["run", "a+b", "episodes"] and its query. */
function place() {
  const [path, query = ""] = location.hash.replace(/^#\/?/, "").split("?");
  return { parts: path.split("/").filter(Boolean).map(decodeURIComponent), query: new URLSearchParams(query) };
}

function crumb(text, href) {
  return href ? h("a", { href }, text) : h("span", { "aria-current": "page" }, text);
}

async function show() {
  leaving.abort();
  leaving = new AbortController();
  const { signal } = leaving;
  if (takeToken()) opening = null;
  const { parts, query } = place();
  const root = h("div", { class: "stack" });
  replace(content, root);
  const [kind, runs, what, key] = parts;
  const first = runs?.split("+")[0];
  const run = `#/run/${runs}`;
  try {
    opening ??= await json("/api/opening");
    Object.assign(app, { program: opening.program });
    if (signal.aborted) return;
    if (!kind && opening.runs.length && !query.has("all")) {
      location.replace(opening.compare ? `#/compare/${opening.runs.join("/")}` : `#/run/${opening.runs.slice(0, 6).join("+")}`);
      return;
    }
    if (!kind && opening.play && !query.has("all")) {
      location.replace("#/play");
      return;
    }
    if (kind === "play") {
      title("A policy at work", [crumb("at work")]);
      await showPlay(root, opening, signal);
    } else if (!kind) {
      title("Runs", []);
      await showList(root, query, signal);
    } else if (kind === "suite" && runs) {
      title(`suite ${runs}`, [crumb(`suite ${runs}`)]);
      await showSuite(root, runs, query, signal);
    } else if (kind === "run" && what === "episodes") {
      title(`Episodes of ${first}`, [crumb(first, run), crumb("episodes")]);
      await showEpisodes(root, first, query, signal);
    } else if (kind === "run" && what === "episode") {
      const named = (name) => title(`${name} of ${first}`, [crumb(first, run), crumb("episodes", `${run}/episodes`), crumb(name)]);
      await showEpisode(root, first, key, query, signal, named);
    } else if (kind === "run" && runs) {
      title(runs.split("+").join(", "), [crumb(runs.split("+").join(", "))]);
      await (runs.includes("+") ? showTogether(root, runs.split("+"), signal) : showRun(root, runs, signal, (subject, evaluation) => title(runs, [crumb(subject, `#/run/${encodeURIComponent(subject)}`), crumb(evaluation)])));
    } else if (kind === "compare" && parts.length >= 3) {
      title("Side by side", [crumb(parts[1], `#/run/${parts[1]}`), crumb(parts[2], `#/run/${parts[2]}`), crumb("side by side")]);
      await showCompare(root, parts.slice(1, 3), query, signal);
    } else {
      title("Nothing here", []);
      replace(root, notice("There is no such page."), h("p", {}, h("a", { href: "#/?all" }, "All runs")));
    }
  } catch (error) {
    if (error.name !== "AbortError" && !signal.aborted) replace(root, notice(error.message, "error"));
  }
}

function title(text, path) {
  document.title = `${text} · Stillroom`;
  replace(crumbs, path.length ? [crumb("runs", "#/?all"), path] : []);
  say(text);
}

addEventListener("hashchange", () => { show(); content.focus({ preventScroll: true }); scrollTo(0, 0); });
show();
