// The pages of one episode, and of two side by side.

import { app, ask, command, h, hand, json, notice, pause, replace, say, waiting } from "./dom.js";
import { Chart, look } from "./chart.js";
import { legend } from "./curves.js";
import { neighbours } from "./episodes.js";
import { film, kinds } from "./film.js";
import { count, number, outcome, percent, quantity, reached, words } from "./format.js";
import { CAMERA_KEYS, EDGE, Stage, Strip, besides, explained, keyCaps, limit } from "./stage.js";

/** Goes through the steps of one or two episodes. */
class Player {
  constructor(stages, signal, remember) {
    Object.assign(this, { stages, signal, remember, step: 0, timer: 0 });
    this.last = Math.max(...stages.map((stage) => stage.last));
    this.strip = new Strip(stages, (step) => this.go(step), signal);
    this.range = h("input", { type: "range", min: "0", max: String(this.last), value: "0", "aria-label": "Step", style: { "--inset": `calc((50% - ${EDGE}px) / ${this.last + 1})` }, oninput: () => this.go(Number(this.range.value)) });
    this.play = h("button", { "aria-pressed": "false", title: "key: space", onclick: () => this.toggle() }, "Play");
    this.speed = h("select", { "aria-label": "Steps a second" }, [2, 5, 10, 20].map((speed) => h("option", { value: String(speed), selected: speed === 5 }, `${speed} a second`)));
    this.kinds = kinds();
    this.kind = h("select", { "aria-label": "Kind of film" }, this.kinds.map(({ name, ending }) => h("option", { value: ending }, name)));
    this.film = h("button", { class: "film", onclick: () => this.save() }, "Save film");
    const disturbed = stages.some((stage) => stage.growth().length);
    const button = (text, label, key, step) => h("button", { "aria-label": label, title: `${label}: key ${key}`, onclick: () => this.go(step()) }, text);
    this.element = h("section", { class: "card", "aria-label": "Steps" },
      h("div", { class: "player" }, this.play, button("◀", "A step back", "←", () => this.step - 1), button("▶", "A step on", "→", () => this.step + 1),
        disturbed && button("Next disturbance", "Next disturbance", "D", () => this.nextDisturbance()), this.speed,
        stages[0].isPictured && h("span", { class: "row" }, this.film, this.kind)), this.range, this.strip.element);
    const steps = [["space", "plays"], ["← →", "step"], ...(disturbed ? [["D", "next disturbance"]] : []), ...(stages.length === 1 ? [["P N", "episodes before and after"]] : [])];
    this.keys = h("details", { class: "small soft keys" }, h("summary", {}, "Keys"), keyCaps(steps), stages[0].isPictured && [h("div", {}, "click the room:"), keyCaps(CAMERA_KEYS)]);
    const keys = (event) => this.key(event);
    document.addEventListener("keydown", keys);
    signal.addEventListener("abort", () => { document.removeEventListener("keydown", keys); this.stop(); });
  }

  go(step) {
    this.step = Math.min(this.last, Math.max(0, step));
    this.range.value = String(this.step);
    this.range.setAttribute("aria-valuetext", `step ${this.step} of ${this.last}`);
    for (const stage of this.stages) stage.show(this.step);
    this.strip.draw(this.step);
    this.shown?.(this.step);
    this.remember(this.step);
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    if (event.target.closest("select, input[type=text], input[type=number]")) return;
    const onControl = event.target.closest("button, a, input");
    const steps = { ArrowLeft: -1, ArrowRight: 1, PageUp: -10, PageDown: 10, Home: -1e6, End: 1e6 };
    if (event.key in steps && !(onControl && onControl !== this.range)) { event.preventDefault(); this.go(this.step + steps[event.key]); }
    else if (event.key === " " && !onControl) { event.preventDefault(); this.toggle(); }
    else if (event.key === "d" || event.key === "D") this.go(this.nextDisturbance());
    else if ("pn".includes(event.key)) document.querySelector(`a[rel=${event.key === "p" ? "prev" : "next"}]`)?.click();
  }

  /** The next step at which something was displaced further, round to the first. */
  nextDisturbance() {
    const steps = this.stages.flatMap((stage) => stage.growth()).sort((a, b) => a - b);
    if (!steps.length) { say("Nothing is disturbed in this episode."); return this.step; }
    return steps.find((at) => at > this.step) ?? steps[0];
  }

  toggle() { if (this.timer) this.stop(); else this.start(); }

