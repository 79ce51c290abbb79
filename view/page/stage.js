// One episode on stage: the room from a free camera, what the robot sees, the floor plan, and what happens.

import { ask, css, h, isDark, json, replace, svg, waiting } from "./dom.js";
import { action, metres, number, outcome, kitchenName, quantity, signed, words } from "./format.js";

export function pictureAddress(run, key, query) {
  const search = new URLSearchParams(Object.entries(query).map(([name, value]) => [name, String(value)]));
  return `/api/runs/${encodeURIComponent(run)}/episodes/${key}/picture?${search}`;
}

/** Where there is no room the picture is as light or dark as the page. */
const tinted = (address) => (isDark() ? `${address}&dark=true` : address);

function whole(canvas, picture) {
  Object.assign(canvas, { width: picture.width, height: picture.height });
  canvas.getContext("2d").drawImage(picture, 0, 0);
}

/** Paints pictures on a canvas; of many that are asked for in a row only the newest is waited for. */
export class Painter {
  /** `put`: puts a picture on the canvas; as it is where nothing else is said. */
  constructor(canvas, waits = () => {}, put = whole) { Object.assign(this, { canvas, waits, put, busy: false, next: null, shown: null, loaded: null }); }

  /** A picture as a blob. The one that was asked for last is not asked for again; `took`: told how many milliseconds it took. */
  load(wanted, signal, took = () => {}) {
    if (this.loaded?.wanted !== wanted) {
      const asked = performance.now();
      const blob = ask(wanted, { signal }).then((answer) => answer.blob());
      const loaded = { wanted, blob };
      this.loaded = loaded;
      blob.then(() => took(performance.now() - asked), () => { if (this.loaded === loaded) this.loaded = null; });
    }
    return this.loaded.blob;
  }

  async paint(address, signal, took) {
    if (this.busy) {
      this.next?.resolve(false);
      return new Promise((resolve) => { this.next = { address, signal, took, resolve }; });
    }
    this.busy = true;
    this.waits(true);
    if (!this.asked) addEventListener("recolour", () => this.paint(this.asked, signal).catch(() => {}), { signal });
    this.asked = address;
    const wanted = tinted(address);
    try {
      if (wanted !== this.shown) {
        const picture = await createImageBitmap(await this.load(wanted, signal, took));
        this.put(this.canvas, picture);
        picture.close();
        this.shown = wanted;
      }
      return true;
    } finally {
      this.busy = false;
      const { next } = this;
      this.next = null;
      if (next) this.paint(next.address, next.signal, next.took).then(next.resolve, () => next.resolve(false));
      else this.waits(false);
    }
  }
}

/** Paints an episode's last moment. */
export async function paintEnd(canvas, run, key, signal) {
  const { orbit, moments } = await json(`/api/runs/${encodeURIComponent(run)}/episodes/${key}?later=true`, { signal });
  const step = moments.length - 1;
  await new Painter(canvas).paint(pictureAddress(run, key, { view: "orbit", ...orbitQuery(orbit), step, width: 320, height: 240, fine: true, of: step, later: true }), signal);
  canvas.dataset.step = String(step);
}

/** A free camera, as addresses have it. */
function orbitQuery({ centre_m: [x, y, z], radius_m: radius, yaw_rad: yaw, pitch_rad: pitch }) {
  return Object.fromEntries(Object.entries({ x, y, z, radius, yaw, pitch }).map(([name, value]) => [name, value.toFixed(4)]));
}

/** A canvas with a badge that says which step it shows while another one's picture is waited for; `tell(step)` renews it. */
function framed(canvas, kind, put, ...over) {
  const busy = h("span", { class: "busy" }, "drawing");
  const element = h("div", { class: `${kind} waits` }, canvas, over, busy);
  const tell = (step) => {
    const { step: shown = String(step) } = canvas.dataset;
    busy.textContent = shown === String(step) ? "drawing" : `step ${shown}; step ${step} is being drawn`;
  };
  return { canvas, element, tell, painter: new Painter(canvas, (waits) => element.classList.toggle("waits", waits), put) };
}

/** Half of a picture's width for a distance of 1. */
const HALF_WIDTH = 0.42;
/** Channels of what an action left, and those of the same as it is seen. */
const SAME = { held: "holding", target: "current_target" };
/** Milliseconds that a draft may take: of another step, and of another view of the same one. */
export const DRAFT = [110, 50];
/** What a pixel of a draft takes on this machine, as of late, milliseconds. */
let pixelTakes = null;
/** So many of the things that are displaced have their names in the picture: those that are displaced most. */
const NAMED = 4;
/** Ways of a tag from what it names, the best first, and how far it may be from it, pixels. */
const WAYS = [[0, -1], [0.8, -0.6], [-0.8, -0.6], [1, 0], [-1, 0], [0.8, 0.6], [-0.8, 0.6], [0, 1]];
const AWAY = [16, 34, 56, 84, 120, 160];
/** Metres from a robot's floor to its top, and half of its width; half of the room that a target takes. */
const [ROBOT_TALL, ROBOT_HALF, TARGET_HALF] = [1.45, 0.17, 0.08];
const CLAMP = (value, low, high) => Math.min(high, Math.max(low, value));

