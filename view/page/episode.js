// The pages of one episode, and of two side by side.

import { h, hand, json, notice, replace, say, waiting } from "./dom.js";
import { film, kinds } from "./film.js";
import { outcome } from "./format.js";
import { Stage, Strip, besides, explained } from "./stage.js";

/** Goes through the steps of one or two episodes. */
class Player {
  constructor(stages, signal, remember) {
    Object.assign(this, { stages, signal, remember, step: 0, timer: 0 });
    this.last = Math.max(...stages.map((stage) => stage.last));
    this.strip = new Strip(stages, (step) => this.go(step), signal);
    this.range = h("input", { type: "range", min: "0", max: String(this.last), value: "0", "aria-label": "Step", oninput: () => this.go(Number(this.range.value)) });
    this.play = h("button", { "aria-pressed": "false", onclick: () => this.toggle() }, "Play");
    this.speed = h("select", { "aria-label": "Steps a second" }, [2, 5, 10, 20].map((speed) => h("option", { value: String(speed), selected: speed === 5 }, `${speed} a second`)));
    this.kinds = kinds();
    this.kind = h("select", { "aria-label": "Kind of film" }, this.kinds.map(({ name, ending }) => h("option", { value: ending }, name)));
    this.film = h("button", { class: "film", onclick: () => this.save() }, "Save film");
    this.element = h("section", { class: "card", "aria-label": "Steps" },
      h("div", { class: "player" }, this.play, this.speed, this.range, h("span", { class: "row" }, this.film, this.kind)), this.strip.element,
      h("p", { class: "small soft keys" }, h("kbd", {}, "←"), " ", h("kbd", {}, "→"), " step  ", h("kbd", {}, "space"), " play  ", h("kbd", {}, "D"), " next disturbance"));
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
      const made = await film(this.stages, this.last, kind, Number(this.speed.value), this.signal, (step) => { this.film.textContent = `step ${step} of ${this.last}`; });
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

const figure = (title, content) => h("figure", { class: "card" }, h("figcaption", {}, h("span", {}, title)), content);

const keep = (base) => {
  let timer = 0;
  return (step) => {
    clearTimeout(timer);
    // The address leads back to the step; browsers allow few changes a second.
    timer = setTimeout(() => { if (location.hash.startsWith(base)) history.replaceState(null, "", `${base}${base.includes("?") ? "&" : "?"}step=${step}`); }, 300);
  };
};

export async function showEpisode(root, run, key, query, signal) {
  const { element, words } = waiting("The kitchen is built, and the episode simulated again", signal);
  replace(root, element);
  const stage = await Stage.open(run, key, signal, (why) => { words.textContent = why; });
  const player = new Player([stage], signal, keep(`#/run/${encodeURIComponent(run)}/episode/${key}`));
  replace(root, stage.title(), stage.problem,
    h("div", { class: "episode" },
      h("div", { class: "stack" },
        h("section", { class: "card", "aria-label": "The room" }, besides(stage.orbit.element, stage.words, explained(stage.episode), stage.proof())),
        player.element),
      h("div", { class: "side" }, figure("What the robot sees", h("div", { class: "picture" }, stage.depth)), figure("Floor plan and way", stage.plan.element),
        h("section", { class: "card stack" }, stage.moved, stage.parts, stage.channels))));
  player.go(Number(query.get("step") ?? 0));
}

/** The recorded episodes of a run by what makes them the same: kitchen and number, in a training run environment and seed, too. */
async function index(run, signal) {
  const at = `/api/runs/${encodeURIComponent(run)}`;
  const [{ card }, page] = await Promise.all([json(at, { signal }), json(`${at}/episodes?recorded=true&sort=kitchen&limit=500`, { signal })]);
  // Only a training run has sources: there an environment's number and the seed count, too.
  const [where, drawn] = page.sources.length ? [(row) => `${row.kitchen}/${row.environment}`, card.seed] : [(row) => row.kitchen, ""];
  const rows = new Map(page.rows.map((row) => [`${where(row)}:${row.episode}:${row.target ?? ""}:${drawn}`, row]));
  return { rows, cut: page.matching > page.rows.length };
}

export async function showCompare(root, runs, query, signal) {
  replace(root, h("p", { class: "soft", role: "status" }, "Looking for episodes that both have …"));
  const found = await Promise.all(runs.map((run) => index(run, signal)));
  const [ones, others] = found.map(({ rows }) => rows);
  const cut = found.some((one) => one.cut) ? notice("Only the first 500 recorded episodes of each, by kitchen, are compared.") : null;
  const both = [...ones.keys()].filter((name) => others.has(name));
  if (!both.length) {
    replace(root, notice("The two have no recorded episode in common. Evaluate both on the same episodes with `orchestrator eval RUN --record all`."));
    return;
  }
  const asked = both.includes(query.get("episode")) ? query.get("episode") : both[0];
  const place = h("div", { class: "stack" });
  const label = (name) => {
    const [kitchen, episode, target] = name.split(":");
    const ends = [ones, others].map((all) => outcome(all.get(name).outcome));
    return `kitchen ${kitchen}, episode ${episode}${target ? `, ${target}` : ""}: ${ends.join(" | ")}`;
  };
  const base = (name) => `#/compare/${runs.map(encodeURIComponent).join("/")}?episode=${encodeURIComponent(name)}`;
  const picker = h("select", { onchange: () => { location.hash = base(picker.value); } }, both.map((name) => h("option", { value: name, selected: name === asked }, label(name))));
  replace(root, h("div", { class: "row between" }, h("h1", {}, "Side by side"), h("label", {}, "episode", picker)), cut, place);
  replace(place, waiting("Both are simulated again", signal).element);
  const keys = [ones, others].map((all) => all.get(asked).key);
  const stages = [await Stage.open(runs[0], keys[0], signal), await Stage.open(runs[1], keys[1], signal)];
  const player = new Player(stages, signal, keep(base(asked)));
  // One camera for both: what is compared is seen from the same place.
  const turn = (other) => (camera) => { other.orbit.camera = structuredClone(camera); other.orbit.draw(); };
  [stages[0].turned, stages[1].turned] = [turn(stages[1]), turn(stages[0])];
  stages[1].orbit.camera = structuredClone(stages[0].orbit.camera);
  replace(place,
    h("div", { class: "twins" }, stages.map((stage) => h("section", { class: "card stack", "aria-label": stage.run },
      h("div", { class: "row between" }, h("a", { href: `#/run/${encodeURIComponent(stage.run)}/episode/${stage.key}` }, stage.run), h("span", { class: stage.kind() }, outcome(stage.episode.outcome))),
      stage.problem, stage.orbit.element, stage.words, h("div", { class: "grid" }, h("div", { class: "picture" }, stage.depth), stage.plan.element), stage.moved, stage.proof()))),
    player.element);
  player.go(Number(query.get("step") ?? 0));
}
