// One episode on stage: the room from a free camera, what the robot sees, the floor plan, and what happens.

import { ask, css, h, json, replace, svg } from "./dom.js";
import { action, metres, number, outcome, signed } from "./format.js";

export function pictureAddress(run, key, query) {
  const words = new URLSearchParams(Object.entries(query).map(([name, value]) => [name, String(value)]));
  return `/api/runs/${encodeURIComponent(run)}/episodes/${key}/picture?${words}`;
}

/** Paints pictures on a canvas; of many that are asked for in a row only the newest is waited for. */
export class Painter {
  constructor(canvas, waits = () => {}) { Object.assign(this, { canvas, waits, busy: false, next: null, shown: null }); }

  async paint(address, signal) {
    if (this.busy) {
      this.next?.resolve(false);
      return new Promise((resolve) => { this.next = { address, signal, resolve }; });
    }
    this.busy = true;
    this.waits(true);
    try {
      if (address !== this.shown) {
        const blob = await (await ask(address, { signal })).blob();
        const picture = await createImageBitmap(blob);
        Object.assign(this.canvas, { width: picture.width, height: picture.height });
        this.canvas.getContext("2d").drawImage(picture, 0, 0);
        picture.close();
        this.shown = address;
      }
      return true;
    } finally {
      this.busy = false;
      const { next } = this;
      this.next = null;
      if (next) this.paint(next.address, next.signal).then(next.resolve, () => next.resolve(false));
      else this.waits(false);
    }
  }
}

const CLAMP = (value, low, high) => Math.min(high, Math.max(low, value));

/** The room from a free camera. `moved`: told when the camera was moved. */
class OrbitView {
  constructor(stage, moved) {
    Object.assign(this, { stage, moved, step: 0, timer: 0 });
    this.canvas = h("canvas", {
      class: "orbit", tabIndex: 0, role: "application", width: 640, height: 480,
      "aria-label": "The room from a free camera. Arrow keys turn it, plus and minus zoom, with shift the arrow keys move it, 0 puts it back.",
      onpointerdown: (event) => this.grab(event),
      onwheel: (event) => { event.preventDefault(); this.zoom(Math.exp(event.deltaY * 0.0012)); },
      onkeydown: (event) => this.key(event),
      oncontextmenu: (event) => event.preventDefault(),
    });
    this.element = h("div", { class: "picture" }, this.canvas, h("span", { class: "busy" }, "drawing"));
    this.painter = new Painter(this.canvas, (waits) => this.element.classList.toggle("waits", waits));
    this.home();
  }

  home() { this.camera = structuredClone(this.stage.episode.orbit); }

  grab(down) {
    this.canvas.setPointerCapture(down.pointerId);
    this.canvas.focus({ preventScroll: true });
    let [x, y] = [down.clientX, down.clientY];
    const shift = down.shiftKey || down.button === 2;
    const move = (event) => {
      const [dx, dy] = [event.clientX - x, event.clientY - y];
      [x, y] = [event.clientX, event.clientY];
      if (shift) this.pan(dx / this.canvas.clientWidth, dy / this.canvas.clientWidth); else this.turn(dx * 0.008, dy * 0.006);
    };
    const up = () => { this.canvas.removeEventListener("pointermove", move); this.canvas.removeEventListener("pointerup", up); this.canvas.removeEventListener("pointercancel", up); };
    this.canvas.addEventListener("pointermove", move);
    this.canvas.addEventListener("pointerup", up);
    this.canvas.addEventListener("pointercancel", up);
  }

  key(event) {
    const { key, shiftKey } = event;
    const steps = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (key in steps) {
      const [dx, dy] = steps[key];
      if (shiftKey) this.pan(dx * 0.06, dy * 0.06); else this.turn(dx * 0.14, dy * 0.1);
    } else if (key === "+" || key === "=") this.zoom(0.88);
    else if (key === "-" || key === "_") this.zoom(1.14);
    else if (key === "0") { this.home(); this.draw(); this.moved(this.camera); } else return;
    event.preventDefault();
    event.stopPropagation();
  }

  turn(yaw, pitch) {
    this.camera.yaw_rad += yaw;
    this.camera.pitch_rad = CLAMP(this.camera.pitch_rad + pitch, 0.05, 1.56);
    this.changed();
  }