/** How much of a box lies in another one, square pixels; boxes are [left, top, right, bottom]. */
const shared = ([a, b, c, d], [e, f, g, i]) => Math.max(0, Math.min(c, g) - Math.max(a, e)) * Math.max(0, Math.min(d, i) - Math.max(b, f));

/** Places tags beside what they name, those first that come first: not over what is in `taken`, nor over one another. Where
 * there is no such place the first tag covers the least, and the others are left out. `tags`: `at`, `width` and `height`, pixels. */
export function placed(tags, taken, [width, height]) {
  const kept = [];
  const boxes = [...taken, ...tags.map(({ at: [x, y] }) => [x - 5, y - 5, x + 5, y + 5])];
  for (const tag of tags) {
    const { at: [x, y], width: wide, height: tall } = tag;
    const found = AWAY.flatMap((away) => WAYS.map(([right, down]) => {
      const [left, top] = [x + right * (away + wide / 2) - wide / 2, y + down * (away + tall / 2) - tall / 2];
      const box = [left, top, left + wide, top + tall];
      const within = left >= 2 && top >= 2 && box[2] <= width - 2 && box[3] <= height - 2;
      return { box, covers: within ? boxes.reduce((sum, other) => sum + shared(box, other), 0) : Infinity };
    }));
    const best = found.reduce((least, one) => (one.covers < least.covers ? one : least));
    if (best.covers === Infinity || (best.covers > 0 && kept.length)) continue;
    kept.push({ ...tag, box: best.box });
    boxes.push(best.box);
  }
  return kept;
}

/** The room from a free camera. `moved`: told when the camera was moved. */
export class OrbitView {
  constructor(stage, moved, drawn) {
    Object.assign(this, { stage, moved, drawn, step: 0, timer: 0, isAtRest: true, may: DRAFT, pointers: new Map() });
    const canvas = h("canvas", {
      class: "orbit", tabIndex: 0, role: "application", width: 640, height: 480,
      "aria-label": "The room from a free camera. Arrow keys turn it, plus and minus zoom, with shift the arrow keys move it, 0 puts it back.",
      onpointerdown: (event) => this.grab(event),
      onwheel: (event) => { event.preventDefault(); this.zoom(Math.exp(event.deltaY * 0.0012)); },
      onkeydown: (event) => this.key(event),
      oncontextmenu: (event) => event.preventDefault(),
    });
    this.first = h("div", { class: "first" }, waiting("The room is being drawn", stage.signal).element);
    this.names = h("div", { class: "names", "aria-hidden": "true" });
    Object.assign(this, framed(canvas, "picture", whole, this.names, this.first));
    this.home();
  }

  /** The view that an episode was opened with: one that goes on has another at its end. */
  home() { this.camera = structuredClone(this.began ??= this.stage.episode.orbit); }

  isHome() { return JSON.stringify(this.camera) === JSON.stringify(this.began); }