  start() {
    if (this.step >= this.last) this.go(0);
    const tick = () => {
      if (this.step >= this.last) { this.stop(); return; }
      this.go(this.step + 1);
      this.timer = setTimeout(tick, 1000 / Number(this.speed.value));
    };
    this.timer = setTimeout(tick, 100);
    this.play.textContent = "Pause";
    this.play.setAttribute("aria-pressed", "true");
  }

  stop() {
    clearTimeout(this.timer);
    this.timer = 0;
    this.play.textContent = "Play";
    this.play.setAttribute("aria-pressed", "false");
  }

  /** The whole episode from where the cameras are, as a film that the browser makes. */
  async save() {
    this.stop();
    this.film.disabled = true;
    const kind = this.kinds[this.kind.selectedIndex];
    try {
      const made = await film(this.stages, this.last, kind, Number(this.speed.value), this.signal, (done) => { this.film.textContent = `${percent(done, 0)} filmed`; });
      hand(made, `${this.stages.map((stage) => `${stage.run}-${stage.key}`).join("-and-")}.${kind.ending}`);
      say("The film is saved.");
    } catch (error) {
      if (this.signal.aborted) return;
      this.stages[0].fail(error);
    }
    Object.assign(this.film, { disabled: false, textContent: "Save film" });
    this.go(this.step);
  }
}

const figure = (title, content, kind = "card") => h("figure", { class: kind }, h("figcaption", {}, h("span", {}, title)), content);

const keep = (base) => {
  let timer = 0;
  return (step) => {
    clearTimeout(timer);
    // The address leads back to the step; browsers allow few changes a second.
    timer = setTimeout(() => { if (location.hash.startsWith(base)) history.replaceState(null, "", `${base}${base.includes("?") ? "&" : "?"}step=${step}`); }, 300);
  };
};

/** Curves of what is recorded of an episode without pictures, with the step marked; of a channel as many as there are colours. */
function channelCurves({ episode: { task, moments } }, signal) {
  const charts = [];
  for (const { name, unit } of task.channels) {
    const values = moments.map(({ channels }) => channels[name] ?? []);
    const series = Array.from({ length: Math.max(...values.map(({ length }) => length)) }, (_, at) => ({ name: `${words(name, unit)} ${at}`, x: [...moments.keys()], y: values.map((one) => one[at] ?? null) }))
      .filter(({ y }) => new Set(y.filter((value) => value !== null)).size > 1).slice(0, 7).map((one, at) => ({ ...one, look: { ...look(at), width: 1 } }));
    if (!series.length) continue;
    const chart = new Chart(`${words(name, unit)}${unit ? ` (${unit})` : ""}`, { xLabel: "step", format: (value) => number(value, 3), signal });
    charts.push({ chart, element: chart.element, show: (step) => { chart.content.marks = [{ x: step, label: "", colour: "--ink" }]; chart.plot?.redraw(false); } });
    const hidden = new Set();
    const keys = h("div", { class: "legend small" });
    const draw = () => {
      chart.show({ ...chart.content, series: series.filter((one) => !hidden.has(one.name)) });
      replace(keys, series.length > 1 ? legend(series.map((one) => one.name), hidden, draw) : []);
    };
    chart.element.append(keys);
    draw();
  }
  return charts;
}

/** A film that is longer than its steps shows their last picture for so many seconds more. */
const FILM_RESTS_S = 2;

/** The film that its own environment drew, at the step that is shown: as a picture of that; an animated one runs by itself. */
async function drawnFilm({ run, key, last, signal }) {
  const blob = await (await ask(`/api/runs/${encodeURIComponent(run)}/episodes/${key}/film`, { signal })).blob();
  const address = URL.createObjectURL(blob);
  signal.addEventListener("abort", () => URL.revokeObjectURL(address));
  const isVideo = blob.type === "video/mp4";
  const view = isVideo ? h("video", { src: address, muted: true, playsInline: true, "aria-label": "What its own environment drew" }) : h("img", { src: address, alt: "What its own environment drew" });
  const show = (step) => { if (view.duration) view.currentTime = ((step + 0.5) * (view.duration - FILM_RESTS_S)) / (last + 1); };
  if (isVideo) await new Promise((ready) => { view.onloadedmetadata = ready; view.onerror = ready; });
  const save = h("a", { href: address, download: `${run}-${key}.${isVideo ? "mp4" : "png"}`, class: "small" }, "Save film");
  return { element: h("figure", { class: "card drawn" }, h("figcaption", {}, h("span", {}, "What its environment drew"), save), view), show };
}