  zoom(factor) {
    this.camera.radius_m = CLAMP(this.camera.radius_m * factor, 0.25, 8);
    this.changed();
  }

  /** Moves the middle of what is seen, in the plane of the picture's lower edge. */
  pan(dx, dy) {
    const { yaw_rad: yaw, pitch_rad: pitch, radius_m: radius, centre_m: centre } = this.camera;
    const reach = 2 * radius;
    centre[0] += reach * (-dx * Math.cos(yaw) + dy * Math.sin(yaw) * Math.sin(pitch));
    centre[2] += reach * (dx * Math.sin(yaw) + dy * Math.cos(yaw) * Math.sin(pitch));
    centre[1] = CLAMP(centre[1] + reach * dy * Math.cos(pitch), 0, 2.5);
    this.changed();
  }

  changed() { this.draw(); this.moved(this.camera); }

  address(fine) {
    const { centre_m: [x, y, z], radius_m: radius, yaw_rad: yaw, pitch_rad: pitch } = this.camera;
    const full = CLAMP(Math.round((this.canvas.clientWidth || 640) * Math.min(devicePixelRatio || 1, 1.5)), 240, 960);
    const width = 4 * Math.round((fine ? full : CLAMP(full / 2, 240, 420)) / 4);
    const round = (value) => value.toFixed(4);
    return this.stage.address({ view: "orbit", step: this.step, width, height: (width * 3) / 4, fine, x: round(x), y: round(y), z: round(z), radius: round(radius), yaw: round(yaw), pitch: round(pitch) });
  }

  /** A draft at once, and soft light when nothing has changed for a moment after it. */
  draw() {
    clearTimeout(this.timer);
    const { signal } = this.stage;
    const failed = (error) => this.stage.fail(error);
    const refine = () => this.painter.paint(this.address(true), signal).then((painted) => { if (painted) this.canvas.dataset.fine = String(this.step); }, failed);
    this.painter.paint(this.address(false), signal).then((painted) => {
      // Of those that were overtaken the newest draws on.
      if (!painted) return;
      this.canvas.dataset.step = String(this.step);
      clearTimeout(this.timer);
      this.timer = setTimeout(refine, 350);
    }, failed);
  }
}

/** The floor plan with the way taken. */
class PlanView {
  constructor(stage) {
    this.stage = stage;
    const { plan_centre_m: [x, z], plan_half_width_m: half } = stage.episode;
    this.canvas = h("canvas", { width: 420, height: 420, "aria-hidden": "true" });
    this.overlay = svg("svg", { viewBox: `${x - half} ${-z - half} ${2 * half} ${2 * half}`, role: "img" });
    this.element = h("div", { class: "plan" }, this.canvas, this.overlay);
    new Painter(this.canvas).paint(stage.address({ view: "plan", step: 0, width: 640 }), stage.signal).catch((error) => stage.fail(error));
  }

  draw(step) {
    const { moments, goal_m: goal, goal_tolerance_m: reach, things } = this.stage.episode;
    const now = moments[step];
    const points = (all, place) => all.map((moment) => place(moment).map((value) => value.toFixed(3)).join(",")).join(" ");
    const base = ({ base: [x, z] }) => [x, -z];
    const target = ({ target_m: [x, , z] }) => [x, -z];
    const [x, z, yaw] = now.base;
    const carried = moments.slice(0, step + 1).filter((moment) => moment.holding);
    const moved = now.moved.map(([number, , [toX, toZ]]) => {
      const [fromX, fromZ] = things[number].stood_m;
      return [svg("line", { class: "moved", x1: fromX, y1: -fromZ, x2: toX, y2: -toZ }), svg("circle", { class: "moved", cx: toX, cy: -toZ, r: 0.045 })];
    });
    replace(this.overlay,
      svg("polyline", { class: "way ahead", points: points(moments.slice(step), base) }),
      svg("polyline", { class: "way", points: points(moments.slice(0, step + 1), base) }),
      svg("polyline", { class: "carried", points: points(carried, target) }),
      svg("rect", { class: "goal", x: goal[0] - reach, y: -goal[2] - reach, width: 2 * reach, height: 2 * reach }),
      moved,
      svg("path", { class: "robot", d: "M0 -0.24 L0.17 0.17 L0 0.08 L-0.17 0.17 Z", transform: `translate(${x} ${-z}) rotate(${(yaw * 180) / Math.PI})` }),
      svg("circle", { class: "target", cx: now.target_m[0], cy: -now.target_m[2], r: 0.06 }));
    this.overlay.setAttribute("aria-label", `Floor plan: the robot at ${x.toFixed(2)}, ${z.toFixed(2)} m, ${step} of ${moments.length - 1} steps taken`);
  }
}