  /** One pointer turns the camera, or moves it with shift; two fingers move it, and zoom as they part. */
  grab(down) {
    this.canvas.setPointerCapture(down.pointerId);
    this.canvas.focus({ preventScroll: true });
    const shift = down.shiftKey || down.button === 2;
    this.pointers.set(down.pointerId, [down.clientX, down.clientY]);
    const middle = ([[ax, ay], [bx, by] = [ax, ay]]) => [(ax + bx) / 2, (ay + by) / 2, Math.hypot(ax - bx, ay - by)];
    const move = (event) => {
      if (event.pointerId !== down.pointerId) return;
      const [x, y, apart] = middle([...this.pointers.values()]);
      this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
      const [toX, toY, now] = middle([...this.pointers.values()]);
      const [dx, dy] = [toX - x, toY - y];
      if (apart && now) this.zoom(apart / now);
      if (shift || apart) this.pan(dx / this.canvas.clientWidth, dy / this.canvas.clientWidth); else this.turn(dx * 0.008, dy * 0.006);
    };
    const up = (event) => {
      if (event.pointerId !== down.pointerId) return;
      this.pointers.delete(down.pointerId);
      for (const [kind, listener] of [["pointermove", move], ["pointerup", up], ["pointercancel", up]]) this.canvas.removeEventListener(kind, listener);
    };
    for (const [kind, listener] of [["pointermove", move], ["pointerup", up], ["pointercancel", up]]) this.canvas.addEventListener(kind, listener);
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

  /** Nearer to what is done, and back; where the visitor has moved the camera, to what it looks at. */
  zoom(factor) {
    const { camera, began } = this;
    const before = camera.radius_m;
    camera.radius_m = CLAMP(before * factor, 0.25, 8);
    const ratio = camera.radius_m / before;
    const aim = ratio < 1 ? this.stage.focus(this.step) : began.centre_m;
    // Twice as fast as the picture shrinks: what is aimed at gets to its middle.
    const share = 1 - Math.min(ratio, 1 / ratio) ** 2;
    if (!camera.isMoved) camera.centre_m = camera.centre_m.map((value, axis) => value + share * (aim[axis] - value));
    this.changed();
  }

  /** Where a place is in the picture: right of its middle and above it, in halves of its width. */
  seen(place) {
    const { yaw_rad: yaw, pitch_rad: pitch, radius_m: radius, centre_m: centre } = this.camera;
    const [x, y, z] = place.map((value, axis) => value - centre[axis]);
    const across = x * Math.cos(yaw) - z * Math.sin(yaw);
    const flat = x * Math.sin(yaw) + z * Math.cos(yaw);
    const depth = (radius * Math.hypot(1, HALF_WIDTH)) / HALF_WIDTH + flat * Math.cos(pitch) - y * Math.sin(pitch);
    const up = y * Math.cos(pitch) + flat * Math.sin(pitch);
    return depth > 0 ? [across / (HALF_WIDTH * depth), up / (HALF_WIDTH * depth)] : [Infinity, Infinity];
  }

  /** Whether a place is in the picture. */
  holds(place) {
    const [right, up] = this.seen(place);
    return Math.abs(right) < 1 && Math.abs(up) < 0.75;
  }

  /** A place in a picture of so many pixels. */
  pixel(place, [width, height]) {
    const [right, up] = this.seen(place);
    return [(width / 2) * (1 + right), height / 2 - (width / 2) * up];
  }

  /** What tags must not cover, as boxes in pixels: the robot with its arm, the target and the goal. */
  taken(step, size) {
    const { goal_tolerance_m: reach, moments } = this.stage.episode;
    const { wrist_position_m: hand, target_position_m: target, goal_position_m: goal, base_position_m: base } = moments[step].channels ?? {};
    const around = (places, by) => {
      const found = places.map((place) => this.pixel(place, size)).filter((at) => at.every(Number.isFinite));
      const [across, down] = [0, 1].map((axis) => found.map((at) => at[axis]));
      return found.length ? [[Math.min(...across) - by, Math.min(...down) - by, Math.max(...across) + by, Math.max(...down) + by]] : [];
    };
    const corners = ([x, y, z], half) => [-half, half].flatMap((dx) => [-half, half].flatMap((dy) => [-half, half].map((dz) => [x + dx, y + dy, z + dz])));
    const [x, z] = base ? [base[0], base.at(-1)] : [];
    const column = base ? [-ROBOT_HALF, ROBOT_HALF].flatMap((aside) => [0, ROBOT_TALL].flatMap((y) => [[x + aside, y, z], [x, y, z + aside]])) : [];
    const arm = base && hand?.length === 3 ? [0.25, 0.5, 0.75, 1].map((share) => [x + share * (hand[0] - x), hand[1], z + share * (hand[2] - z)]) : [];
    return [...around(column, 2), ...arm.flatMap((place) => around([place], 9)), ...(target?.length === 3 ? around(corners(target, TARGET_HALF), 4) : []), ...(goal?.length === 3 ? around(corners(goal, reach), 3) : [])];
  }

  /** Names what is displaced, beside it: a thin line leads there. */
  name(step) {
    const { episode } = this.stage;
    const [width, height] = [this.names.clientWidth || 640, this.names.clientHeight || 480];
    const there = farthest(episode, episode.moments[step]).filter(({ place }) => this.holds(place)).slice(0, NAMED);
    const spans = there.map(({ name, far }) => h("span", {}, `${name} ${metres(far, 2)}`));
    replace(this.names, spans);
    const tags = there.map(({ place }, at) => ({ span: spans[at], at: this.pixel(place, [width, height]), width: spans[at].offsetWidth || 8 * spans[at].textContent.length, height: spans[at].offsetHeight || 20 }));
    const shown = placed(tags, this.taken(step, [width, height]), [width, height]);
    const lines = shown.map(({ at: [x, y], box: [left, top, right, bottom] }) => svg("line", { x1: x, y1: y, x2: CLAMP(x, left, right), y2: CLAMP(y, top, bottom) }));
    for (const { span, box: [left, top] } of shown) { span.style.setProperty("left", `${(100 * left) / width}%`); span.style.setProperty("top", `${(100 * top) / height}%`); }
    replace(this.names, svg("svg", { viewBox: `0 0 ${width} ${height}` }, lines), shown.map(({ span }) => span));
  }

  /** Where robot or target leave the picture of an episode that goes on: the view from which its way so far is seen. A
   * camera that the visitor has turned keeps its angle, and goes where the robot is. */
  follow(step) {
    this.step = step;
    const { stage, camera } = this;
    const places = stage.places(step);
    const isSeen = () => places.every((place) => this.holds(place));
    if (!places.length || isSeen()) return;
    if (this.isHome()) {
      this.began = stage.episode.orbit;
      this.home();
    } else if (!this.holds(places[0])) {
      camera.centre_m = stage.focus(step);
      if (!isSeen()) camera.centre_m = [...places[0]];
    }
  }

  /** Moves the middle of what is seen, in the plane of the picture's lower edge. */
  pan(dx, dy) {
    const { yaw_rad: yaw, pitch_rad: pitch, radius_m: radius, centre_m: centre } = this.camera;
    const reach = 2 * radius;
    centre[0] += reach * (-dx * Math.cos(yaw) + dy * Math.sin(yaw) * Math.sin(pitch));
    centre[2] += reach * (dx * Math.sin(yaw) + dy * Math.cos(yaw) * Math.sin(pitch));
    centre[1] = CLAMP(centre[1] + reach * dy * Math.cos(pitch), 0, 2.5);
    this.camera.isMoved = true;
    this.changed();
  }

  changed() { this.draw(); this.moved(this.camera); }

  /** `may`: milliseconds that a draft may take, which is as fine as this machine draws in them. The first one is in full size. */
  address(fine, may = this.may[0]) {
    const full = CLAMP(Math.round((this.canvas.clientWidth || 640) * Math.min(devicePixelRatio || 1, 1.5)), 240, 960);
    const inTime = pixelTakes && this.canvas.dataset.step !== undefined ? 80 * Math.floor(Math.sqrt(may / pixelTakes / 0.75) / 80) : full;
    const width = 4 * Math.round((fine ? full : CLAMP(inTime, CLAMP(full / 2, 240, 420), full)) / 4);
    return this.stage.address({ view: "orbit", step: this.step, width, height: (width * 3) / 4, fine, ...orbitQuery(this.camera) });
  }

  /** Asks for a draft, also before it is drawn. */
  draft(may, paints) {
    const address = this.address(false, may);
    const { searchParams } = new URL(address, location.href);
    // The first picture of an episode takes longer than others: its room is built.
    const isFirst = this.canvas.dataset.step === undefined;
    const took = (ms) => {
      const takes = ms / searchParams.get("width") / searchParams.get("height");
      // One that the browser has kept says nothing.
      if (ms > 10 && !isFirst) pixelTakes = pixelTakes ? 0.7 * pixelTakes + 0.3 * takes : takes;
    };
    return paints ? this.painter.paint(address, this.stage.signal, took) : this.painter.load(tinted(address), this.stage.signal, took);
  }

  /** A draft at once, and soft light when nothing has changed for a moment after it. */
  draw() {
    clearTimeout(this.timer);
    const { step } = this;
    this.tell(step);
    this.draft(this.may[Number(this.wanted === step)], true).then((painted) => {
      // Of those that were overtaken the newest draws on.
      if (!painted) return;
      this.canvas.dataset.step = String(step);
      this.name(step);
      this.tell(this.step);
      this.first.remove();
      this.drawn();
      clearTimeout(this.timer);
      if (this.isAtRest) this.timer = setTimeout(() => this.refine(), 350);
    }, (error) => this.stage.fail(error));
    this.wanted = step;
  }

  refine() {
    const { step } = this;
    this.painter.paint(this.address(true), this.stage.signal).then((painted) => { if (painted) this.canvas.dataset.fine = String(step); }, (error) => this.stage.fail(error));
  }

  /** Soft light takes long: while a policy plays there is none. */
  rests(isAtRest) {
    if (isAtRest && !this.isAtRest) this.refine();
    this.isAtRest = isAtRest;
  }
}

/** The floor plan is at most so many times as long as high. */
const LONGEST = 2.2;

/** The floor plan with the path taken. */
class PlanView {
  constructor(stage) {
    this.stage = stage;
    const { plan_centre_m: [x, z], plan_half_m: [wide, deep] } = stage.episode;
    const half = Math.max(wide, deep);
    // The long side lies across; a kitchen that is very long has some floor of its surroundings above and below it.
    const tall = Math.max(Math.min(wide, deep), half / LONGEST);
    const turned = deep > wide ? 90 : 0;
    this.drawing = svg("g", { transform: `rotate(${turned} ${x} ${-z})` });
    this.overlay = svg("svg", { viewBox: `${x - half} ${-z - tall} ${2 * half} ${2 * tall}`, role: "img" }, this.drawing);
    const put = (canvas, picture) => {
      Object.assign(canvas, { width: picture.width, height: Math.round((picture.width * tall) / half) });
      const pen = canvas.getContext("2d");
      pen.translate(canvas.width / 2, canvas.height / 2);
      pen.rotate((turned * Math.PI) / 180);
      pen.drawImage(picture, -picture.width / 2, -picture.height / 2);
    };
    Object.assign(this, framed(h("canvas", { width: 420, height: 420, "aria-hidden": "true" }), "plan", put, this.overlay));
    this.element.style.setProperty("--long", (half / tall).toFixed(3));
    const lines = [["path", "path, pale ahead"], ...(stage.episode.target ? [["carried", "target carried"]] : []), ["moved", "displaced"]];
    this.legend = h("div", { class: "legend small soft" }, lines.map(([kind, text]) => h("span", {}, h("span", { class: `swatch ${kind}` }), text)));
  }

