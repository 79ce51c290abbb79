// A whole episode, or two one above the other, as a film: drawn step by step from where the cameras are, and put together in the
// browser.

import { ask, css, h } from "./dom.js";
import { metres, outcome, kitchenName } from "./format.js";
import { gif } from "./gif.js";
import { farthest } from "./stage.js";

const [WIDTH, HEIGHT] = [640, 480];
/** Height of each of the two lines above an episode's views, pixels. */
const LINE = 22;

/** What the first line above the pictures says, as in the films of `replay`: which episode, and at its end how it ended. */
export function caption({ key, last, place: where, episode: { number, target, outcome: ended, task } }, step) {
  const which = `${where ?? kitchenName(key.split("-")[0])}, episode ${number}${target ? `: ${target}` : ""}`;
  return [which[0].toUpperCase() + which.slice(1), step >= last ? outcome(ended, task?.successes) : null].filter(Boolean).join(" · ");
}

/** What the second line says: the step, its action and what it did. */
export function deeds(stage, step) {
  const at = Math.min(step, stage.last);
  const { acted, noted, measured } = stage.said(at);
  const [most] = farthest(stage.episode, stage.episode.moments[at]);
  return [`step ${at} of ${stage.last}${at ? `: ${acted}` : ""}`, ...noted.map(({ text }) => text), measured, most && `${most.name} moved ${metres(most.far, 2)}`].filter(Boolean).join(" · ");
}

/** What the marks stand for, up to the right end of a line; gives where that begins. */
function legend(pen, { target }, right, line) {
  let left = right;
  for (const [kind, text] of [["displaced", "displaced"], ["goal", "goal"], ...(target ? [["holds", "holding"], ["target", "target"]] : [])]) {
    left -= pen.measureText(text).width;
    pen.fillText(text, left, line);
    left -= 15;
    const { fillStyle } = pen;
    pen.fillStyle = css(`--mark-${kind}`);
    pen.fillRect(left, line - 10, 11, 11);
    pen.fillStyle = fillStyle;
    left -= 12;
  }
  return left;
}

/** Kinds of films that this browser can make: name, ending, what its recorder is told. */
export function kinds() {
  const recorded = [
    ["MP4", "mp4", ["video/mp4;codecs=avc1.42E028", "video/mp4;codecs=avc1.42E01E", "video/mp4;codecs=vp9", "video/mp4;codecs=av01.0.01M.08"]],
    ["WebM", "webm", ["video/webm;codecs=vp9", "video/webm"]],
  ];
  const found = recorded.map(([name, ending, types]) => ({ name, ending, type: types.find((type) => globalThis.MediaRecorder?.isTypeSupported(type)) }));
  // Every browser plays an MP4; WebM is for those that cannot make one.
  const [mp4, webm] = found;
  return [mp4.type ? mp4 : webm, { name: "GIF", ending: "gif", type: null }].filter(({ name, type }) => name === "GIF" || type);
}

/** Frames for the browser's recorder, which takes each as long as it is shown. */
class Recorded {
  constructor(canvas, type) {
    this.stream = canvas.captureStream(0);
    this.recorder = new MediaRecorder(this.stream, { mimeType: type, videoBitsPerSecond: 6e6 });
    this.chunks = [];
    this.recorder.ondataavailable = ({ data }) => this.chunks.push(data);
    this.ended = new Promise((resolve) => { this.recorder.onstop = resolve; });
    this.type = type;
  }

  async take(seconds) {
    // It begins with what the canvas has then.
    if (this.recorder.state === "inactive") this.recorder.start();
    this.stream.getVideoTracks()[0].requestFrame();
    await new Promise((resolve) => setTimeout(resolve, 1000 * seconds));
  }

  async finish() {
    this.recorder.stop();
    await this.ended;
    return new Blob(this.chunks, { type: this.type });
  }

  drop() { if (this.recorder.state !== "inactive") this.recorder.stop(); }
}

class Kept {
  constructor(canvas, seconds, split) { Object.assign(this, { canvas, seconds, split, frames: [] }); }
  take() { this.frames.push(this.canvas.getContext("2d").getImageData(0, 0, this.canvas.width, this.canvas.height)); }
  finish() { return gif(this.frames, this.seconds, this.split); }
  drop() { this.frames = []; }
}

/** The film as a blob. `told`: called with the share that is done. */
export async function film(stages, last, kind, speed, signal, told) {
  // A GIF grows with its pixels much faster.
  const small = kind.type ? 1 : stages.length > 1 ? 0.6 : 0.75;
  const [width, height] = [Math.round(WIDTH * small), Math.round(HEIGHT * small)];
  // What there is to say, beneath it what the robot sees and the room; another episode below.
  const tall = height + 2 * LINE;
  const canvas = h("canvas", { width: width + height, height: tall * stages.length });
  const pen = canvas.getContext("2d", { willReadFrequently: kind.type === null });
  const seconds = 1 / speed;
  let done = 0;
  const tell = () => { done += 1; told(done / (2 * (last + 1))); };
  const picture = async ({ orbit, last: end }, step, later) => {
    orbit.step = Math.min(step, end);
    const address = new URL(orbit.address(true), location.href);
    for (const [name, value] of Object.entries({ width, height, later })) address.searchParams.set(name, String(value));
    return (await ask(address, { signal })).blob();
  };
  const view = async (stage, step, later) => {
    const address = new URL(stage.address({ view: "depth", step: Math.min(step, stage.last), width: height, later }), location.href);
    return (await ask(address, { signal })).blob();
  };
  // All are drawn before the first is filmed, by both processes that draw: a recorder's time does not wait.
  const drawn = [];
  const draw = async (from, later) => {
    for (let step = from; step <= last; step += 2) {
      drawn[step] = await Promise.all(stages.map(async (stage) => [await picture(stage, step, later), await view(stage, step, later)]));
      tell();
    }
  };
  await Promise.all([draw(0, false), draw(1, true)]);
  const camera = kind.type ? new Recorded(canvas, kind.type) : new Kept(canvas, seconds, height);
  try {
    for (const [step, blobs] of drawn.entries()) {
      signal.throwIfAborted();
      const began = performance.now();
      Object.assign(pen, { fillStyle: "#ffffff", font: "14px system-ui, sans-serif" });
      pen.fillRect(0, 0, canvas.width, canvas.height);
      pen.fillStyle = "#22262c";
      for (const [at, [room, depth]] of blobs.entries()) {
        for (const [blob, left, wide] of [[depth, 0, height], [room, height, width]]) {
          const each = await createImageBitmap(blob);
          pen.drawImage(each, left, at * tall + 2 * LINE, wide, height);
          each.close();
        }
        const [stage, line] = [stages[at], at * tall + 16];
        pen.fillText(caption(stage, step), 6, line, legend(pen, stage.episode, canvas.width - 6, line) - 6);
        pen.fillText(deeds(stage, step), 6, line + LINE, canvas.width - 12);
      }
      tell();
      await camera.take(Math.max(0, seconds - (performance.now() - began) / 1000));
    }
    // The end is looked at for a second longer. A browser takes no picture of a canvas that was not painted.
    for (let held = 0; held < 1; held += seconds) {
      pen.drawImage(canvas, 0, 0, 1, 1, 0, 0, 1, 1);
      await camera.take(seconds);
    }
    return await camera.finish();
  } catch (error) {
    camera.drop();
    throw error;
  }
}