/** Disturbance and reward over the steps; a click goes there. */
export class Strip {
  constructor(stages, go) {
    Object.assign(this, { stages, step: 0 });
    this.canvas = h("canvas", { class: "strip", "aria-hidden": "true", onpointerdown: (event) => this.drag(event, go), onpointermove: (event) => { if (event.buttons) this.drag(event, go); } });
    new ResizeObserver(() => this.draw(this.step)).observe(this.canvas);
    this.steps = Math.max(...stages.map((stage) => stage.episode.moments.length - 1));
  }

  drag(event, go) { go(Math.round(CLAMP(event.offsetX / this.canvas.clientWidth, 0, 1) * this.steps)); }

  draw(step) {
    this.step = step;
    const [width, height, ratio] = [this.canvas.clientWidth, this.canvas.clientHeight, devicePixelRatio || 1];
    if (!width) return;
    Object.assign(this.canvas, { width: width * ratio, height: height * ratio });
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    const x = (at) => 2 + (at / Math.max(1, this.steps)) * (width - 4);
    const most = Math.max(0.05, ...this.stages.flatMap(({ episode }) => episode.moments.map((moment) => moment.disturbance_m)));
    pen.fillStyle = css("--wash");
    pen.fillRect(0, height - 13, width, 13);
    this.stages.forEach(({ episode }, index) => {
      const ink = css(index ? "--run-1" : "--run-0");
      const lane = (height - 13) / this.stages.length;
      const middle = lane * index + lane * 0.62;
      episode.moments.forEach((moment, at) => {
        const tall = CLAMP(Math.sqrt(Math.abs(moment.reward_r)) * 8, 0, lane * 0.6) * Math.sign(moment.reward_r);
        pen.fillStyle = moment.reward_r < 0 ? css("--faint") : ink;
        pen.fillRect(x(at) - 1, middle - Math.max(tall, 0), Math.max(1.5, width / this.steps - 1.5), Math.abs(tall));
        const tick = height - 13 + (index * 13) / this.stages.length;
        const mark = moment.picked_up ? css("--target") : moment.failed ? css("--bad") : null;
        if (mark) { pen.fillStyle = mark; pen.fillRect(x(at) - 1, tick + 2, moment.picked_up ? 5 : 2.5, 13 / this.stages.length - 4); }
      });
      pen.strokeStyle = css("--ghost");
      pen.lineWidth = 1.6;
      pen.setLineDash(index ? [4, 3] : []);
      pen.beginPath();
      episode.moments.forEach((moment, at) => pen.lineTo(x(at), height - 15 - (moment.disturbance_m / most) * (height - 20)));
      pen.stroke();
      pen.setLineDash([]);
    });
    pen.fillStyle = css("--ink");
    pen.fillRect(x(step) - 0.75, 0, 1.5, height);
  }
}

const PARTS = [
  ["each step", () => -0.01], ["failed action", (parts) => -0.03 * parts.failed_action], ["wrist nearer to the target", (parts) => parts.wrist_object_progress_m],
  ["picked up", (parts) => 5 * parts.picked_up], ["target nearer to the goal", (parts) => parts.object_goal_progress_m], ["Done at the goal", (parts) => 10 * parts.goal_success],
];

/** An episode that is open. */
export class Stage {
  static async open(run, key, signal) {
    return new Stage(run, key, signal, await json(`/api/runs/${encodeURIComponent(run)}/episodes/${key}`, { signal }));
  }