  /** Only what the task has channels for is drawn. */
  draw(step) {
    const { stage } = this;
    // After the room's first picture: its soft light takes long.
    this.floor ??= stage.drawn.then(() => this.painter.paint(stage.address({ view: "plan", step: 0, width: 640 }), stage.signal)).catch((error) => stage.fail(error));
    const { moments, goal_tolerance_m: reach, things } = stage.episode;
    const now = moments[step];
    // Of a place in the room that on the floor; of two numbers both are.
    const place = (moment, name) => { const at = moment.channels[name]; return at && [at[0], -at.at(-1)]; };
    const points = (all, name) => all.map((moment) => place(moment, name)?.map((value) => value.toFixed(3)).join(",") ?? "").join(" ");
    const [base, target, goal] = [place(now, "base_position_m"), place(now, "target_position_m"), place(now, "goal_position_m")];
    const yaw = now.channels.base_yaw_rad?.[0] ?? 0;
    const carried = moments.slice(0, step + 1).filter(({ channels }) => channels.holding?.[0]);
    const moved = now.moved.map(([number, , [toX, , toZ]]) => {
      const [fromX, fromZ] = things[number].stood_m;
      return [svg("line", { class: "moved", x1: fromX, y1: -fromZ, x2: toX, y2: -toZ }), svg("circle", { class: "moved", cx: toX, cy: -toZ, r: 0.045 })];
    });
    replace(this.drawing,
      svg("polyline", { class: "path ahead", points: points(moments.slice(step), "base_position_m") }),
      svg("polyline", { class: "path", points: points(moments.slice(0, step + 1), "base_position_m") }),
      svg("polyline", { class: "carried", points: points(carried, "target_position_m") }),
      goal ? svg("rect", { class: "goal", x: goal[0] - reach, y: goal[1] - reach, width: 2 * reach, height: 2 * reach }) : null,
      moved,
      base ? svg("path", { class: "robot", d: "M0 -0.24 L0.17 0.17 L0 0.08 L-0.17 0.17 Z", transform: `translate(${base}) rotate(${(yaw * 180) / Math.PI})` }) : null,
      target ? svg("circle", { class: "target", cx: target[0], cy: target[1], r: 0.06 }) : null);
    const where = base ? `the robot at ${base[0].toFixed(2)}, ${(-base[1]).toFixed(2)} m, ` : "";
    this.overlay.setAttribute("aria-label", `Floor plan: ${where}${step} of ${moments.length - 1} steps taken`);
  }
}

/** The terms of a reward, those of its base first: name, weight, and whether a part holds. Without what training weighs. */
function terms(task, name) {
  const reward = task.rewards.find((one) => one.name === name);
  const own = reward.terms.map((term) => {
    const [part, weight] = Array.isArray(term) ? term : [term.part, term.weight];
    const holds = Array.isArray(term) ? (value) => value : (value) => Number(value <= (term.at_most ?? Infinity) && value >= (term.at_least ?? -Infinity));
    return { part, weight: typeof weight === "number" ? weight : task.weights[weight] ?? 0, holds };
  });
  const base = reward.base ? terms(task, reward.base) : { constant: 0, all: [] };
  return { constant: base.constant + (reward.constant ?? 0), all: [...base.all, ...own] };
}

/** The first metric with a limit: which channel has it, and what it is. */
export function limit({ metrics }) {
  const clauses = metrics.flatMap(({ all_of: all }) => all ?? []);
  const bound = (clause) => clause.below ?? clause.at_most ?? clause.at_least ?? clause.above;
  const found = clauses.find((clause) => typeof bound(clause) === "number");
  return found ? { channel: found.channel, bound: bound(found) } : null;
}

/** Name of the reward of the stage in which an episode was made; where that is not known, of the last that it was given. */
function optimised({ task, reward, moments }) {
  const given = task.rewards.map(({ name }) => name).filter((name) => name in moments.at(-1).rewards);
  return given.find((name) => name === reward) ?? given.at(-1) ?? task.rewards[0]?.name;
}

/** What is displaced at a moment, what is displaced most first: its name, how far, and where it is. */
export const farthest = ({ things }, { moved }) => moved.map(([thing, far, place]) => ({ name: things[thing].category, far, place })).sort((one, other) => other.far - one.far);

/** Parts of the reward that are 1 at a moment, and whether they are good news. */
function marks(episode, moment) {
  const { task } = episode;
  const own = optimised(episode);
  const isMark = ({ role, values }) => role === "part" && values?.join() === "0,1";
  const weight = (name) => terms(task, own).all.find(({ part }) => part === name)?.weight ?? 0;
  return task.channels.filter((channel) => isMark(channel) && moment.channels[channel.name]?.[0] === 1).map(({ name }) => ({ name, good: weight(name) >= 0 }));
}

/** How the camera is turned with what the visitor has: fingers or a mouse. */
const hint = () => (matchMedia("(pointer: coarse)").matches ? "Drag turns, two fingers zoom and move." : "Drag turns, wheel zooms, shift-drag moves.");

/** What is marked in the room. */
export const explained = ({ target }) => h("ul", { class: "marks small soft" },
  [...(target ? [["--mark-target", "the target, pale where something hides it"]] : []), ["--mark-goal", "the goal"], ["--mark-displaced", "displaced by more than 0.01 m along an axis, pale where it stood"], ...(target ? [["--mark-holds", "the hand while it holds"]] : [])]
    .map(([ink, text]) => h("li", {}, h("span", { class: "swatch", style: { background: `var(${ink})` } }), text)), h("li", { class: "faint" }, hint()));

/** Keys and what they do. */
export const keyCaps = (keys) => keys.map(([key, does]) => h("div", {}, h("kbd", {}, key), ` ${does}`));
export const CAMERA_KEYS = [["arrows", "turn"], ["shift arrows", "move"], ["+ −", "zoom"], ["0", "back"]];

/** A picture of the room, beside it, where there is a place, what is said of it, and beneath it what is marked there. */
export const besides = (picture, marked, ...said) => h("div", { class: "room" }, picture, h("div", { class: "stack" }, said), marked);

/** Half of the slider's knob, px: the middle of its first and of its last step is that far within its ends, and so are those of the strip. */
export const EDGE = 8;

/** The reward of the episode's stage, and the channel that its metrics limit, over the steps; a click goes there. */
export class Strip {
  constructor(stages, go, signal) {
    Object.assign(this, { stages, step: 0 });
    this.canvas = h("canvas", { class: "strip", "aria-hidden": "true", onpointerdown: (event) => this.drag(event, go), onpointermove: (event) => { if (event.buttons) this.drag(event, go); } });
    this.element = h("div", {}, this.canvas, this.legend());
    new ResizeObserver(() => this.draw(this.step)).observe(this.canvas);
    addEventListener("recolour", () => this.draw(this.step), { signal });
    this.steps = Math.max(...stages.map((stage) => stage.episode.moments.length - 1));
  }