/** `named`: told what the episode is called. */
export async function showEpisode(root, run, key, query, signal, named) {
  named(key);
  const opened = waiting("The kitchen is built, and the episode simulated again", signal);
  replace(root, opened.element);
  const stage = await Stage.open(run, key, signal, (why) => replace(opened.words, why));
  named(stage.called());
  const player = new Player([stage], signal, keep(`#/run/${encodeURIComponent(run)}/episode/${key}`));
  const link = (text, rel, other) => other && h("a", { href: `#/run/${encodeURIComponent(run)}/episode/${other}`, rel, title: `key: ${rel[0]}` }, text);
  const beside = h("div", { class: "row", role: "navigation", "aria-label": "Other episodes" });
  neighbours(run, key, signal).then(([before, after]) => replace(beside, link("Previous in the list", "prev", before), link("Next in the list", "next", after)), () => {});
  const title = h("div", { class: "row between" }, stage.title(), beside);
  const { film, filmed } = stage.episode;
  const curves = stage.isPictured ? [] : channelCurves(stage, signal);
  const drawn = filmed ? await drawnFilm(stage) : null;
  player.shown = (step) => [drawn, ...curves].forEach((one) => one?.show(step));
  if (!stage.isPictured) replace(root, title, stage.problem,
    h("div", { class: "episode" },
      h("div", { class: "stack" }, drawn?.element, player.element, player.keys, h("section", { class: "card" }, stage.words, stage.parts)),
      h("div", { class: "side" }, h("section", { class: "card" }, stage.channels), curves.map(({ element }) => element))),
    film && !filmed && h("p", { class: "small soft" }, "its film, drawn by its own environment: ", command(film)));
  else replace(root, title, stage.problem,
    h("div", { class: "episode" },
      h("div", { class: "stack" },
        h("section", { class: "card", "aria-label": "The room" }, besides(stage.orbit.element, explained(stage.episode), stage.words, player.keys, stage.proof())),
        player.element),
      h("div", { class: "side" }, figure("What the robot sees", [stage.depth.element, stage.scale]), figure("Floor plan and path", [stage.plan.element, stage.plan.legend]),
        h("section", { class: "card stack" }, stage.moved, stage.parts, stage.channels))));
  player.go(Number(query.get("step") ?? 0));
}

/** Two runs by the last parts of their names; by letters where those are the same or fill a line. */
function short(runs) {
  const last = runs.map((run) => run.split("/").pop());
  return last[0] !== last[1] && last.every((name) => name.length <= 32) ? last : ["A", "B"];
}

/** How two episodes of one task differ, in words. */
function difference(stages) {
  const { successes, channels } = stages[0].episode.task;
  const [a, b] = stages.map(({ name, last, episode: { outcome: ended, moments } }) => ({ name, last, moments, ended: outcome(ended, successes), rank: successes.includes(ended) ? successes.indexOf(ended) : successes.length }));
  const better = b.rank < a.rank ? [b, a] : [a, b];
  const ends = a.rank === b.rank ? `Both end alike: ${a.ended}.` : `${better[0].name} ends better: ${better[0].ended}. ${better[1].name}: ${better[1].ended}.`;
  const channel = channels.find(({ name }) => name === limit(stages[0].episode.task)?.channel);
  const at = channel && [a, b].map(({ moments }) => moments.at(-1).channels[channel.name]);
  const amounts = at?.every(Boolean) ? `${words(channel.name, channel.unit)}: ${[a, b].map(({ name }, each) => `${name} ${quantity(channel, at[each], false)}`).join(", ")}.` : "";
  const parted = a.moments.findIndex(({ action: taken }, step) => taken !== b.moments[step]?.action);
  const same = parted < 0 && a.last === b.last ? "All their actions are the same." : `Their actions differ from step ${parted < 0 ? a.last + 1 : parted} on.`;
  return [ends, amounts && amounts[0].toUpperCase() + amounts.slice(1), same].join(" ");
}