  constructor(run, key, signal, episode) {
    Object.assign(this, { run, key, signal, episode, step: 0 });
    this.problem = h("p", { class: "notice error", hidden: true, role: "alert" });
    this.orbit = new OrbitView(this, (camera) => this.turned?.(camera));
    this.depth = h("canvas", { class: "depth", width: 224, height: 224, role: "img" });
    this.depthPainter = new Painter(this.depth);
    this.plan = new PlanView(this);
    this.words = h("div", { class: "row" });
    this.parts = h("div", {});
    this.moved = h("div", {});
  }

  get last() { return this.episode.moments.length - 1; }

  address(query) { return pictureAddress(this.run, this.key, { ...query, of: this.last }); }

  fail(error) {
    if (this.signal.aborted || error.name === "AbortError") return;
    Object.assign(this.problem, { hidden: false, textContent: error.message });
  }

  /** What is to be said above the pictures. */
  title() {
    const [words, kind] = outcome(this.episode.outcome);
    const [kitchen, environment, number] = this.key.split("-");
    return h("div", { class: "row" }, h("h1", {}, `${this.episode.target}, kitchen ${kitchen}`), h("span", { class: kind }, words), h("span", { class: "soft small" }, `environment ${environment}, episode ${number}, ${this.last} steps`));
  }

  /** Whether the simulation gives what was recorded. */
  proof() {
    const { compared, first_difference: difference } = this.episode;
    if (difference) return h("p", { class: "notice error" }, `The simulation differs from the recording from step ${difference.step} on (${difference.aspect}): what is shown from there is not what happened.`);
    return h("p", { class: "small faint" }, `Simulated again from its actions; all ${compared} states are as recorded.`);
  }

  show(step) {
    this.step = CLAMP(step, 0, this.last);
    const now = this.episode.moments[this.step];
    this.orbit.step = this.step;
    this.orbit.draw();
    this.depth.setAttribute("aria-label", `What the robot's depth camera sees at step ${this.step}`);
    this.depthPainter.paint(this.address({ view: "depth", step: this.step, width: 224 }), this.signal).then((painted) => { if (painted) this.depth.dataset.step = String(this.step); }, (error) => this.fail(error));
    this.plan.draw(this.step);
    replace(this.words, h("strong", {}, `step ${this.step}`), h("span", {}, action(now.action)),
      now.failed ? h("span", { class: "bad" }, "failed") : null, now.picked_up ? h("span", { class: "good" }, "picked up") : null,
      h("span", { class: "soft" }, now.holding ? "in hand" : `wrist ${metres(now.wrist_object_m, 2)} from it`), h("span", { class: "soft" }, `goal ${metres(now.object_goal_m, 2)}`));
    this.rewards(now);
    this.displaced(now);
  }

  rewards(now) {
    const shown = this.step ? PARTS.map(([name, of]) => [name, of(now.parts)]).filter(([name, value]) => value !== 0 || name === "each step") : [];
    const sum = (kind) => this.episode.moments.slice(0, this.step + 1).reduce((all, moment) => all + moment[kind], 0);
    replace(this.parts, h("table", { class: "parts small" },
      h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "Reward of this step"), h("th", { scope: "col" }, "r"))),
      h("tbody", {}, shown.map(([name, value]) => h("tr", {}, h("td", {}, name), h("td", {}, signed(value)))),
        h("tr", { class: "total" }, h("td", {}, "r"), h("td", {}, signed(now.reward_r))),
        h("tr", {}, h("td", {}, "r′, with disturbance"), h("td", {}, signed(now.reward_r_prime))),
        h("tr", {}, h("td", { class: "soft" }, "return so far, r and r′"), h("td", { class: "soft" }, `${number(sum("reward_r"))}, ${number(sum("reward_r_prime"))}`)))));
  }

  displaced(now) {
    const rows = [...now.moved].sort((a, b) => b[1] - a[1]).map(([thing, far]) => h("tr", {}, h("td", {}, this.episode.things[thing].category), h("td", {}, metres(far))));
    replace(this.moved, h("table", { class: "parts small" },
      h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "Displaced"), h("th", { scope: "col" }, metres(now.disturbance_m)))),
      h("tbody", {}, rows.length ? rows : h("tr", {}, h("td", { colSpan: 2, class: "soft" }, "Nothing is displaced.")))));
  }
}