  /** What its colours stand for. */
  legend() {
    const { task } = this.stages[0].episode;
    const limited = limit(task)?.channel;
    const rewarded = task.rewards.length > 0;
    const said = (ink, text) => text && h("span", {}, h("span", { class: "swatch", style: { background: `var(${ink})` } }), text);
    const marked = this.stages.flatMap(({ episode }) => episode.moments.flatMap((moment) => marks(episode, moment)));
    const named = (good) => [...new Set(marked.filter((mark) => mark.good === good).map(({ name }) => words(name)))].join(", ");
    const unit = task.channels.find(({ name }) => name === limited)?.unit;
    const most = Math.max(0, ...this.stages.flatMap(({ episode }) => episode.moments.map(({ channels }) => channels[limited]?.[0] ?? 0)));
    const rewards = this.stages.map((stage, index) => said(index ? "--run-1" : "--run-0", rewarded && `reward ${words(optimised(stage.episode))}${stage.name ? `, ${stage.name}` : ""}`));
    return h("div", { class: "legend small soft" }, rewards, said("--faint", rewarded && "below zero"), said("--ghost", limited && `${words(limited, unit)}, at most ${number(most, 3)} ${unit ?? ""}`), said("--target", named(true)), said("--bad", named(false)), this.stages.length > 1 && limited && h("span", {}, `dashed: ${this.stages[1].name}`));
  }

