// A policy that plays: one of its environments after the other, step by step, at its rate.

import { h, json, notice, pause, replace, say, waiting } from "./dom.js";
import { count, figure, kitchenName } from "./format.js";
import { CAMERA_KEYS, DRAFT, Stage, besides, explained, keyCaps } from "./stage.js";

/** How long the end of an episode is looked at, and how long to wait where there is nothing new, milliseconds. */
const END = 2500;
const LOOK = 400;
/** So long without a step it says what it waits for, milliseconds. */
const SILENCE = 1500;
/** Number of the first procedural kitchen. */
const FIRST_PROCEDURAL = 1000;

/** The environment that is watched. The evaluation may be another one when all episodes have been played. */
class SceneRenderer {
  constructor(root, { play: policy = "", speed }, signal) {
    // Steps a second, as a policy plays by default.
    Object.assign(this, { policy, signal, speed: speed ?? 5, run: null, chosen: null, seen: null, skips: false, live: null, still: false, stage: null, over: [] });
    this.title = h("h1", {}, "A policy at work");
    [this.plays, this.terms] = [h("span", {}, policy), h("span", { class: "soft" })];
    this.alone = h("span", { class: "soft small", hidden: true }, "picture paused; the policy plays on");
    this.tally = h("p", { class: "soft small", role: "status" }, "No episode has ended yet.");
    this.picker = h("select", { "aria-label": "Kitchen", hidden: true, onchange: () => { this.chosen = this.picker.value; } });
    this.link = h("a", { href: "#/?all", hidden: true }, "All episodes");
    this.button = h("button", { "aria-pressed": "false", hidden: true, onclick: () => this.toggle() }, "Pause");
    this.wait = waiting("The policy is loaded, and its kitchens are built", signal);
    this.place = h("div", {}, h("section", { class: "card" }, h("p", {}, "Here a robot will be seen at its task, step by step, episode after episode. The menu above chooses the kitchen.")));
    root.classList.add("work");
    replace(root, h("div", { class: "row between plays" }, this.title, this.wait.element, h("div", { class: "row" }, this.alone, this.button, this.picker, this.link)), h("div", { class: "tells" }, h("p", { class: "small" }, this.plays, " ", this.terms), this.tally), this.place);
  }

  /** Says what it waits for; nothing without a text. */
  waits(text) {
    const { style } = this.wait.element;
    if (text && (text !== this.wait.words.textContent || style.visibility === "hidden")) this.wait.renew(text);
    // Its line stays: nothing jumps.
    style.visibility = text ? "visible" : "hidden";
  }

  toggle() {
    this.still = !this.still;
    this.button.textContent = this.still ? "Play" : "Pause";
    this.button.setAttribute("aria-pressed", String(this.still));
    this.alone.hidden = !this.still;
    say(this.still ? "paused" : "goes on");
  }

  /** Looks how the newest evaluation stands; whether there is something to see. */
  async look() {
    const { signal } = this;
    const [newest] = await json("/api/runs", { signal });
    if (!newest) return false;
    // Of the round before it what was played is shown first.
    const left = this.run !== null && this.run !== newest.id && await this.next().catch(() => null);
    if (left && left !== this.seen?.key) return true;
    if (this.run !== newest.id) Object.assign(this, { run: newest.id, over: [] });
    await this.renew();
    const { card, kitchens } = this.live;
    const places = kitchens.flatMap(({ kitchen, environments }) => environments.map((environment) => `${kitchen}/${environment}`));
    if (this.picker.options.length !== places.length) {
      replace(this.picker, places.map((name) => h("option", { value: name, selected: name === this.chosen }, kitchenName(name.split("/")[0], card.scenes))));
      this.picker.hidden = places.length < 2;
    }
    if (!places.includes(this.chosen)) this.chosen = places[0] ?? null;
    if (card.conditions) {
      // Of a run that trains each round plays the newest checkpoint.
      const [plays, terms] = card.conditions.split(": ");
      const isAsked = this.policy.includes(plays.split(" (")[0]);
      replace(this.plays, isAsked ? this.policy : plays.split(", ")[0]);
      const said = [...plays.split(", ").slice(1), terms].filter(Boolean).join(", ");
      this.terms.textContent = said && `· ${said}`;
    }
    return this.chosen !== null;
  }