export async function showCompare(root, runs, query, signal) {
  const searched = waiting("Episodes that both have are looked for", signal);
  replace(root, searched.element);
  const tell = (why) => replace(searched.words, why);
  const find = () => json(`/api/runs/${encodeURIComponent(runs[0])}/pairs/${encodeURIComponent(runs[1])}`, { signal, waits: tell });
  let [found, cards] = await Promise.all([find(), json("/api/runs", { signal })]);
  const chosen = /^[\d-]+~[\d-]+$/.test(query.get("episode") ?? "") ? query.get("episode") : null;
  // Those that differ most may not be read yet.
  while (!chosen && found.indexed < 0.999) {
    tell(`The recordings are read first: ${reached(found.indexed)}`);
    await pause(500, signal);
    found = await find();
  }
  const { total, better, rows } = found;
  if (!total && !chosen) {
    replace(root, notice(`The two have no recorded episode in common. Evaluate both on the same episodes with \`${app.program} eval RUN --record all\`.`));
    return;
  }
  const pairs = new Map(rows.map((pair) => [pair.map(({ key }) => key).join("~"), pair]));
  const asked = chosen ?? pairs.keys().next().value;
  const label = ([one, other]) => `${one.target ? `${one.target}, ` : ""}kitchen ${one.kitchen}, episode ${one.episode}: ${outcome(one.outcome)} | ${outcome(other.outcome)}`;
  const base = (name) => `#/compare/${runs.map(encodeURIComponent).join("/")}?episode=${name}`;
  const go = (name) => { location.hash = base(name); };
  const names = [...new Set([...(pairs.has(asked) ? [] : [asked]), ...pairs.keys()])];
  const picker = h("select", { onchange: () => go(picker.value) }, names.map((name) => h("option", { value: name, selected: name === asked }, pairs.has(name) ? label(pairs.get(name)) : name.replace("~", " | "))));
  const next = h("button", { disabled: names.length < 2, onclick: () => go(names[(names.indexOf(asked) + 1) % names.length]) }, "Next");
  const most = rows.length < total ? `; the list has the ${count(rows.length)} that differ most` : "; those that differ most come first";
  const place = h("div", { class: "stack" });
  const called = short(runs);
  replace(root, h("div", { class: "row between" }, h("h1", {}, "Side by side"), h("div", { class: "row choice" }, h("label", {}, "episode", picker), next)),
    h("p", { class: "small soft" }, `Both have ${count(total)} episodes: ${called[0]} ends better in ${count(better[0])}, ${called[1]} in ${count(better[1])}${most}.`), place);
  replace(place, waiting("Both are simulated again", signal).element);
  const keys = asked.split("~");
  const stages = [];
  for (const [at, run] of runs.entries()) stages.push(Object.assign(await Stage.open(run, keys[at], signal), { name: called[at] }));
  const drawn = Promise.all(stages.map((stage) => stage.drawn));
  for (const stage of stages) stage.drawn = drawn;
  const player = new Player(stages, signal, keep(base(asked)));
  // One camera for both: what is compared is seen from the same place.
  const turn = (other) => (camera) => { other.orbit.camera = structuredClone(camera); other.orbit.draw(); };
  [stages[0].turned, stages[1].turned] = [turn(stages[1]), turn(stages[0])];
  stages[1].orbit.camera = structuredClone(stages[0].orbit.camera);
  const policy = (run) => { const card = cards.find(({ id }) => id === run); return card?.preset && (card.conditions?.split(": ")[0] ?? `${card.preset} · seed ${card.seed}`); };
  replace(place,
    h("p", { class: "notice", id: "difference" }, difference(stages)),
    h("div", { class: "twins" }, stages.map((stage, at) => h("section", { class: "card stack", "aria-label": stage.run },
      h("div", {},
        h("div", { class: "row between ends" }, h("span", {}, h("strong", { style: { color: `var(--run-${at})` } }, stage.name === stage.run ? "●" : stage.name), " ", h("a", { href: `#/run/${encodeURIComponent(stage.run)}/episode/${stage.key}` }, stage.run)), h("span", { class: stage.kind() }, outcome(stage.episode.outcome, stage.episode.task.successes))),
        h("div", { class: "small soft" }, policy(stage.run)), stage.problem),
      stage.orbit.element, stage.words))),
    player.element, h("div", { class: "across" }, explained(stages[0].episode)),
    h("div", { class: "twins" }, stages.map((stage) => h("div", { class: "card stack" },
      h("div", { class: "pair" }, figure("What the robot sees", stage.depth.element, ""), figure("Floor plan and path", [stage.plan.element, stage.plan.legend], "")), stage.moved, stage.proof()))));
  player.go(Number(query.get("step") ?? 0));
}