  drag(event, go) { go(CLAMP(Math.floor(((event.offsetX - EDGE) / (this.canvas.clientWidth - 2 * EDGE)) * (this.steps + 1)), 0, this.steps)); }

  draw(step) {
    this.step = step;
    const [width, height, ratio] = [this.canvas.clientWidth, this.canvas.clientHeight, devicePixelRatio || 1];
    if (!width) return;
    Object.assign(this.canvas, { width: width * ratio, height: height * ratio });
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    // Each step has a place of the same width, the last one too; the slider above has the same scale.
    const wide = (width - 2 * EDGE) / (this.steps + 1);
    const x = (at) => EDGE + (at + 0.5) * wide;
    const { task } = this.stages[0].episode;
    const limited = limit(task);
    const height_of = (moment) => moment.channels[limited?.channel]?.[0] ?? 0;
    const most = Math.max(5 * (limited?.bound ?? 0), 1e-9, ...this.stages.flatMap(({ episode }) => episode.moments.map(height_of)));
    pen.fillStyle = css("--wash");
    pen.fillRect(0, height - 13, width, 13);
    this.stages.forEach(({ episode }, index) => {
      const ink = css(index ? "--run-1" : "--run-0");
      const lane = (height - 13) / this.stages.length;
      const middle = lane * index + lane * 0.62;
      const own = optimised(episode);
      episode.moments.forEach((moment, at) => {
        const reward = moment.rewards[own] ?? 0;
        const tall = CLAMP(Math.sqrt(Math.abs(reward)) * 8 * Math.sign(reward), -lane * 0.38, lane * 0.6);
        pen.fillStyle = reward < 0 ? css("--faint") : ink;
        const bar = Math.max(1.5, wide - 1.5);
        pen.fillRect(x(at) - bar / 2, middle - Math.max(tall, 0), bar, Math.abs(tall));
        const tick = height - 13 + (index * 13) / this.stages.length;
        for (const { good } of marks(episode, moment)) { const thick = good ? 5 : 2.5; pen.fillStyle = css(good ? "--target" : "--bad"); pen.fillRect(x(at) - thick / 2, tick + 2, thick, 13 / this.stages.length - 4); }
      });
      pen.strokeStyle = css("--ghost");
      pen.lineWidth = 1.6;
      pen.setLineDash(index ? [4, 3] : []);
      pen.beginPath();
      if (limited) episode.moments.forEach((moment, at) => pen.lineTo(x(at), height - 15 - (height_of(moment) / most) * (height - 20)));
      pen.stroke();
      pen.setLineDash([]);
    });
    pen.fillStyle = css("--ink");
    pen.fillRect(x(step) - 0.75, 0, 1.5, height);
  }
}

/** An episode that is open. */
export class Stage {
  /** `waits`: called with the reason while the viewer has not read that far. */
  static async open(run, key, signal, waits) {
    const stage = new Stage(run, key, signal, await json(`/api/runs/${encodeURIComponent(run)}/episodes/${key}`, { signal, waits }));
    const [kitchen, environment] = key.split("-");
    const cards = await json("/api/runs", { signal });
    // An evaluation numbers its episodes by kitchen.
    stage.environment = cards.find(({ id }) => id === run)?.evaluation ? null : environment;
    stage.place = stage.isPictured && kitchenName(kitchen, cards.find(({ id }) => id === run)?.scenes);
    return stage;
  }