  /** Looks how many episodes have ended, and says what they came to: those that this page has shown to their ends, and all. */
  async renew() {
    const run = encodeURIComponent(this.run);
    this.live = await json(`/api/runs/${run}`, { signal: this.signal });
    const { over, live: { kitchens, card: { done, metrics, figures, scenes } } } = this;
    this.link.href = `#/run/${run}/episodes`;
    this.link.hidden = !done;
    this.link.textContent = done === 1 ? "The episode that has ended" : `All ${count(done)} episodes`;
    const mean = ({ name }) => over.reduce((sum, episode) => sum + (episode.figures[name] ?? 0), 0) / over.length;
    const said = (text, known, value) => [text, ...known.map((metric) => `${metric.label} ${figure(metric, value(metric), 0)}`)].join(", ");
    const where = kitchens.length === 1 ? kitchenName(kitchens[0].kitchen, scenes) : `${kitchens.length} kitchens`;
    const all = said(`${count(done)} ${done === 1 ? "episode" : "episodes"} ended in ${where}`, metrics.filter(({ name, kind }) => kind === "share" && name in figures), ({ name }) => figures[name]);
    const shown = said(`you watched ${count(over.length)} to the end`, metrics.filter(({ name }) => name in (over[0]?.figures ?? {})), mean);
    const text = done || over.length ? `${all}; ${shown}.` : "No episode has ended yet.";
    if (this.tally.textContent !== text) this.tally.textContent = text;
  }

  /** The episode after the one that was shown last, once it has begun; the newest where none was, or where that is asked for. */
  async next() {
    const newest = await this.newest();
    const { seen, skips } = this;
    // A procedural kitchen is one of many that its environment goes through: it has only some of the numbers.
    const goesOn = newest && seen?.where === `${this.run} ${this.chosen}` && !skips && newest.split("-")[0] < FIRST_PROCEDURAL;
    if (!goesOn) return newest;
    const [kitchen, environment, number] = newest.split("-").map(Number);
    return `${kitchen}-${environment}-${Math.min(number, seen.number + 1)}`;
  }

  /** The episode that is not there yet, in words. */
  awaited() { return `${this.seen ? "Next" : "First"} episode in ${kitchenName(this.chosen.split("/")[0], this.live.card.scenes)}`; }

  newest() { return json(`/api/runs/${encodeURIComponent(this.run)}/newest/${this.chosen}`, { signal: this.signal }); }