  constructor(run, key, signal, episode) {
    Object.assign(this, { run, key, signal, episode, step: 0 });
    this.problem = h("p", { class: "notice error", hidden: true, role: "alert" });
    this.drawn = new Promise((resolve) => { this.orbit = new OrbitView(this, (camera) => this.turned?.(camera), resolve); });
    this.depth = framed(h("canvas", { class: "depth", width: 224, height: 224, role: "img" }), "picture", whole);
    this.black = h("span", {});
    this.scale = h("div", { class: "legend small soft" }, h("span", {}, "0 m ", h("span", { class: "swatch depths" }), this.black));
    this.plan = new PlanView(this);
    this.words = h("div", { class: "row" });
    this.parts = h("div", {});
    this.moved = h("div", {});
    this.channels = h("div", {});
  }

  /** The robot's hand and the target, or the middle of the robot. */
  places(step) {
    const { wrist_position_m: hand, target_position_m: target, base_position_m: base } = this.episode.moments[step].channels;
    const near = [hand, target].filter((place) => place?.length === 3);
    return near.length || !base ? near : [[base[0], 0.8, base.at(-1)]];
  }

  /** The middle of what is done at a step. */
  focus(step) {
    const places = this.places(step);
    return places.length ? [0, 1, 2].map((axis) => places.reduce((sum, place) => sum + place[axis], 0) / places.length) : this.orbit.camera.centre_m;
  }

  /** Whether there are pictures of it: not of environments that are no kitchens. */
  get isPictured() { return !this.episode.elsewhere; }

  get last() { return this.episode.moments.length - 1; }

  address(query) { return pictureAddress(this.run, this.key, { ...query, of: this.last }); }

  fail(error) {
    if (this.signal.aborted || error.name === "AbortError") return;
    this.problem.hidden = false;
    replace(this.problem, error.message);
  }

  /** Where it was played, and its number there, as in the table of episodes. */
  called() {
    const { environment, place, episode: { number } } = this;
    return [place, environment === null ? null : `environment ${environment}`, `episode ${number}`].filter(Boolean).join(", ");
  }

  /** What is to be said above the pictures. */
  title() {
    const { environment, place, episode: { number, target } } = this;
    const title = [target, place].filter(Boolean).join(", ");
    const which = [`episode ${number}`, ...(environment === null ? [] : [`environment ${environment}`])];
    return h("div", { class: "row" }, h("h1", {}, title || which.join(", ").replace("e", "E")), h("span", { class: this.kind() }, this.ended()), h("span", { class: "soft small" }, [...(title ? which : []), `${this.last} steps`].join(", ")));
  }

  /** How it ended, and what kept it from ending better. */
  ended() {
    const { outcome: ended, moments, task } = this.episode;
    const { channels } = moments.at(-1);
    const limited = task.channels.find(({ name }) => name === limit(task)?.channel);
    const [far] = channels.object_goal_m ?? channels.goal_distance_m ?? [];
    const why = task.successes.indexOf(ended) > 0 && limited && channels[limited.name] ? quantity(limited, channels[limited.name], false) : ended === "failure" && far !== undefined ? `${metres(far, 2)} from the goal` : null;
    return [outcome(ended, task.successes), why].filter(Boolean).join(", ");
  }

  /** Whether it ended well, as a class: the first success demands most. */
  kind() {
    const { outcome: ended, task: { successes } } = this.episode;
    const at = successes.indexOf(ended);
    return at === 0 ? "good" : at > 0 ? "warn" : ended === "failure" ? "bad" : "soft";
  }

  /** The next step at which what its metrics limit has become greater, if they limit something. */
  growth() {
    const { moments, task } = this.episode;
    const limited = limit(task);
    const grown = (at) => moments[at].channels[limited.channel][0] - (moments[at - 1].channels[limited.channel]?.[0] ?? 0) > limited.bound / 2;
    return limited ? moments.map((moment, at) => at).filter((at) => at && grown(at)) : [];
  }

  /** Whether the simulation gives what was recorded. */
  proof() {
    const { compared, first_difference: difference } = this.episode;
    if (difference) return h("p", { class: "notice error" }, `The simulation differs from the recording from step ${difference.step} on (${words(difference.what)}): what is shown from there is not what happened.`);
    return h("p", { class: "small faint" }, `Simulated again from its actions; all ${compared} states are as recorded.`);
  }

  show(step) { this.paint(step); this.tell(); }

  /** Asks for a step's pictures. */
  paint(step) {
    this.step = CLAMP(step, 0, this.last);
    if (!this.isPictured) return;
    this.orbit.step = this.step;
    this.orbit.draw();
    const { depth, step: wanted } = this;
    depth.canvas.setAttribute("aria-label", `What the robot's depth camera sees at step ${wanted}`);
    depth.tell(wanted);
    depth.painter.paint(this.depthAddress(wanted), this.signal).then((painted) => { if (painted) { depth.canvas.dataset.step = String(wanted); depth.tell(this.step); } }, (error) => this.fail(error));
  }

  /** Asks for a step's pictures before they are painted. */
  load(step) {
    const { orbit } = this;
    const shown = orbit.step;
    orbit.step = step;
    orbit.draft(orbit.may[0], false);
    orbit.step = shown;
    this.depth.painter.load(tinted(this.depthAddress(step)), this.signal);
  }

  depthAddress(step) { return this.address({ view: "depth", step, width: 224 }); }

  /** Whether the pictures are of the step that was asked for, or never will be. */
  isPainted() { return !this.problem.hidden || [this.orbit, this.depth].every(({ canvas }) => canvas.dataset.step === String(this.step)); }

  /** A step in words: its action, what is to be noted of it, and what the task's metrics limit. */
  said(step) {
    const { task, moments } = this.episode;
    const now = moments[step];
    const limited = task.channels.find(({ name }) => name === limit(task)?.channel);
    const noted = marks(this.episode, now).map(({ name, good }) => ({ text: words(name), good }));
    const { held, picked_up: taken } = now.channels;
    const again = now.action?.startsWith("PickUp") && held?.[0] && !taken?.[0];
    if (held?.[0]) noted.push({ text: again ? "already holding" : `holding ${this.episode.target ?? ""}`, good: !again });
    return { acted: action(now.action), noted, measured: limited && now.channels[limited.name] ? quantity(limited, now.channels[limited.name]) : null };
  }

  /** Says what there is to say of the step. */
  tell() {
    const now = this.episode.moments[this.step];
    if (this.isPictured) this.plan.draw(this.step);
    // Of an episode that goes on more and more is known.
    this.black.textContent = ` ${number(this.episode.black_m, 1)} m or more`;
    const { task } = this.episode;
    const { acted, noted, measured } = this.said(this.step);
    replace(this.words, h("strong", {}, `step ${this.step}`), h("span", {}, acted),
      noted.map(({ text, good }) => h("span", { class: good ? "good" : "bad" }, text)),
      measured && h("span", { class: "soft" }, measured));
    this.rewards(now);
    this.displaced(now);
    // What an action left and what is seen then is one thing; so are a vector and its length.
    const told = Map.groupBy(task.channels.filter(({ name }) => now.channels[name]), ({ name, unit }) => words(SAME[name] ?? name, unit));
    const numbers = (channels) => new Set(channels.map((channel) => quantity(channel, now.channels[channel.name], false)));
    const isOpen = this.channels.firstChild?.open ?? !this.isPictured;
    replace(this.channels, h("details", { open: isOpen }, h("summary", { class: "small" }, "All that is recorded of this step"), h("table", { class: "parts small" },
      h("tbody", {}, [...told].map(([name, channels]) => h("tr", { title: channels.map(({ doc }) => doc).join(" ") }, h("td", {}, name), h("td", {}, [...numbers(channels)].map((text) => h("div", {}, text)))))))));
  }

  /** What the task's first reward is made of, and the others. */
  rewards(now) {
    const { task, moments } = this.episode;
    const [first] = task.rewards;
    if (!first) return;
    const { constant, all } = terms(task, first.name);
    const doc = (part) => task.channels.find(({ name }) => name === part)?.doc ?? "";
    const unit = (part) => task.channels.find(({ name }) => name === part)?.unit;
    // A reward that is one number is said once.
    const isOne = task.rewards.length === 1 && constant === 0 && all.length === 1;
    const rows = (terms) => (this.step && !isOne ? terms : []).map(({ part, weight, holds }) => [part, weight * holds(now.channels[part][0])]).filter(([, value]) => value !== 0)
      .map(([part, value]) => h("tr", { title: doc(part) }, h("td", {}, words(part, unit(part))), h("td", {}, signed(value))));
    // What another reward has beside the first one's terms.
    const added = (name) => terms(task, name).all.filter(({ part, weight }) => !all.some((other) => other.part === part && other.weight === weight));
    const sum = (name) => moments.slice(0, this.step + 1).reduce((total, { rewards }) => total + (rewards[name] ?? 0), 0);
    const names = Object.keys(moments.at(-1).rewards);
    // Their order is the declaration's.
    const rewards = task.rewards.map(({ name }) => name).filter((name) => names.includes(name));
    replace(this.parts, h("table", { class: "parts small" },
      h("thead", {}, h("tr", {}, h("th", { scope: "col", colSpan: 2, class: "alone" }, "Reward of this step"))),
      h("tbody", {}, this.step && constant ? h("tr", {}, h("td", {}, "each step"), h("td", {}, signed(constant))) : null,
        rows(all),
        rewards.map((name, at) => [at ? rows(added(name)) : null, h("tr", { class: "total" }, h("td", {}, words(name)), h("td", {}, signed(now.rewards[name] ?? 0)))]),
        rewards.map((name) => h("tr", {}, h("td", { class: "soft" }, `return so far, ${words(name)}`), h("td", { class: "soft" }, number(sum(name))))))));
  }

  displaced(now) {
    const row = (name, far, kind) => h("tr", { class: kind }, h("td", {}, name), h("td", {}, metres(far)));
    const rows = farthest(this.episode, now).map(({ name, far }) => row(name, far));
    if (now.nearly) rows.push(row(...now.nearly, "soft"));
    const listed = now.moved.reduce((total, [, far]) => total + far, now.nearly?.[1] ?? 0);
    const total = now.channels.disturbance_m?.[0] ?? listed;
    // What is violet in the pictures has a name here, and of the rest what moved most.
    if (total - listed >= 0.0005) rows.push(row(`${rows.length ? "others, " : ""}less than 0.01 m each`, total - listed, "soft"));
    replace(this.moved, h("table", { class: "parts small" },
      h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "Disturbance"), h("th", { scope: "col" }, metres(total)))),
      h("tbody", {}, rows.length ? rows : h("tr", {}, h("td", { colSpan: 2, class: "soft alone" }, "Nothing is displaced.")))));
  }
}