  /** Shows an episode to its end, or until another kitchen is chosen; it may still go on. */
  async show(key) {
    const { signal, run, chosen } = this;
    this.waits(this.awaited());
    const stage = await Stage.open(run, key, signal);
    this.waits("");
    this.button.hidden = false;
    this.stage = stage;
    const end = h("span", {});
    const number = Number(key.split("-")[2]);
    const newer = h("span", { class: "soft" });
    const counted = (newest) => {
      const ahead = newest.split("-")[2] - number;
      replace(newer, ahead > 0 ? [` the policy is ${ahead === 1 ? "an episode" : `${ahead} episodes`} ahead `, h("button", { class: "small", onclick: () => { this.skips = true; } }, "Show the newest")] : null);
    };
    counted(await this.newest() ?? key);
    // The policy does not wait for this page.
    const [first, before] = [(this.seen?.where === `${run} ${chosen}` ? this.seen.number : number) + 1, number - 1];
    const missed = first < before ? `episodes ${first} to ${before} were not shown` : first === before ? `episode ${first} was not shown` : "";
    Object.assign(this, { seen: { where: `${run} ${chosen}`, number, key }, skips: false });
    const { target } = stage.episode;
    const task = target ? `Bring the ${target} (pink) to its goal (green), and displace nothing else (violet)` : "Reach the goal (green)";
    replace(this.place, h("div", { class: "episode" },
      h("section", { class: "card stack", "aria-label": "The room" },
        h("div", {}, h("strong", {}, task), h("div", { class: "small ending" }, `episode ${stage.episode.number} in ${stage.place} `, end), h("div", { class: "small row newer" }, h("span", { class: "soft optional" }, missed), newer)), stage.problem,
        besides(stage.orbit.element, explained(stage.episode), stage.words, h("div", { class: "small soft keys" }, keyCaps([["space", "pause"], ...CAMERA_KEYS])), stage.moved)),
      h("div", { class: "side" }, h("figure", { class: "card" }, h("figcaption", {}, "What the robot sees"), stage.depth.element, stage.scale), h("figure", { class: "card" }, h("figcaption", {}, "Floor plan and path"), stage.plan.element, stage.plan.legend))));
    this.camera(stage);
    const interval = 1000 / this.speed;
    // A step's picture is asked for while the one before it is looked at.
    stage.orbit.may = [Math.max(DRAFT[0], 0.8 * interval), DRAFT[1]];
    stage.orbit.rests(false);
    stage.orbit.follow(0);
    stage.show(0);
    this.place.dataset.episode = key;
    let newest = performance.now(), due = newest;
    for (let step = 1; !signal.aborted && this.chosen === chosen && !this.skips;) {
      stage.orbit.rests(this.still);
      if (this.still) {
        await pause(LOOK / 4, signal);
        due = performance.now();
      } else if (step <= stage.last) {
        // Every step is seen, and what is said is of that step: on a machine that draws slowly the policy gets ahead.
        await pause(Math.max(0, due - performance.now()), signal);
        stage.orbit.follow(step);
        stage.paint(step);
        while (!stage.isPainted() && !signal.aborted && this.chosen === chosen) await pause(5, signal);
        stage.tell();
        this.place.dataset.step = String(step);
        newest = performance.now();
        due = Math.max(due + interval, newest);
        this.waits("");
        step += 1;
        if (step <= stage.last) stage.load(step);
      } else if (stage.episode.outcome !== "unfinished") {
        const ended = stage.ended();
        stage.orbit.rests(true);
        replace(end, h("span", { class: stage.kind() }, ended), ` after ${count(stage.last)} steps`);
        this.over.push(stage.episode);
        await this.renew();
        say([stage.episode.target, ended].filter(Boolean).join(": "));
        await pause(END, signal);
        return;
      } else {
        if (performance.now() - newest > SILENCE) this.waits("The policy's next step is waited for");
        await pause(LOOK, signal);
        stage.episode = await json(`/api/runs/${encodeURIComponent(run)}/episodes/${key}`, { signal });
        // A newer one has begun, and this one was cut off.
        const begun = await this.newest();
        counted(begun ?? key);
        if (step > stage.last && begun !== key) return;
      }
    }
  }

  /** In the same kitchen the camera stays where the visitor has put it. */
  camera(stage) {
    const kitchen = this.chosen;
    if (this.turned?.kitchen === kitchen) stage.orbit.camera = structuredClone(this.turned.camera);
    stage.turned = (camera) => { this.turned = stage.orbit.isHome() ? null : { kitchen, camera: structuredClone(camera) }; };
  }
}

export async function showPlay(root, opening, signal) {
  const renderer = new SceneRenderer(root, opening, signal);
  addEventListener("keydown", (event) => {
    if (event.target.closest("select, button, a, summary")) return;
    if (event.key !== " ") { renderer.stage?.orbit.key(event); return; }
    event.preventDefault();
    renderer.toggle();
  }, { signal });
  let shown = null;
  while (!signal.aborted) {
    try {
      const key = await renderer.look() ? await renderer.next() : null;
      const place = `${renderer.run} ${key}`;
      if (key === null || place === shown) {
        if (renderer.chosen) renderer.waits(renderer.awaited());
        await pause(LOOK, signal);
        continue;
      }
      await renderer.show(key);
      shown = place;
    } catch (error) {
      if (signal.aborted || error.name === "AbortError") return;
      // A round of episodes is over, or the viewer has ended.
      replace(renderer.place, notice(error.message, "error"));
      await pause(2000, signal);
    }
  }
}
